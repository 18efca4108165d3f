//! Second derivatives of places of markers, by the state, parameters that move supports, and where they are.
//!
//! With c the places of all vertices and the local angles of all edges, L = Σ dy·y and the increments w_p
//! of c by parameters,
//!
//! ```text
//! ∂²L/∂p∂q = w_pᵀ L_cc w_q + L_cᵀ w_pq
//! ```
//!
//! as in [`moved_second`](crate::moved_second), with the curvature of ψ in L_cc.

use nalgebra::Vector3;
use varda_implicit::At;
use varda_linalg::dot;

use super::Markers;
use crate::Error;
use crate::layout::{Layout, band_product_add};
use crate::moved_together::{Alone, Together};

/// Work space of second derivatives: nothing until they are asked for.
#[derive(Default)]
pub(super) struct Second {
    /// Forces on places and angles; the derivative by the angle of every edge.
    on_places: Vec<Vector3<f64>>,
    on_angles: Vec<f64>,
    by_angle: Vec<f64>,
    /// The second derivative of what acts on ψ; an increment of the unknowns, and its product with it. Where
    /// parameters move supports these are of the rod with nothing held.
    all_free: Option<Layout>,
    together: Together,
    band: Vec<f64>,
    by: Vec<f64>,
    product: Vec<f64>,
}

impl Markers {
    /// The second derivatives of Σ dy·y with the places (s, o₁, o₂, o₃) of the markers, four numbers
    /// each, and the state and parameters of the rod's step that move supports: adds those of an increment
    /// `[dx, dp, places]` of all to `[out, out_p, out_places]`. Those of the state and parameters alone
    /// [`second_with_parameters_add`](Self::second_with_parameters_add) adds; of places alone there are none.
    ///
    /// # Errors
    /// A state that cannot be observed.
    ///
    /// # Panics
    /// If a slice has the wrong length, or there are no frames ([`with_frames`](Self::with_frames)).
    pub fn second_by_place_add(
        &mut self,
        at: At,
        x: &[f64],
        [dx, dp, places]: [&[f64]; 3],
        dy: &[f64],
        [out, out_p, out_places]: [&mut [f64]; 3],
    ) -> Result<(), Error> {
        let four = 4 * self.markers.len();
        assert!(places.len() == four && out_places.len() == four, "four numbers for every marker");
        assert!(self.frames, "a rod with frames");
        self.set(at.time, x)?;
        let mut moved = std::mem::take(&mut self.second.together);
        moved.set(&self.system, &self.system.shape, at.time);
        self.set_increment(dx, dp, &moved);
        let units = [Vector3::x(), Vector3::y(), Vector3::z()];
        for ((place, _), (dy, out)) in
            self.markers.iter().zip(dy.chunks_exact(3).zip(out_places.chunks_exact_mut(4)))
        {
            let (e, force) = (place.edge, self.force(dy));
            let moved = self.displacement[e + 1] - self.displacement[e];
            out[0] += force.dot(&moved) / self.system.rod.rest_lengths[e];
            for (unit, out) in units.iter().zip(&mut out[1..]) {
                let (rate, turn) = self.offset_transpose(e, unit, &force);
                *out += rate.dot(&moved) + turn * self.angle[e];
            }
        }
        self.displacement.fill(Vector3::zeros());
        self.angle.fill(0.0);
        for (m, (places, dy)) in places.chunks_exact(4).zip(dy.chunks_exact(3)).enumerate() {
            let (e, force) = (self.markers[m].0.edge, self.force(dy));
            let (rate, turn) = self.offset_transpose(e, &Vector3::from_column_slice(&places[1..]), &force);
            let on_end = rate + force * (places[0] / self.system.rod.rest_lengths[e]);
            self.angle[e] += turn;
            self.displacement[e] -= on_end;
            self.displacement[e + 1] += on_end;
        }
        self.increment_transpose_add(&moved, out, out_p);
        self.second.together = moved;
        Ok(())
    }

