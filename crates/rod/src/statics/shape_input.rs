//! Shapes that were measured: points along the rod become vertices, or the strains at which it is at ease.

use nalgebra::Vector3;

use super::guess::resample;
use crate::Error;
use crate::equilibrium::Rest;
use crate::geometry::{any_perpendicular, perpendicular};
use crate::rod::Rod;
use crate::shape::{FirstFrame, Shape};

impl Rest {
    /// A shape through these points \[m\] in order along the rod, the curve's own length scaled to the rod's.
    /// Angles are zero: directors carried by parallel transport from the first edge.
    ///
    /// # Errors
    /// [`Error::Count`] for fewer than two points, [`Error::ZeroEdge`] for two equal neighbours,
    /// [`Error::NonFinite`].
    pub fn through(rod: &Rod, points: &[Vector3<f64>]) -> Result<Rest, Error> {
        check(rod, points)?;
        let vertices = resample(&smooth(points), &rod.arc_lengths());
        Ok(Rest { vertices, theta: vec![0.0; rod.segments()] })
    }

    /// A shape through points \[m\] at these arc lengths \[m\], ascending; straight on beyond the first and
    /// the last. Angles are zero, as in [`Rest::through`].
    ///
    /// # Errors
    /// Those of [`Rest::through`], [`Error::Value`] for arc lengths that do not ascend.
    ///
    /// # Panics
    /// If there is not one arc length for every point.
    pub fn through_at(rod: &Rod, arc_lengths: &[f64], points: &[Vector3<f64>]) -> Result<Rest, Error> {
        assert_eq!(arc_lengths.len(), points.len(), "one arc length for every point");
        check(rod, points)?;
        if let Some(w) = arc_lengths.windows(2).find(|w| !(w[1] > w[0])) {
            let expected = "more than the one before";
            return Err(Error::Value { field: "arc length of a point", value: w[1], expected });
        }
        let curve = smooth(points);
        let (first, last) = (arc_lengths[0], arc_lengths[points.len() - 1]);
        let (m, end) = (curve.len(), points.len() - 1);
        let vertices = rod.arc_lengths().into_iter().map(|s| {
            if s < first {
                curve[0] - (curve[1] - curve[0]).normalize() * (first - s)
            } else if s > last {
                curve[m - 1] + (curve[m - 1] - curve[m - 2]).normalize() * (s - last)
            } else {
                let i = (arc_lengths.partition_point(|a| *a <= s).max(1) - 1).min(end - 1);
                let piece = &curve[PIECES * i..=PIECES * (i + 1)];
                let span = arc_lengths[i + 1] - arc_lengths[i];
                resample(piece, &[s - arc_lengths[i], span])[0]
            }
        });
        Ok(Rest { vertices: vertices.collect(), theta: vec![0.0; rod.segments()] })
    }
}

fn check(rod: &Rod, points: &[Vector3<f64>]) -> Result<(), Error> {
    rod.check()?;
    if points.len() < 2 {
        return Err(Error::Count { field: "points of a shape", found: points.len(), expected: 2 });
    }
    for (i, w) in points.windows(2).enumerate() {
        crate::geometry::Edge::between(&w[0], &w[1], i)?;
    }
    Ok(())
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
            // at a clamp's face more of the rod belongs to the vertex than was measured
            let between = 0.5 * self.rest_lengths[i - 1] + 0.5 * self.rest_lengths[i];
            let share = self.voronoi_lengths[i - 1] / between;
            self.natural_curvature[i - 1] = [kappa[0] * share, kappa[1] * share];
            self.natural_twist[i - 1] = 0.0;
        }
        Ok(self)
    }
}

/// Pieces of the curve between two neighbouring points.
const PIECES: usize = 10;

/// Nine points between two neighbours on Catmull and Rom's curve.
fn smooth(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    // slopes of the parabola through three neighbours by chord length, so that uneven spacing does not
    // overshoot
    let chord = |i: usize| points[i + 1] - points[i];
    let last = points.len() - 1;
    let inner = |i: usize| {
        let (a, b) = (chord(i - 1), chord(i));
        let (h, k) = (a.norm(), b.norm());
        (a * (k / h) + b * (h / k)) / (h + k)
    };
    let slope = |i: usize| match i {
        _ if last == 1 => chord(0).normalize(),
        0 => chord(0).normalize() * 2.0 - inner(1),
        i if i == last => chord(last - 1).normalize() * 2.0 - inner(last - 1),
        i => inner(i),
    };
    let mut curve = Vec::with_capacity(PIECES * points.len());
    for i in 0..last {
        let (p, q, length) = (points[i], points[i + 1], chord(i).norm());
        let (m, w) = (slope(i) * length, slope(i + 1) * length);
        for j in 0..PIECES {
            let u = j as f64 / PIECES as f64;
            let (u2, u3) = (u * u, u * u * u);
            curve.push(
                p * (2.0 * u3 - 3.0 * u2 + 1.0)
                    + m * (u3 - 2.0 * u2 + u)
                    + q * (3.0 * u2 - 2.0 * u3)
                    + w * (u3 - u2),
            );
        }
    }
    curve.push(points[last]);
    curve
}
