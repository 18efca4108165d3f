//! Kelvin–Voigt damping: what the strains of steps before contribute.
//!
//! The strain rate of a stage is (ε(y) − ε*)/η with ε* a sum of strains of configurations of the past,
//! each with a weight; that sum takes part in E as a modified stiffness and rest strain
//! (`System::set_stiffness`), so that the potential and its symmetry stay. Here are the products with
//! ∂G/∂x_k = −(β/η) Σ_j w_j ∇ε(y) k ∇ε(past j)ᵀ ∂(past j)/∂x_k. Strains do not change in
//! a rigid motion, so neither does ε*.

use nalgebra::Vector3;
use varda_implicit::Interval;

use crate::element::{LOCAL, STRAINS, Strains};
use crate::layout::{FIXED, Layout, band_product_add};
use crate::moved_increment::{Increments, in_full_order};
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
    /// Work space of second derivatives: nothing until they are asked for.
    of_stage: Vec<f64>,
    unknowns: [Vec<f64>; 2],
    stresses: Vec<[f64; 4]>,
    weights: Vec<f64>,
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
            of_stage: Vec::new(),
            unknowns: [Vec::new(), Vec::new()],
            stresses: Vec::new(),
            weights: Vec::new(),
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

    /// ε*, taken out for a while.
    pub(crate) fn take_past(&mut self) -> PastStrains {
        std::mem::take(&mut self.past)
    }

    /// Puts it back.
    pub(crate) fn put_past(&mut self, past: PastStrains) {
        self.past = past;
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
        self.sum.fill(0.0);
        for (of, strains, bends) in Self::kept_past(layout, stage, kept) {
            self.of_past(layout, of, bends, dx);
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
        layout.fill(mu, &mut self.full);
        for (of, strains, bends) in Self::kept_past(layout, stage, kept) {
            self.sum.fill(0.0);
            couple(layout, kept, strains, &self.full, &mut self.sum);
            self.of_past_transpose_add(layout, of, bends, dx);
        }
    }

    /// dg += what a parameter does that moves the supports of the past, right after the step was prepared,
    /// with what was kept of it.
    pub(crate) fn moved_add(
        &mut self,
        system: &System,
        (at, stage): (&Interval, &RodStage),
        kept: &[f64],
        parameter: usize,
        work: &mut Increments,
        dg: &mut [f64],
    ) {
        let (layout, before) = (&system.layout, at.previous.unwrap_or(0.0));
        let Increments { places, angles, full, .. } = work;
        self.sum.fill(0.0);
        let ages = stage.past().zip(&self.configurations);
        for (((_, age, _), past), (_, strains, _)) in ages.zip(Self::kept_past(layout, stage, kept)) {
            let time = at.start - age * before;
            if system.moved_increment(&past.shape, parameter, time, places, angles).is_some() {
                in_full_order(layout, places, angles, full);
                couple(layout, strains, kept, full, &mut self.sum);
            }
        }
        for (value, &unknown) in self.sum.iter().zip(&layout.unknown) {
            if unknown != FIXED {
                dg[unknown] += value;
            }
        }
    }

    /// dx += Σ_j w_j Σ s ∂ε/∂x_k of the strains of the past, one stress s for each of edge and vertex,
    /// right after the step was prepared, with what was kept of it.
    pub(crate) fn past_transpose_add(
        &mut self,
        layout: &Layout,
        stage: &RodStage,
        kept: &[f64],
        stresses: &[[f64; 4]],
        dx: &mut [f64],
    ) {
        for (j, (of, _, bends)) in Self::kept_past(layout, stage, kept).enumerate() {
            self.of_stresses(layout, j, stresses);
            self.of_past_transpose_add(layout, of, bends, dx);
        }
    }

    /// w_j Σ s ∂ε of a configuration of the past, in the full order, one stress s for each of edge and
    /// vertex.
    pub(crate) fn of_stresses(&mut self, layout: &Layout, j: usize, stresses: &[[f64; 4]]) -> &[f64] {
        self.sum.fill(0.0);
        let past = &self.configurations[j];
        for (e, stress) in stresses.iter().enumerate() {
            let [along, bend @ ..] = stress.map(|s| past.weight * s);
            let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
            for c in 0..3 {
                self.sum[a + c] -= along * past.shape.edges[e].t[c];
                self.sum[b + c] += along * past.shape.edges[e].t[c];
            }
            let Some(strains) = e.checked_sub(1).and_then(|v| past.strains.get(v)) else { continue };
            let local = &mut self.sum[layout.vertex(e - 1)..];
            for (gradient, s) in strains.gradient.iter().zip(bend) {
                local.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += s * g);
            }
        }
        &self.sum
    }

    /// The shapes of the past, and how many steps before x_k they are.
    pub(crate) fn past_shapes(&self, stage: &RodStage) -> impl Iterator<Item = (f64, &Shape)> {
        stage.past().zip(&self.configurations).map(|((_, age, _), past)| (age, &past.shape))
    }

    /// `full` = the increment of a configuration of the past, in its own local angles.
    fn of_past(&mut self, layout: &Layout, of: [f64; 2], bends: &[f64], dx: &[f64]) {
        let (own, angles) = (layout.state(), 6 * layout.free_vertices.len());
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
    }

    /// The transpose: dx += that of `sum`.
    fn of_past_transpose_add(&mut self, layout: &Layout, of: [f64; 2], bends: &[f64], dx: &mut [f64]) {
        let (own, angles) = (layout.state(), 6 * layout.free_vertices.len());
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

    /// How many numbers second derivatives keep of a solved step: k ∂²ε[μ] of the stage, then a band for
    /// every configuration of the past.
    pub(crate) fn second_kept(&self, layout: &Layout) -> usize {
        STRAINS * layout.segments + self.configurations.len() * layout.band()
    }

    /// Writes the bands: with the stresses s = k ∂ε(y)[μ] of the stage, and its own share and weight −r
    /// w, Σ s ∂²ε of each configuration of the past, in its stored angles. `mu` is in the full order;
    /// the rest of what is kept `System::third_add` writes. `free_angles` are those that are not given.
    pub(crate) fn keep_second(
        &mut self,
        system: &System,
        free_angles: &[usize],
        [kept, mu]: [&[f64]; 2],
        bands: &mut [f64],
    ) {
        let (layout, n) = (&system.layout, system.layout.segments);
        let Self { configurations, used, share, stresses, weights, .. } = self;
        stresses.resize(n, [0.0; 4]);
        for_each_strain(layout, &kept[..STRAINS * n], mu, |e, value| stresses[e] = value);
        let used = configurations[..*used].iter();
        for (past, band) in used.zip(bands.chunks_exact_mut(layout.band().max(1))) {
            band.fill(0.0);
            let share = -*share * past.weight;
            system.strains_second_add(&past.shape, stresses, share, band);
            if free_angles.is_empty() {
                continue;
            }
            // what its local angles are moved by: −ψ
            weights.clear();
            weights.resize(n, 0.0);
            for (vertex, strains) in past.strains.iter().enumerate() {
                let [_, stress @ ..] = stresses[vertex + 1].map(|s| share * s);
                for (gradient, s) in strains.gradient.iter().zip(stress) {
                    weights[vertex] -= s * gradient[3];
                    weights[vertex + 1] -= s * gradient[7];
                }
            }
            for e in (0..n).filter(|e| free_angles.binary_search(e).is_err()) {
                weights[e] = 0.0;
            }
            system.holonomy_second_add(&past.shape, weights, band);
        }
    }

    /// (rx, ru) += the second derivatives of μᵀG in x_k and u, those in u alone excepted.
    pub(crate) fn second_add(
        &mut self,
        layout: &Layout,
        stage: &RodStage,
        [kept, second]: [&[f64]; 2],
        [dx, du]: [&[f64]; 2],
        [rx, ru]: [&mut [f64]; 2],
    ) {
        let (strained, bands) = second.split_at(STRAINS * layout.segments);
        let mut bands = bands.chunks_exact(layout.band().max(1));
        let mut of_stage = std::mem::take(&mut self.of_stage);
        of_stage.resize(layout.full(), 0.0);
        layout.fill(du, &mut of_stage);
        let [mut own, mut product] = std::mem::take(&mut self.unknowns);
        own.resize(layout.unknowns, 0.0);
        product.resize(layout.unknowns, 0.0);
        for (of, strains, bends) in Self::kept_past(layout, stage, kept) {
            self.of_past(layout, of, bends, dx);
            self.sum.fill(0.0);
            couple(layout, strains, strained, &self.full, &mut self.sum);
            layout.take(&self.sum, &mut product);
            ru.iter_mut().zip(&product).for_each(|(r, p)| *r += p);
            layout.take(&self.full, &mut own);
            product.fill(0.0);
            band_product_add(layout.half_bandwidth, bands.next().unwrap_or(&[]), &own, &mut product);
            layout.fill(&product, &mut self.sum);
            couple(layout, strained, strains, &of_stage, &mut self.sum);
            self.of_past_transpose_add(layout, of, bends, rx);
        }
        (self.of_stage, self.unknowns) = (of_stage, [own, product]);
    }
}

