//! Kelvin–Voigt damping: what the strains of the step before contribute.
//!
//! The damped energy ½ (β/Δt) k (ε(x_{k+1}) − ε(x_k))² enters E as a modified stiffness and rest strain
//! (`System::set_stiffness`); here are the products with ∂G/∂x_k = −(β/Δt) Σ ∇ε(x_{k+1}) k ∇ε(x_k)ᵀ.

use crate::element::Strains;
use crate::geometry::V3;
use crate::layout::FIXED;
use crate::shape::Shape;
use crate::system::{PastStrains, System};

pub(crate) struct KelvinVoigt {
    past: PastStrains,
    /// Shape and strain gradients at x_k.
    shape: Shape,
    strains: Vec<Strains>,
    /// r/(1+r) with r = β/Δt: what part of the modified stiffness is viscous.
    share: f64,
    full: Vec<f64>,
    displacement: Vec<V3>,
    psi: Vec<f64>,
}

impl KelvinVoigt {
    pub(crate) fn new(system: &System) -> KelvinVoigt {
        let n = system.rod.segments();
        KelvinVoigt {
            past: PastStrains::default(),
            shape: Shape::new(n),
            strains: Vec::with_capacity(n),
            share: 0.0,
            full: vec![0.0; system.layout.full()],
            displacement: vec![V3::zeros(); n + 1],
            psi: vec![0.0; n],
        }
    }

    /// Takes the strains of the present shape of `system` as those of x_k and folds them into its stiffness.
    pub(crate) fn set_past(&mut self, system: &mut System, r: f64) {
        self.share = r / (1.0 + r);
        self.shape.copy_from(&system.shape);
        self.past.lengths.clear();
        self.past.lengths.extend(system.shape.edges.iter().map(|e| e.l));
        self.strains.clear();
        self.past.bend.clear();
        if system.layout.bending {
            for vertex in 1..system.rod.segments() {
                self.strains.push(system.strains(vertex));
                self.past.bend.push(self.strains[vertex - 1].value);
            }
        } else {
            self.past.bend.resize(system.rod.ei.len(), [0.0; 3]);
        }
        system.set_stiffness(r, Some(&self.past));
    }

    /// dg += ∂G/∂x_k dx, `system` having the shape of x_{k+1}.
    pub(crate) fn previous_add(&mut self, system: &System, dx: &[f64], dg: &mut [f64]) {
        let layout = &system.layout;
        system.displacements(dx, &mut self.displacement);
        self.full.fill(0.0);
        for &v in &layout.free_vertices {
            let i = layout.vertex(v);
            self.full[i..i + 3].copy_from_slice(self.displacement[v].as_slice());
        }
        if !layout.free_angles.is_empty() {
            self.shape.holonomy(&self.displacement, &mut self.psi);
            let angles = &dx[6 * layout.free_vertices.len()..];
            for (f, &e) in layout.free_angles.iter().enumerate() {
                self.full[layout.angle(e)] = angles[f] - self.psi[e];
            }
        }
        self.couple(system, Direction::Forward, |full, value| {
            let unknown = layout.unknown[full];
            if unknown != FIXED {
                dg[unknown] += value;
            }
        });
    }

    /// dx += (∂G/∂x_k)ᵀ μ, `system` having the shape of x_{k+1}.
    pub(crate) fn previous_transpose_add(&mut self, system: &System, mu: &[f64], dx: &mut [f64]) {
        let layout = &system.layout;
        for (full, &unknown) in layout.unknown.iter().enumerate() {
            self.full[full] = if unknown == FIXED { 0.0 } else { mu[unknown] };
        }
        let nf = layout.free_vertices.len();
        let mut back = std::mem::take(&mut self.displacement);
        let mut angles = std::mem::take(&mut self.psi);
        back.fill(V3::zeros());
        angles.fill(0.0);
        let stride = layout.vertex(1);
        self.couple(system, Direction::Transposed, |full, value| {
            // The place of a degree of freedom within its stride tells a coordinate from an angle.
            let (v, c) = (full / stride, full % stride);
            if c < 3 { back[v][c] += value } else { angles[v] += value }
        });
        // An angle that is given turns with its clamp: no local increment, nothing comes back through it.
        for e in 0..layout.segments {
            match layout.free_angles.binary_search(&e) {
                Ok(f) => dx[6 * nf + f] += angles[e],
                Err(_) => angles[e] = 0.0,
            }
            angles[e] = -angles[e];
        }
        if layout.twist {
            self.shape.holonomy_transpose_add(&angles, &mut back);
        }
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += back[v][c];
            }
        }
        self.displacement = back;
        self.psi = angles;
    }

    /// −(β/Δt) Σ ∇ε(to) k ∇ε(from)ᵀ applied to `full`; from x_k to x_{k+1} or the other way round.
    fn couple(&self, system: &System, direction: Direction, mut add: impl FnMut(usize, f64)) {
        let layout = &system.layout;
        for e in 0..layout.segments {
            let (from, to) = direction.order(self.shape.edges[e].t, system.shape.edges[e].t);
            let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
            let dl: f64 = (0..3).map(|c| from[c] * (self.full[b + c] - self.full[a + c])).sum();
            let (ea, rest) = system.stretch[e];
            let force = -self.share * ea / rest * dl;
            for c in 0..3 {
                add(a + c, -to[c] * force);
                add(b + c, to[c] * force);
            }
        }
        if !layout.bending {
            return;
        }
        for vertex in 1..layout.segments {
            let new = system.strains(vertex);
            let old = &self.strains[vertex - 1];
            let first = layout.vertex(vertex - 1);
            let local = &self.full[first..first + 11];
            let (from, to) = direction.order(&old.gradient, &new.gradient);
            let strain = from.each_ref().map(|g| g.iter().zip(local).map(|(g, q)| g * q).sum());
            let stress = system.bend[vertex - 1].times(&strain);
            for i in 0..11 {
                add(first + i, -self.share * (0..3).map(|a| to[a][i] * stress[a]).sum::<f64>());
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