    /// (out, out_p) += Σ dy ∂²y/∂(x, p)² (dx, dp) of all parameters p of the rod's step, which may
    /// move its supports.
    ///
    /// # Errors
    /// A state that cannot be observed.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn second_with_parameters_add(
        &mut self,
        at: At,
        x: &[f64],
        [dx, dp]: [&[f64]; 2],
        dy: &[f64],
        [out, out_p]: [&mut [f64]; 2],
    ) -> Result<(), Error> {
        self.set(at.time, x)?;
        let mut moved = std::mem::take(&mut self.second.together);
        moved.set(&self.system, &self.system.shape, at.time);
        if self.markers.iter().any(|(_, o)| *o != Vector3::zeros()) {
            self.set_increment(dx, dp, &moved);
            self.second_of_increment(dy);
            self.increment_transpose_add(&moved, out, out_p);
        }
        if !self.moving.is_empty() {
            self.forces_of(dy);
            let s = &self.system;
            moved.each_pair(s, (&s.shape, at.time), |[p, q], (places, angles), _| {
                let second = self.acts_along(places, angles);
                out_p[p] += second * dp[q];
                if p != q {
                    out_p[q] += second * dp[p];
                }
            });
        }
        self.second.together = moved;
        Ok(())
    }

    /// `displacement` and `angle` = the increment of a state and of such parameters.
    pub(super) fn set_increment(&mut self, dx: &[f64], dp: &[f64], moved: &Together) {
        self.system.displacements(dx, &mut self.displacement);
        if self.frames {
            self.turn_angles(dx);
        }
        for Alone { parameter, places, angles } in moved.iter() {
            let dp = dp[*parameter];
            self.displacement.iter_mut().zip(places).for_each(|(d, m)| *d += m * dp);
            self.angle.iter_mut().zip(angles).for_each(|(a, m)| *a += m * dp);
        }
    }

    /// The transpose: from what acts on `displacement` and `angle`.
    fn increment_transpose_add(&mut self, moved: &Together, dx: &mut [f64], dp: &mut [f64]) {
        for moved in moved.iter() {
            dp[moved.parameter] += self.acts_along(&moved.places, &moved.angles);
        }
        self.displacements_transpose_add(dx);
    }

    /// What acts on `displacement` and, where there are frames, on `angle`, times an increment.
    fn acts_along(&self, places: &[Vector3<f64>], angles: &[f64]) -> f64 {
        let on_places: f64 = self.displacement.iter().zip(places).map(|(a, b)| a.dot(b)).sum();
        on_places + if self.frames { dot(&self.angle, angles) } else { 0.0 }
    }

    /// `displacement` and `angle`, an increment, become its product with the second derivatives of Σ dy·y.
    pub(super) fn second_of_increment(&mut self, dy: &[f64]) {
        let n = self.psi.len();
        let mut second = std::mem::take(&mut self.second);
        if second.all_free.is_none() && !self.moving.is_empty() {
            second.all_free = Some(self.system.layout.all_free());
        }
        let Second { on_places, on_angles, by_angle, all_free, band, by, product, .. } = &mut second;
        on_places.clear();
        on_places.resize(n + 1, Vector3::zeros());
        for zeroed in [&mut *on_angles, by_angle] {
            zeroed.clear();
            zeroed.resize(n, 0.0);
        }
        for ((place, o), dy) in self.markers.iter().zip(dy.chunks_exact(3)) {
            let e = place.edge;
            let force = self.force(dy);
            let turn = if self.frames { self.angle[e] } else { 0.0 };
            let moved = ([self.displacement[e], self.displacement[e + 1]], turn);
            let places = &mut on_places[e..e + 2];
            by_angle[e] += self.system.offset_second_add(e, [&force, o], moved, places, &mut on_angles[e]);
        }
        if self.frames {
            // ψ itself is curved
            self.angle.copy_from_slice(by_angle);
            self.weigh_holonomy();
            if let Some(all) = all_free {
                std::mem::swap(&mut self.system.layout, all);
            }
            let layout = &self.system.layout;
            for (zeroed, length) in
                [(&mut *band, layout.band()), (by, layout.unknowns), (product, layout.unknowns)]
            {
                zeroed.clear();
                zeroed.resize(length, 0.0);
            }
            self.system.holonomy_second_add(&self.system.shape, &mut self.psi, band);
            let unknown = |v: usize| layout.unknown[layout.vertex(v)];
            for &v in &layout.free_vertices {
                by[unknown(v)..unknown(v) + 3].copy_from_slice(self.displacement[v].as_slice());
            }
            band_product_add(layout.half_bandwidth, band, by, product);
            for &v in &layout.free_vertices {
                on_places[v] += Vector3::from_column_slice(&product[unknown(v)..unknown(v) + 3]);
            }
            if let Some(held) = all_free {
                std::mem::swap(&mut self.system.layout, held);
            }
        }
        self.displacement.copy_from_slice(on_places);
        if self.frames {
            self.angle.copy_from_slice(on_angles);
        }
        self.second = second;
    }
}
