//! Second derivatives of directions and orientations.
//!
//! With δy = b·w of a small rotation w of the section along (m₁, m₂, t),
//!
//! ```text
//! δy = (b₂ m₁ − b₁ m₂)·δe/l + b₃ δφ
//! ```
//!
//! in directors that are carried from where the edge is. Along an increment b, the directors and l change,
//! and φ by the area K δx of [`second_order`](crate::second_order).

use nalgebra::{Vector2, Vector3};

use super::second::Seen;
use super::{Placed, Present, Row};
use crate::forces_tangent::Increment;
use crate::read_rotations::{tilt_by_tangent, tilt_second, turn, turn_by_section, turn_second};

impl Seen<'_> {
    /// Adds what acts on the configuration.
    pub(super) fn of_rotations(&self, rows: &[(Row, f64)], on: &mut Increment) {
        for (row, dy) in rows.iter().filter(|(_, dy)| *dy != 0.0) {
            let (e, by_edge, by_angle) = match row.sensor {
                Placed::Direction(e, _) => (*e, self.of_direction(row), 0.0),
                Placed::Orientation(e, ..) => {
                    let (by_edge, by_angle) = self.of_orientation(row);
                    (*e, by_edge, by_angle)
                }
                _ => continue,
            };
            on.places[e] -= by_edge * *dy;
            on.places[e + 1] += by_edge * *dy;
            on.angles[e] += by_angle * dy;
        }
    }

    /// δ((g − t t·g)/l) with g = ∂y/∂t.
    fn of_direction(&self, row: &Row) -> Vector3<f64> {
        let Placed::Direction(e, rows) = row.sensor else { return Vector3::zeros() };
        let (read, edge) = (rows.matrix(self.present.times[0]), &self.system.shape.edges[*e]);
        let (dt, longer) = self.turned(*e);
        let t = &edge.t;
        let dy = Vector2::ith(row.index, 1.0);
        let by = tilt_by_tangent(&read, t)[row.index];
        let change = tilt_second(&read, t, &dy, &dt);
        let across = by - t * t.dot(&by);
        (change - dt * t.dot(&by) - t * (dt.dot(&by) + t.dot(&change)) - across * (longer / edge.l)) / edge.l
    }

    /// What acts on the end of the edge, and on its angle.
    fn of_orientation(&self, row: &Row) -> (Vector3<f64>, f64) {
        let Placed::Orientation(e, axes, rows) = row.sensor else { return (Vector3::zeros(), 0.0) };
        let (shape, read) = (&self.system.shape, rows.matrix(self.present.times[0]));
        let (edge, m1, m2) = (&shape.edges[*e], &shape.m1[*e], &shape.m2[*e]);
        let ((dt, longer), angle) = (self.turned(*e), self.tangent.now.angles[*e]);
        let turned = turn(&read, &Present::section(self.system, *e), axes);
        let b = turn_by_section(&turned, axes).column(row.index).into_owned();
        let w = Vector3::new(-m2.dot(&dt), m1.dot(&dt), angle);
        let db = turn_second(&turned, axes, &Vector3::ith(row.index, 1.0), &w);
        let dm1 = m2 * angle - edge.t * m1.dot(&dt);
        let dm2 = m1 * -angle - edge.t * m2.dot(&dt);
        let by_tangent = m1 * b.y - m2 * b.x;
        let change = m1 * db.y - m2 * db.x + dm1 * b.y - dm2 * b.x;
        let area = dt.cross(&edge.t) * (0.5 * b.z);
        ((change - by_tangent * (longer / edge.l) + area) / edge.l, db.z)
    }

    /// δt and δl of an edge.
    fn turned(&self, e: usize) -> (Vector3<f64>, f64) {
        let (edge, moved) = (&self.system.shape.edges[e], self.edge_moved(e));
        let longer = edge.t.dot(&moved);
        ((moved - edge.t * longer) / edge.l, longer)
    }
}
