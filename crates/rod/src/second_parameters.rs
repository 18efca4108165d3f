//! Second derivatives of elastic and Kelvin–Voigt forces with constants of a rod.
//!
//! Forces are Σ σ ∇ε with σ affine in each constant, and quadratic in all of them. With F the
//! derivative of the energy by a constant and μ the multipliers of the forces, what a product asks for is
//!
//! ```text
//! ∂²(μᵀ∇E)/∂c∂p = Σ δσ (∇ε)' + δσ' ∇ε,     ' along μ
//! ```
//!
//! in coordinates that start at the moved configuration. Those fixed at the present one have Kᵀ F_α more
//! (see [`second_order`](crate::second_order)); that is left out with Kᵀ H of the same equation of angles,
//! (H du + G_x dx + F dp)_α = 0.

use crate::along::{Along, VertexAlong};
use crate::change::{Change, Parameters, VertexChange};
use crate::element::LOCAL;
use crate::system::{PastStrains, System};

/// β/η of a step and what parameters do to it, the strains of its past, and its shape along μ.
#[derive(Clone, Copy)]
pub(crate) struct Strained<'a> {
    pub(crate) rate: f64,
    /// 1/η, in units of which β changes; zero at rest.
    pub(crate) moves: f64,
    pub(crate) past: &'a PastStrains,
    pub(crate) along: &'a Along,
}

impl Strained<'_> {
    fn rates(&self, change: &Change) -> [f64; 2] {
        [self.rate, self.moves * change.damping.stiffness]
    }
}

impl System {
    /// Overwrites `full` with ∂²(μᵀ∇E)/∂c∂g of a change, in the full order, and returns μᵀ
    /// ∂∇E/∂g.
    pub(crate) fn second_of_change(&self, change: &Change, of: Strained, full: &mut [f64]) -> f64 {
        full.fill(0.0);
        let (layout, rod, rates) = (&self.layout, &self.rod, of.rates(change));
        let [r, dr] = rates;
        let mut sum = 0.0;
        if !change.ea.is_empty() || dr != 0.0 {
            for (e, edge) in of.along.edges.iter().enumerate() {
                let rest = rod.rest_lengths[e];
                let gone = of.past.lengths.get(e).map_or(0.0, |l| edge.l - l);
                let (more, ea) = (change.ea.get(e).copied().unwrap_or(0.0), rod.ea[e]);
                let force = (more * (edge.l - rest + r * gone) + ea * dr * gone) / rest;
                let rate = (more * (1.0 + r) + ea * dr) / rest * edge.rate;
                sum += force * edge.rate;
                let second = edge.turned * force + edge.t * rate;
                let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
                for c in 0..3 {
                    full[a + c] -= second[c];
                    full[b + c] += second[c];
                }
            }
        }
        if !(change.is_of_bending() || dr != 0.0) {
            return sum;
        }
        for (vertex, i) in of.along.vertices.iter().zip(1..) {
            let (stress, rate) = self.stress_along(i, vertex, change, of);
            let full = &mut full[layout.vertex(i - 1)..];
            for a in 0..3 {
                sum += stress[a] * vertex.rate[a];
                let of_strain = full.iter_mut().zip(&vertex.turned[a]).zip(&vertex.gradient[a]);
                let length = if layout.twist { LOCAL } else { 9 };
                of_strain.take(length).for_each(|((f, turned), g)| *f += stress[a] * turned + rate[a] * g);
            }
        }
        sum
    }

    /// δσ of an interior vertex, and its change along μ.
    fn stress_along(
        &self,
        i: usize,
        vertex: &VertexAlong,
        change: &Change,
        of: Strained,
    ) -> ([f64; 3], [f64; 3]) {
        let by = self.change_of_vertex(i, change);
        if !self.layout.twist {
            // the energy for a stiffness of one stands for a strain
            return ([by.isotropic(), 0.0, 0.0], [0.0; 3]);
        }
        let rates = of.rates(change);
        let stress = by.stress(&vertex.value, rates, of.past.bend.get(i - 1));
        (stress, by.stress_of(&vertex.rate, rates))
    }

    /// −(δk r + k δr) μ·∇ε of every edge and of the vertex it starts at: what the strains of the
    /// past are multiplied by in ∂²(μᵀ∇E)/∂x∂g. Returns whether there is anything.
    pub(crate) fn past_of_change(&self, change: &Change, of: Strained, stresses: &mut Vec<[f64; 4]>) -> bool {
        let [r, dr] = of.rates(change);
        stresses.clear();
        if !change.is_of_stiffness() || (r == 0.0 && dr == 0.0) {
            return false;
        }
        for (e, edge) in of.along.edges.iter().enumerate() {
            let more = change.ea.get(e).copied().unwrap_or(0.0);
            let mut stress = [0.0; 4];
            stress[0] = -(more * r + self.rod.ea[e] * dr) / self.rod.rest_lengths[e] * edge.rate;
            if let Some(vertex) = e.checked_sub(1).and_then(|v| of.along.vertices.get(v)) {
                let by = self.change_of_vertex(e, change);
                stress[1..].copy_from_slice(&by.stress_of_past(&vertex.rate, [r, dr]));
            }
            stresses.push(stress);
        }
        true
    }

    /// ∂²(μᵀ∇E)/∂g∂g' of two changes.
    fn second_of_changes(&self, [a, b]: [&Change; 2], of: Strained) -> f64 {
        if !(a.is_of_stiffness() || b.is_of_stiffness()) {
            return 0.0;
        }
        let [dr, other_dr] = [a, b].map(|change| of.rates(change)[1]);
        let mut sum = 0.0;
        if dr != 0.0 || other_dr != 0.0 {
            for (e, edge) in of.along.edges.iter().enumerate() {
                let gone = of.past.lengths.get(e).map_or(0.0, |l| edge.l - l);
                let [by_a, by_b] = [a, b].map(|change| change.ea.get(e).copied().unwrap_or(0.0));
                sum += (by_a * other_dr + by_b * dr) / self.rod.rest_lengths[e] * gone * edge.rate;
            }
        }
        if !self.layout.twist {
            return sum;
        }
        for (vertex, i) in of.along.vertices.iter().zip(1..) {
            let [by_a, by_b] = [a, b].map(|change| self.change_of_vertex(i, change));
            let past = of.past.bend.get(i - 1);
            let second = VertexChange::second(&by_a, &by_b, [dr, other_dr], &vertex.value, past);
            sum += (0..3).map(|s| second[s] * vertex.rate[s]).sum::<f64>();
        }
        sum
    }
}

impl Parameters {
    /// Adds ∂²(μᵀ∇E)/∂p² to `square`, the `first` derivatives μᵀ ∂∇E/∂g given.
    pub(crate) fn square_add(&self, system: &System, of: Strained, first: &[f64], square: &mut [f64]) {
        let m = self.len();
        for (i, a) in self.list.iter().enumerate() {
            for (j, b) in self.list.iter().enumerate().take(i + 1) {
                let second = system.second_of_changes([&a.change, &b.change], of);
                self.both_add(square, [i, j], second);
            }
            square[i * m + i] += self.curvatures[i] * first[i];
        }
    }

    /// Adds a second derivative by g_i and g_j to those by p.
    pub(crate) fn both_add(&self, square: &mut [f64], [i, j]: [usize; 2], second: f64) {
        let (m, second) = (self.len(), self.slopes[i] * self.slopes[j] * second);
        square[i * m + j] += second;
        if i != j {
            square[j * m + i] += second;
        }
    }
}
