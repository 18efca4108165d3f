//! Edges, curvature and parallel transport.

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::scalar::{Real, length, square, unit};

/// 1 + t·t' below this is a fold: the turning angle is within 1e-6 rad of π, where 1 + t·t' = (1e-6)²/2.
const FOLD: f64 = 0.5e-12;

/// Unit tangent and length of an edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge<T = f64> {
    pub(crate) t: Vector3<T>,
    pub(crate) l: T,
}

impl<T: Real> Edge<T> {
    pub(crate) fn none() -> Edge<T> {
        Edge { t: Vector3::zeros(), l: T::zero() }
    }

    pub(crate) fn between(a: &Vector3<T>, b: &Vector3<T>, index: usize) -> Result<Edge<T>, Error> {
        let e = b - a;
        let l = length(&e);
        // Also catches NaN and overflow; 1e-150 keeps 1/l² finite.
        if !(l > T::of(1e-150) && l < T::of(1e150)) {
            let length = l.value();
            return Err(if length.is_finite() {
                Error::ZeroEdge { edge: index, length }
            } else {
                Error::NonFinite { what: "the length of edge", index }
            });
        }
        Ok(Edge { t: e / l, l })
    }
}

/// Curvature at a vertex between unit tangents p = t^{i−1} and q = t^i (paper 5.1 with the opposite
/// orientation, that of Bergou et al. 2008):
///
/// ```text
/// κb = 2 p×q / χ,   χ = 1 + p·q = |p+q|²/2,   t̃ = (p+q)/χ
/// ```
///
/// χ is taken from |p+q|², which keeps nine digits near a fold where 1 + p·q loses all of them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn<T = f64> {
    pub(crate) chi: T,
    pub(crate) kb: Vector3<T>,
    pub(crate) tilde: Vector3<T>,
}

impl<T: Real> Turn<T> {
    pub(crate) fn none() -> Turn<T> {
        Turn { chi: T::one(), kb: Vector3::zeros(), tilde: Vector3::zeros() }
    }

    pub(crate) fn between(p: &Vector3<T>, q: &Vector3<T>, vertex: usize) -> Result<Turn<T>, Error> {
        let sum = p + q;
        let chi = T::of(0.5) * square(&sum);
        if !(chi > T::of(FOLD)) {
            return Err(Error::Fold { vertex });
        }
        // p × q = p × (q − p): the difference is exact for nearly parallel tangents.
        Ok(Turn { chi, kb: p.cross(&(q - p)) * (T::of(2.0) / chi), tilde: sum / chi })
    }

    /// Parallel transport of w ⟂ p from p to q: w − (w·q) t̃.
    pub(crate) fn transport(&self, q: &Vector3<T>, w: &Vector3<T>) -> Vector3<T> {
        w - self.tilde * w.dot(q)
    }
}

/// The part of w perpendicular to the unit vector t, normalized.
pub(crate) fn perpendicular<T: Real>(w: &Vector3<T>, t: &Vector3<T>) -> Vector3<T> {
    unit(&(w - t * w.dot(t)))
}

/// Some unit vector perpendicular to the unit vector t: the coordinate axis least aligned with it, projected.
pub(crate) fn any_perpendicular(t: &Vector3<f64>) -> Vector3<f64> {
    let mut axis = Vector3::zeros();
    axis[t.iamin()] = 1.0;
    perpendicular(&axis, t)
}

/// Signed angle from u to w about t, in (−π, π]; u, w ⟂ t.
pub(crate) fn signed_angle<T: Real>(u: &Vector3<T>, w: &Vector3<T>, t: &Vector3<T>) -> T {
    u.cross(w).dot(t).atan2(u.dot(w))
}

/// a bᵀ.
#[inline(always)]
pub(crate) fn outer<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Matrix3<T> {
    let (x, y, z) = (a * b.x, a * b.y, a * b.z);
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

/// a bᵀ + b aᵀ.
#[inline(always)]
pub(crate) fn symmetric_product<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Matrix3<T> {
    outer(a, b) + outer(b, a)
}