impl KelvinVoigt {
    /// μᵀ ∂G by every configuration of the past, `mu` and these in the full order.
    pub(crate) fn on_past(
        &self,
        layout: &Layout,
        stage: &RodStage,
        kept: &[f64],
        mu: &[f64],
    ) -> Vec<Vec<f64>> {
        let of = |(_, strains, _)| {
            let mut on = vec![0.0; layout.full()];
            couple(layout, kept, strains, mu, &mut on);
            on
        };
        Self::kept_past(layout, stage, kept).map(of).collect()
    }

    /// Adds the second derivatives of μᵀG by the stage and configuration j of the past, times increments
    /// of both, to what acts on both: `strained` is k ∂²ε[μ] of the stage.
    pub(crate) fn second_of_both_add(
        &self,
        (layout, stage, j): (&Layout, &RodStage, usize),
        [kept, strained]: [&[f64]; 2],
        [now, past]: [&[f64]; 2],
        [on_now, on_past]: [&mut [f64]; 2],
    ) {
        let (_, strains, _) =
            Self::kept_past(layout, stage, kept).nth(j).expect("a configuration of the past");
        couple(layout, strains, strained, past, on_now);
        couple(layout, strained, strains, now, on_past);
    }

    /// dx += what acts on configuration j of the past, in the full order.
    pub(crate) fn onto_past(
        &mut self,
        (layout, stage, j): (&Layout, &RodStage, usize),
        kept: &[f64],
        on: &[f64],
        dx: &mut [f64],
    ) {
        let (of, _, bends) =
            Self::kept_past(layout, stage, kept).nth(j).expect("a configuration of the past");
        self.sum.copy_from_slice(on);
        self.of_past_transpose_add(layout, of, bends, dx);
    }
}

