//! Kelvin–Voigt damping: what the strains of steps before contribute.
//!
//! The strain rate of a stage is (ε(y) − ε*)/η with ε* a sum of strains of configurations of the past,
//! each with a weight; that sum takes part in E as a modified stiffness and rest strain
//! (`System::set_stiffness`), so that the potential and its symmetry stay. Here are the products with
//! ∂G/∂x_k = −(β/η) Σ_j w_j ∇ε(y) k ∇ε(past j)ᵀ ∂(past j)/∂x_k. Strains do not change in
//! a rigid motion, so neither does ε*.

use nalgebra::Vector3;

use crate::element::Strains;
use crate::layout::FIXED;
use crate::shape::Shape;
use crate::stage::{mixed, mixed_add};
use crate::system::{PastStrains, System};

pub(crate) struct KelvinVoigt {
    /// ε*, summed up.
    past: PastStrains,
    /// The configurations it is made of; the first `used` of them.
    configurations: Vec<Past>,
    used: usize,
    /// r/(1+r) with r = β/η: what part of the modified stiffness is viscous.
    share: f64,
    full: Vec<f64>,
    state: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

/// A configuration of the past: shares of x_k and x_{k−1} in it, and the weight of its strains in ε*.
struct Past {
    of: [f64; 2],
    weight: f64,
    shape: Shape,
    strains: Vec<Strains>,
}

impl KelvinVoigt {
    pub(crate) fn new(system: &System, configurations: usize) -> KelvinVoigt {
        let n = system.rod.segments();
        let past =
            || Past { of: [0.0; 2], weight: 0.0, shape: Shape::new(n), strains: Vec::with_capacity(n) };
        KelvinVoigt {
            past: PastStrains::default(),
            configurations: (0..configurations).map(|_| past()).collect(),
            used: 0,
            share: 0.0,
            full: vec![0.0; system.layout.full()],
            state: vec![0.0; system.layout.state()],
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
        }
    }

    /// Forgets the past.
    pub(crate) fn clear(&mut self, system: &System) {
        self.used = 0;
        self.past.lengths.clear();
        self.past.lengths.resize(system.rod.segments(), 0.0);
        self.past.bend.clear();
        self.past.bend.resize(system.rod.ei.len(), [0.0; 3]);
    }

    /// Adds the strains of the present shape of `system`, that of a₀ x_k + a₁ x_{k−1}, to ε*.
    pub(crate) fn add(&mut self, system: &System, of: [f64; 2], weight: f64) {
        let past = &mut self.configurations[self.used];
        self.used += 1;
        (past.of, past.weight) = (of, weight);
        past.shape.copy_from(&system.shape);
        for (sum, edge) in self.past.lengths.iter_mut().zip(&system.shape.edges) {
            *sum += weight * edge.l;
        }
        past.strains.clear();
        if system.layout.bending {
            for vertex in 1..system.rod.segments() {
                let strains = system.shape.strains(vertex);
                for (sum, value) in self.past.bend[vertex - 1].iter_mut().zip(strains.value) {
                    *sum += weight * value;
                }
                past.strains.push(strains);
            }
        }
    }

    /// Folds ε* into the stiffness of `system`, r = β/η.
    pub(crate) fn fold_in(&mut self, system: &mut System, r: f64) {
        self.share = r / (1.0 + r);
        system.set_stiffness(r, Some(&self.past));
    }

    /// dg += ∂G/∂x_k dx, `system` having the shape of the stage.
    pub(crate) fn previous_add(&mut self, system: &System, dx: &[f64], dg: &mut [f64]) {
        let layout = &system.layout;
        let own = self.state.len();
        for past in &self.configurations[..self.used] {
            for (i, v) in self.state.iter_mut().enumerate() {
                *v = mixed(past.of, dx, own, i);
            }
            system.displacements(&self.state, &mut self.displacement);
            self.full.fill(0.0);
            for &v in &layout.free_vertices {
                let i = layout.vertex(v);
                self.full[i..i + 3].copy_from_slice(self.displacement[v].as_slice());
            }
            if !layout.free_angles.is_empty() {
                past.shape.holonomy(&self.displacement, &mut self.psi);
                let angles = &self.state[6 * layout.free_vertices.len()..];
                for (f, &e) in layout.free_angles.iter().enumerate() {
                    self.full[layout.angle(e)] = angles[f] - self.psi[e];
                }
            }
            past.couple(self.share, &self.full, system, Direction::Forward, |full, value| {
                let unknown = layout.unknown[full];
                if unknown != FIXED {
                    dg[unknown] += value;
                }
            });
        }
    }

