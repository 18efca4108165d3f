//! Shapes that were measured: points along the rod become vertices, or the strains at which it is at ease.

use nalgebra::Vector3;

use super::guess::resample;
use crate::Error;
use crate::equilibrium::Rest;
use crate::geometry::{any_perpendicular, perpendicular};
use crate::rod::Rod;
use crate::shape::{FirstFrame, Shape};

impl Rest {
    /// A shape through these points in order along the rod, the curve's own length scaled to the rod's.
    /// Angles are zero: directors carried by parallel transport from the first edge.
    ///
    /// # Errors
    /// [`Error::Count`] for fewer than two points, [`Error::ZeroEdge`] for two equal neighbours,
    /// [`Error::NonFinite`].
    pub fn through(rod: &Rod, points: &[Vector3<f64>]) -> Result<Rest, Error> {
        rod.check()?;
        if points.len() < 2 {
            return Err(Error::Count { field: "points of a shape", found: points.len(), expected: 2 });
        }
        for (i, w) in points.windows(2).enumerate() {
            crate::geometry::Edge::between(&w[0], &w[1], i)?;
        }
        let vertices = resample(&smooth(points), &rod.arc_lengths());
        Ok(Rest { vertices, theta: vec![0.0; rod.segments()] })
    }
}

impl Rod {
    /// The same rod at ease in this shape: natural curvature (and, carried by it, torsion) in directors
    /// transported along it from `director` at its first edge; no natural twist.
    ///
    /// # Errors
    /// [`Error::Fold`], [`Error::ZeroEdge`] or [`Error::NonFinite`] where the shape is none.
    ///
    /// # Panics
    /// If `shape` has not one vertex for every vertex of the rod.
    pub fn at_ease_in(mut self, shape: &[Vector3<f64>], director: Vector3<f64>) -> Result<Rod, Error> {
        assert_eq!(shape.len(), self.segments() + 1, "one place for every vertex");
        let mut measured = Shape::new(self.segments());
        measured.set_edges(shape, true)?;
        let t = measured.edges[0].t;
        let across = director - t * director.dot(&t);
        let director =
            if across.norm() > 1e-9 { perpendicular(&director, &t) } else { any_perpendicular(&t) };
        measured.set_bishop(&FirstFrame::Clamped(director))?;
        measured.set_angles(&vec![0.0; self.segments()], None);
        for i in 1..self.segments() {
            let kappa = measured.strains(i).value;
            self.natural_curvature[i - 1] = [kappa[0], kappa[1]];
            self.natural_twist[i - 1] = 0.0;
        }
        Ok(self)
    }
}

/// Nine points between two neighbours on Catmull and Rom's curve.
fn smooth(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let at = |i: isize| points[i.clamp(0, points.len() as isize - 1) as usize];
    let mut curve = Vec::with_capacity(10 * points.len());
    for i in 0..points.len() as isize - 1 {
        let (p, q) = (at(i), at(i + 1));
        let chord = (q - p).norm();
        // slopes by chord length, so that uneven spacing does not overshoot
        let slope = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| {
            let (h, k) = ((b - a).norm(), (c - b).norm());
            if h == 0.0 {
                (c - b) / k
            } else if k == 0.0 {
                (b - a) / h
            } else {
                ((b - a) * (k / h) + (c - b) * (h / k)) / (h + k)
            }
        };
        let (m, w) = (slope(at(i - 1), p, q) * chord, slope(p, q, at(i + 2)) * chord);
        for j in 0..10 {
            let u = j as f64 / 10.0;
            let (u2, u3) = (u * u, u * u * u);
            curve.push(
                p * (2.0 * u3 - 3.0 * u2 + 1.0)
                    + m * (u3 - 2.0 * u2 + u)
                    + q * (3.0 * u2 - 2.0 * u3)
                    + w * (u3 - u2),
            );
        }
    }
    curve.push(points[points.len() - 1]);
    curve
}