fn put_edge(kept: &mut [f64], t: &Vector3<f64>) {
    kept[..3].copy_from_slice(t.as_slice());
}

/// The gradients of the strains of edge e and of the vertex it starts at, as they were kept: of its length,
/// and of the three strains of the vertex in the local order.
fn kept_at(kept: &[f64], e: usize) -> (&[f64; 3], &[[f64; LOCAL]]) {
    let (edge, vertex) = kept[STRAINS * e..STRAINS * (e + 1)].split_first_chunk().expect("an edge's numbers");
    (edge, vertex.as_chunks().0)
}

/// The local numbers, in the full order, of the vertex that edge e starts at.
fn local(layout: &Layout, e: usize) -> std::ops::Range<usize> {
    layout.vertex(e - 1)..layout.vertex(e - 1) + LOCAL
}

/// Each strain's gradient, as it was kept, times q: `visit(e, [l, κ₁, κ₂, τ])` for the length of edge
/// e and the strains of the vertex it starts at (zero where nothing bends).
fn for_each_strain(layout: &Layout, from: &[f64], q: &[f64], mut visit: impl FnMut(usize, [f64; 4])) {
    for e in 0..layout.segments {
        let (edge, bends) = kept_at(from, e);
        let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
        let mut value = [(0..3).map(|c| edge[c] * (q[b + c] - q[a + c])).sum(), 0.0, 0.0, 0.0];
        if layout.bending && e > 0 {
            // the three sums side by side: one after the other each waits for its last addition
            for (i, q) in q[local(layout, e)].iter().enumerate() {
                (0..3).for_each(|strain| value[strain + 1] += bends[strain][i] * q);
            }
        }
        visit(e, value);
    }
}

/// out += Σ to (from·q) over all strains, the gradients `from` and `to` as they were kept.
fn couple(layout: &Layout, from: &[f64], to: &[f64], q: &[f64], out: &mut [f64]) {
    for_each_strain(layout, from, q, |e, [longer, bent @ ..]| {
        let (edge, bends) = kept_at(to, e);
        let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
        for c in 0..3 {
            out[a + c] -= edge[c] * longer;
            out[b + c] += edge[c] * longer;
        }
        if layout.bending && e > 0 {
            for (i, out) in out[local(layout, e)].iter_mut().enumerate() {
                (0..3).for_each(|strain| *out += bends[strain][i] * bent[strain]);
            }
        }
    });
}
