//! Edges, curvature and parallel transport.

use crate::Error;

pub(crate) type V3 = glam::DVec3;
pub(crate) type M3 = glam::DMat3;

/// 1 + t·t' below this is a fold: the turning angle is within 1e-6 rad of π, where 1 + t·t' = (1e-6)²/2.
const FOLD: f64 = 0.5e-12;

/// Unit tangent and length of an edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub(crate) t: V3,
    pub(crate) l: f64,
}

impl Edge {
    pub(crate) const NONE: Edge = Edge { t: V3::new(0.0, 0.0, 0.0), l: 0.0 };

    pub(crate) fn between(a: V3, b: V3, index: usize) -> Result<Edge, Error> {
        let e = b - a;
        let l = e.length();
        // Also catches NaN and overflow; 1e-150 keeps 1/l² finite.
        if !(l > 1e-150 && l < 1e150) {
            return Err(if l.is_finite() {
                Error::ZeroEdge { edge: index, length: l }
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
pub(crate) struct Turn {
    pub(crate) chi: f64,
    pub(crate) kb: V3,
    pub(crate) tilde: V3,
}

impl Turn {
    pub(crate) fn between(p: V3, q: V3, vertex: usize) -> Result<Turn, Error> {
        let sum = p + q;
        let chi = 0.5 * sum.length_squared();
        if !(chi > FOLD) {
            return Err(Error::Fold { vertex });
        }
        // p × q = p × (q − p): the difference is exact for nearly parallel tangents.
        Ok(Turn { chi, kb: p.cross(q - p) * (2.0 / chi), tilde: sum / chi })
    }

    /// Parallel transport of w ⟂ p from p to q: w − (w·q) t̃.
    pub(crate) fn transport(&self, q: V3, w: V3) -> V3 {
        w - self.tilde * w.dot(q)
    }
}

/// The part of w perpendicular to the unit vector t, normalized.
pub(crate) fn perpendicular(w: V3, t: V3) -> V3 {
    (w - t * w.dot(t)).normalize()
}

/// Some unit vector perpendicular to the unit vector t: the coordinate axis least aligned with it, projected.
pub(crate) fn any_perpendicular(t: V3) -> V3 {
    perpendicular(V3::AXES[t.abs().min_position()], t)
}

/// Signed angle from u to w about t, in (−π, π]; u, w ⟂ t.
pub(crate) fn signed_angle(u: V3, w: V3, t: V3) -> f64 {
    u.cross(w).dot(t).atan2(u.dot(w))
}

/// [w]×, the matrix of w × ·.
pub(crate) fn cross_matrix(w: V3) -> M3 {
    M3::from_cols(V3::new(0.0, w.z, -w.y), V3::new(-w.z, 0.0, w.x), V3::new(w.y, -w.x, 0.0))
}

/// a bᵀ.
pub(crate) fn outer(a: V3, b: V3) -> M3 {
    M3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// a bᵀ + b aᵀ.
pub(crate) fn symmetric_product(a: V3, b: V3) -> M3 {
    outer(a, b) + outer(b, a)
}