    /// dx += (∂G/∂x_k)ᵀ μ, `system` having the shape of the stage.
    pub(crate) fn previous_transpose_add(&mut self, system: &System, mu: &[f64], dx: &mut [f64]) {
        let layout = &system.layout;
        for (full, &unknown) in layout.unknown.iter().enumerate() {
            self.full[full] = if unknown == FIXED { 0.0 } else { mu[unknown] };
        }
        let (nf, stride) = (layout.free_vertices.len(), layout.vertex(1));
        let own = self.state.len();
        for past in &self.configurations[..self.used] {
            let (back, angles, state) = (&mut self.displacement, &mut self.psi, &mut self.state);
            back.fill(Vector3::zeros());
            angles.fill(0.0);
            past.couple(self.share, &self.full, system, Direction::Transposed, |full, value| {
                // The place of a degree of freedom within its stride tells a coordinate from an angle.
                let (v, c) = (full / stride, full % stride);
                if c < 3 { back[v][c] += value } else { angles[v] += value }
            });
            state.fill(0.0);
            // An angle that is given turns with its clamp: no local increment, nothing comes back through it.
            for e in 0..layout.segments {
                match layout.free_angles.binary_search(&e) {
                    Ok(f) => state[6 * nf + f] = angles[e],
                    Err(_) => angles[e] = 0.0,
                }
                angles[e] = -angles[e];
            }
            if layout.twist {
                past.shape.holonomy_transpose_add(angles, back);
            }
            for (f, &v) in layout.free_vertices.iter().enumerate() {
                state[3 * f..3 * f + 3].copy_from_slice(back[v].as_slice());
            }
            for (i, value) in state.iter().enumerate() {
                mixed_add(past.of, dx, own, i, [*value]);
            }
        }
    }
}

impl Past {
    /// −(β/η) w Σ ∇ε(to) k ∇ε(from)ᵀ applied to `full`; from the past to the stage or the other
    /// way round.
    fn couple(
        &self,
        share: f64,
        full: &[f64],
        system: &System,
        direction: Direction,
        mut add: impl FnMut(usize, f64),
    ) {
        let share = share * self.weight;
        let layout = &system.layout;
        for e in 0..layout.segments {
            let (from, to) = direction.order(self.shape.edges[e].t, system.shape.edges[e].t);
            let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
            let dl: f64 = (0..3).map(|c| from[c] * (full[b + c] - full[a + c])).sum();
            let (ea, rest) = system.stretch[e];
            let force = -share * ea / rest * dl;
            for c in 0..3 {
                add(a + c, -to[c] * force);
                add(b + c, to[c] * force);
            }
        }
        if !layout.bending {
            return;
        }
        for vertex in 1..layout.segments {
            let new = system.shape.strains(vertex);
            let old = &self.strains[vertex - 1];
            let first = layout.vertex(vertex - 1);
            let local = &full[first..first + 11];
            let (from, to) = direction.order(&old.gradient, &new.gradient);
            let strain = from.each_ref().map(|g| g.iter().zip(local).map(|(g, q)| g * q).sum());
            let stress = system.bend[vertex - 1].times(&strain);
            for i in 0..11 {
                add(first + i, -share * (0..3).map(|a| to[a][i] * stress[a]).sum::<f64>());
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Direction {
    Forward,
    Transposed,
}

impl Direction {
    /// (from, to).
    fn order<T>(self, old: T, new: T) -> (T, T) {
        match self {
            Direction::Forward => (old, new),
            Direction::Transposed => (new, old),
        }
    }
}
