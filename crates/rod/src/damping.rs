//! Kelvin–Voigt damping: what the strains of steps before contribute.
//!
//! The strain rate of a stage is (ε(y) − ε*)/η with ε* a sum of strains of configurations of the past,
//! each with a weight; that sum takes part in E as a modified stiffness and rest strain
//! (`System::set_stiffness`), so that the potential and its symmetry stay. Here are the products with
//! ∂G/∂x_k = −(β/η) Σ_j w_j ∇ε(y) k ∇ε(past j)ᵀ ∂(past j)/∂x_k. Strains do not change in
//! a rigid motion, so neither does ε*.

use nalgebra::Vector3;

use crate::element::Strains;
use crate::layout::{FIXED, Layout};
use crate::shape::{HOLONOMY, Shape, holonomy, holonomy_transpose_add, kept_bend};
use crate::stage::{RodStage, mixed, mixed_add};
use crate::system::{PastStrains, System};

pub(crate) struct KelvinVoigt {
    /// ε*, summed up.
    past: PastStrains,
    /// The configurations it is made of; the first `used` of them.
    configurations: Vec<Past>,
    used: usize,
    /// r/(1+r) with r = β/η: what part of the modified stiffness is viscous.
    share: f64,
    /// Increments in the full order, and their products.
    full: Vec<f64>,
    sum: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

/// A configuration of the past, and the weight of its strains in ε*.
struct Past {
    weight: f64,
    shape: Shape,
    strains: Vec<Strains>,
}

impl KelvinVoigt {
    pub(crate) fn new(system: &System, configurations: usize) -> KelvinVoigt {
        let n = system.rod.segments();
        let past = || Past { weight: 0.0, shape: Shape::new(n), strains: Vec::with_capacity(n) };
        KelvinVoigt {
            past: PastStrains::default(),
            configurations: (0..configurations).map(|_| past()).collect(),
            used: 0,
            share: 0.0,
            full: vec![0.0; system.layout.full()],
            sum: vec![0.0; system.layout.full()],
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

    /// Adds the strains of the present shape of `system`, the next of [`RodStage::past`], to ε*.
    pub(crate) fn add(&mut self, system: &System, weight: f64) {
        let past = &mut self.configurations[self.used];
        self.used += 1;
        past.weight = weight;
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

    /// ε*.
    pub(crate) fn past(&self) -> &PastStrains {
        &self.past
    }

    /// Folds ε* into the stiffness of `system`, r = β/η.
    pub(crate) fn fold_in(&mut self, system: &mut System, r: f64) {
        self.share = r / (1.0 + r);
        system.set_stiffness(r, Some(&self.past));
    }

    /// How many numbers the products need of a solved step: ∇ε k of the stage, then ∇ε and the holonomy
    /// of every configuration of the past.
    pub(crate) fn kept(&self, layout: &Layout) -> usize {
        let past = STRAINS + if layout.free_angles.is_empty() { 0 } else { HOLONOMY };
        layout.segments * (STRAINS + self.configurations.len() * past)
    }

    /// Writes them, `system` having the shape of the stage.
    pub(crate) fn keep(&self, system: &System, kept: &mut [f64]) {
        let layout = &system.layout;
        let (n, angles) = (layout.segments, !layout.free_angles.is_empty());
        let (stage, mut rest) = kept.split_at_mut(STRAINS * n);
        for (e, kept) in stage.chunks_exact_mut(STRAINS).enumerate() {
            let (ea, length) = system.stretch[e];
            put_edge(kept, &(system.shape.edges[e].t * (ea / length)));
            if layout.bending && e > 0 {
                let Strains { gradient, .. } = system.shape.strains(e);
                for i in 0..LOCAL {
                    let stress = system.bend[e - 1].times(&gradient.each_ref().map(|g| g[i]));
                    (0..3).for_each(|a| kept[3 + LOCAL * a + i] = stress[a]);
                }
            }
        }
        for past in &self.configurations[..self.used] {
            let (strains, after) = rest.split_at_mut(STRAINS * n);
            let (holonomy, after) = after.split_at_mut(if angles { HOLONOMY * n } else { 0 });
            let share = -self.share * past.weight;
            for (e, kept) in strains.chunks_exact_mut(STRAINS).enumerate() {
                put_edge(kept, &(past.shape.edges[e].t * share));
                if layout.bending && e > 0 {
                    let gradients = past.strains[e - 1].gradient.iter().flatten();
                    kept[3..].iter_mut().zip(gradients).for_each(|(kept, g)| *kept = share * g);
                }
            }
            past.shape.keep_holonomy(holonomy);
            rest = after;
        }
    }

    /// What was kept of the configurations of a stage: their shares of x_k and x_{k−1}, strains and
    /// holonomy.
    fn kept_past<'k>(
        layout: &Layout,
        stage: &RodStage,
        kept: &'k [f64],
    ) -> impl Iterator<Item = ([f64; 2], &'k [f64], &'k [f64])> {
        let holonomy = if layout.free_angles.is_empty() { 0 } else { HOLONOMY };
        let all = kept[STRAINS * layout.segments..].chunks_exact((STRAINS + holonomy) * layout.segments);
        let strains = STRAINS * layout.segments;
        stage.past().zip(all).map(move |((of, ..), kept)| (of, &kept[..strains], &kept[strains..]))
    }

    /// dg += ∂G/∂x_k dx, with what was kept of the solved step.
    pub(crate) fn previous_add(
        &mut self,
        layout: &Layout,
        stage: &RodStage,
        kept: &[f64],
        dx: &[f64],
        dg: &mut [f64],
    ) {
        let own = layout.state();
        let angles = 6 * layout.free_vertices.len();
        self.sum.fill(0.0);
        for (of, strains, bends) in Self::kept_past(layout, stage, kept) {
            self.full.fill(0.0);
            self.displacement.fill(Vector3::zeros());
            for (f, &v) in layout.free_vertices.iter().enumerate() {
                let moved = Vector3::from_fn(|c, _| mixed(of, dx, own, 3 * f + c));
                self.displacement[v] = moved;
                self.full[layout.vertex(v)..layout.vertex(v) + 3].copy_from_slice(moved.as_slice());
            }
            if !layout.free_angles.is_empty() {
                holonomy(kept_bend(bends), &self.displacement, &mut self.psi);
                for (f, &e) in layout.free_angles.iter().enumerate() {
                    self.full[layout.angle(e)] = mixed(of, dx, own, angles + f) - self.psi[e];
                }
            }
            couple(layout, strains, kept, &self.full, &mut self.sum);
        }
        for (value, &unknown) in self.sum.iter().zip(&layout.unknown) {
            if unknown != FIXED {
                dg[unknown] += value;
            }
        }
    }

    /// dx += (∂G/∂x_k)ᵀ μ, with what was kept of the solved step.
    pub(crate) fn previous_transpose_add(
        &mut self,
        layout: &Layout,
        stage: &RodStage,
        kept: &[f64],
        mu: &[f64],
        dx: &mut [f64],
    ) {
        for (full, &unknown) in self.full.iter_mut().zip(&layout.unknown) {
            *full = if unknown == FIXED { 0.0 } else { mu[unknown] };
        }
        let (own, angles) = (layout.state(), 6 * layout.free_vertices.len());
        for (of, strains, bends) in Self::kept_past(layout, stage, kept) {
            self.sum.fill(0.0);
            couple(layout, kept, strains, &self.full, &mut self.sum);
            let back = &mut self.displacement;
            for (v, back) in back.iter_mut().enumerate() {
                let first = layout.vertex(v);
                *back = Vector3::from_column_slice(&self.sum[first..first + 3]);
            }
            if !layout.free_angles.is_empty() {
                // An angle that is given turns with its clamp: nothing comes back through it.
                self.psi.fill(0.0);
                for (f, &e) in layout.free_angles.iter().enumerate() {
                    let angle = self.sum[layout.angle(e)];
                    mixed_add(of, dx, own, angles + f, [angle]);
                    self.psi[e] = -angle;
                }
                holonomy_transpose_add(kept_bend(bends), &self.psi, back);
            }
            for (f, &v) in layout.free_vertices.iter().enumerate() {
                mixed_add(of, dx, own, 3 * f, [back[v].x, back[v].y, back[v].z]);
            }
        }
    }
}

/// Degrees of freedom at a bent vertex: three places and two angles.
const LOCAL: usize = 11;
/// Numbers kept for an edge and the vertex it starts at: the gradient of its length, and those of the three
/// strains there.
const STRAINS: usize = 3 + 3 * LOCAL;

fn put_edge(kept: &mut [f64], t: &Vector3<f64>) {
    kept[..3].copy_from_slice(t.as_slice());
}

/// out += Σ to (from·q) over all strains, the gradients `from` and `to` as they were kept.
fn couple(layout: &Layout, from: &[f64], to: &[f64], q: &[f64], out: &mut [f64]) {
    let edges = from.chunks_exact(STRAINS).zip(to.chunks_exact(STRAINS));
    for (e, (from, to)) in edges.take(layout.segments).enumerate() {
        let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
        let longer: f64 = (0..3).map(|c| from[c] * (q[b + c] - q[a + c])).sum();
        for c in 0..3 {
            out[a + c] -= to[c] * longer;
            out[b + c] += to[c] * longer;
        }
        if !layout.bending || e == 0 {
            continue;
        }
        let first = layout.vertex(e - 1);
        let (q, out) = (&q[first..first + LOCAL], &mut out[first..first + LOCAL]);
        for (from, to) in from[3..].chunks_exact(LOCAL).zip(to[3..].chunks_exact(LOCAL)) {
            let strain: f64 = from.iter().zip(q).map(|(g, q)| g * q).sum();
            out.iter_mut().zip(to).for_each(|(out, g)| *out += g * strain);
        }
    }
}
