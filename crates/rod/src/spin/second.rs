//! Second derivatives of what resists a spin, Φ = ½ a r² with r = s − s*, and of angles and spins of
//! x_{k+1}.
//!
//! With ' along μ, as the stage moves in coordinates that start where it is then
//! ([`second_order`](crate::second_order)),
//!
//! ```text
//! ∂²(μᵀG)/∂w² = a (∇r' ∇rᵀ + ∇r ∇r'ᵀ + r' ∇²r + r ∇²r')
//! w = (e_{k−1}, e_k, e_y)
//! s = T(e_k, e_p) + T(e_p, e_y) + α_y − α_k
//! s_{k−1} = T(e_{k−1}, e_k) + α_k − α_{k−1}
//! ```
//!
//! with T the twist between the carried directors of two edges, and e_p linear in e_k and e_{k−1}. Angles
//! of x_k and x_{k−1} are their stored ones less ψ, which is curved.

use nalgebra::{Matrix3, Vector3};
use num_dual::Dual64;

use super::{Configuration, Spin};
use crate::geometry::{Edge, Turn, outer, symmetric_product};
use crate::layout::{FIXED, band_product_add};
use crate::scalar::{Real, dual};
use crate::second_order::Increment;
use crate::stage::{RodStage, mixed, mixed_add};
use crate::system::System;

/// Numbers of the three edges.
const ALL: usize = 9;
/// What is kept of an edge: the matrix of the three, ∇r and ∇r' in them.
const EDGE: usize = ALL * ALL + 2 * ALL;

/// A sum of twists between edges that are sums of the three: its derivatives by these.
struct Form<T = f64> {
    first: [T; ALL],
    second: [[T; ALL]; ALL],
}

impl<T: Real> Form<T> {
    fn none() -> Form<T> {
        Form { first: [T::zero(); ALL], second: [[T::zero(); ALL]; ALL] }
    }

    /// Adds so many times the twist from edge a to edge b, which are these shares of the three.
    fn add(&mut self, [a, b]: [&Edge<T>; 2], [of_a, of_b]: [[f64; 3]; 2], times: f64) {
        let turn = Turn::between(&a.t, &b.t, 0).expect("the step was accepted before");
        let (two, four) = (T::of(2.0), T::of(4.0));
        let own = |edge: &Edge<T>| -> Matrix3<T> {
            symmetric_product(&turn.kb, &(turn.tilde + edge.t)) / (-four * edge.l * edge.l)
        };
        let both = a.l * b.l;
        let mixed: Matrix3<T> =
            a.t.cross_matrix() / (both * turn.chi) - outer(&turn.kb, &turn.tilde) / (two * both);
        let (own_a, own_b) = (own(a), own(b));
        let half = turn.kb / two;
        for i in 0..ALL {
            let (m, c) = (i / 3, i % 3);
            self.first[i] += half[c] * (T::of(times * of_a[m]) / a.l + T::of(times * of_b[m]) / b.l);
            for j in 0..ALL {
                let (n, d) = (j / 3, j % 3);
                let share = |x: f64, y: f64| T::of(times * x * y);
                self.second[i][j] += own_a[(c, d)] * share(of_a[m], of_a[n])
                    + mixed[(c, d)] * share(of_a[m], of_b[n])
                    + mixed[(d, c)] * share(of_b[m], of_a[n])
                    + own_b[(c, d)] * share(of_b[m], of_b[n]);
            }
        }
    }
}

/// r, s + a₁ s_{k−1} and r' of an edge that resists, with ∇r and ∇r'.
#[derive(Clone)]
pub(super) struct Varied {
    edge: usize,
    off: f64,
    spun: f64,
    rate: f64,
    slope: [f64; ALL],
    turned: [f64; ALL],
}

/// Work space: nothing until second derivatives are asked for.
#[derive(Default)]
pub(super) struct Work {
    /// Of every edge that resists.
    varied: Vec<Varied>,
    on_psi: [Vec<f64>; 2],
    by: Vec<f64>,
    on: Vec<f64>,
    on_places: [Vec<Vector3<f64>>; 2],
    moved: Vec<[f64; ALL + 3]>,
}

fn constant(edge: &Edge) -> Edge<Dual64> {
    Edge { t: edge.t.map(Dual64::from), l: Dual64::from(edge.l) }
}

impl Spin {
    /// How many numbers second derivatives keep: those of every edge that resists, and a band for ψ of each
    /// configuration of the past.
    pub(crate) fn second_kept(&self, system: &System, history: bool) -> usize {
        EDGE * self.resistance.len() + (1 + usize::from(history)) * system.layout.band()
    }

    /// Writes them at the present shape of `system`, that of the stage.
    pub(crate) fn keep_second(
        &mut self,
        system: &System,
        stage: &RodStage,
        [lambda, mu]: [&[f64]; 2],
        kept: &mut [f64],
    ) {
        self.measure(system).expect("u was assembled before");
        let layout = &system.layout;
        let (edges, bands) = kept.split_at_mut(EDGE * self.resistance.len());
        edges.fill(0.0);
        bands.fill(0.0);
        let mut work = std::mem::take(&mut self.second);
        let Work { varied, on_psi, .. } = &mut work;
        for on_psi in &mut *on_psi {
            on_psi.clear();
            on_psi.resize(layout.segments, 0.0);
        }
        varied.clear();
        let ([b0, b1], [_, a1], h) = (stage.of.to, self.from, stage.of.length);
        for (e, kept) in edges.chunks_exact_mut(EDGE).enumerate().filter(|(e, _)| self.resistance[*e] != 0.0)
        {
            let a = self.resistance[e];
            let moved = Increment(mu).of_edge(layout, e);
            let (form, mut of_next) = (self.form(system, e, &moved), Form::none());
            let longer: f64 = (0..3).map(|c| form.first[6 + c].re * (moved[3 + c] - moved[c])).sum();
            let (off, rate) = (self.now[e].spin - self.target[e], moved[6] + longer);
            let spun = self.now[e].spin + a1 * self.reference[e].spun_before;
            let (slope, turned) = (form.first.map(|d| d.re), form.first.map(|d| d.eps));
            varied.push(Varied { edge: e, off, spun, rate, slope, turned });
            let (mut on_spin, mut on_angle) = (0.0, 0.0);
            if layout.spins {
                let f = layout.free_angles.binary_search(&e).expect("a given angle does not resist");
                on_spin = b0 / h * lambda[layout.first_spin() + f];
                if b1 != 0.0 {
                    on_angle = lambda[6 * layout.free_vertices.len() + f];
                    let (then, next) = (&self.before.shape.edges[e], &self.next.shape.edges[e]);
                    of_next.add([then, next], [[0.0, 1.0, 0.0], [0.0, b1, b0]], -on_angle);
                    self.add_spin(e, system.shape.edges[e], b0 * on_angle, &mut of_next);
                }
            }
            for i in 0..ALL {
                for j in 0..ALL {
                    let second = form.second[i][j];
                    kept[ALL * i + j] =
                        (a * rate + on_spin) * second.re + a * off * second.eps + of_next.second[i][j];
                }
            }
            kept[ALL * ALL..][..ALL].copy_from_slice(&slope);
            kept[ALL * ALL + ALL..].copy_from_slice(&turned);
            // what is on α_k and α_{k−1}, which are θ − ψ
            let on = a * rate + on_spin;
            on_psi[0][e] = on * (1.0 - a1) + on_angle * (b0 - 1.0);
            on_psi[1][e] = on * a1;
        }
        let past = [&self.before, &self.earlier].into_iter().zip(on_psi);
        for ((past, on_psi), band) in past.zip(bands.chunks_exact_mut(layout.band().max(1))) {
            if on_psi.iter().any(|w| *w != 0.0) {
                system.holonomy_second_add(&past.shape, on_psi, band);
            }
        }
        self.second = work;
    }

    /// That of r, its edge of the stage moved by ε μ.
    fn form(&self, system: &System, e: usize, moved: &[f64; 7]) -> Form<Dual64> {
        let end = |i: usize| dual(&system.x[e + i], &Vector3::from_column_slice(&moved[3 * i..3 * i + 3]));
        let stage = Edge::between(&end(0), &end(1), e).expect("this shape was assembled before");
        let mut form = Form::none();
        self.add_spin(e, stage, 1.0, &mut form);
        if self.with_past {
            let [now, then] = [&self.before, &self.earlier].map(|c| constant(&c.shape.edges[e]));
            form.add([&then, &now], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], self.from[1]);
        }
        form
    }

    /// Adds so many times that of s, `stage` being the edge of the stage.
    fn add_spin<T: Real>(&self, e: usize, stage: Edge<T>, times: f64, form: &mut Form<T>) {
        let of = |edge: &Edge| Edge { t: edge.t.map(T::of), l: T::of(edge.l) };
        let reference = of(&self.reference[e].edge);
        if !self.with_past {
            return form.add([&reference, &stage], [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], times);
        }
        let [now, past] = self.reference[e].along;
        let by = [past, now, 0.0];
        form.add([&of(&self.before.shape.edges[e]), &reference], [[0.0, 1.0, 0.0], by], times);
        form.add([&reference, &stage], [by, [0.0, 0.0, 1.0]], times);
    }

    /// (rx, ru) += the products, the configurations of the past being those of the step.
    pub(crate) fn second_add(
        &mut self,
        system: &System,
        kept: &[f64],
        [dx, du]: [&[f64]; 2],
        [rx, ru]: [&mut [f64]; 2],
    ) {
        let layout = &system.layout;
        let (edges, bands) = kept.split_at(EDGE * self.resistance.len());
        self.set_increment(system, dx);
        let mut work = std::mem::take(&mut self.second);
        let Work { by, on, on_places, moved, .. } = &mut work;
        let bands = bands.chunks_exact(layout.band().max(1));
        let past = [&self.before, &self.earlier].into_iter().take(1 + usize::from(self.with_past));
        on_places.iter_mut().for_each(Vec::clear);
        for ((past, band), on_places) in past.zip(bands).zip(&mut *on_places) {
            past.curved(system, band, [&mut *by, &mut *on], on_places);
        }
        moved.clear();
        moved.extend((0..self.resistance.len()).map(|e| self.moved_at(system, e, du)));
        self.clear();
        let ([_, a1], first) = (self.from, layout.first_spin());
        for ((e, kept), by) in edges.chunks_exact(EDGE).enumerate().zip(&*moved) {
            let a = self.resistance[e];
            if a == 0.0 {
                continue;
            }
            let (matrix, slopes) = kept.split_at(ALL * ALL);
            let (slope, turned) = slopes.split_at(ALL);
            let dot = |row: &[f64]| row.iter().zip(by).map(|(r, by)| r * by).sum::<f64>();
            let [then, now, stage] = [by[ALL], by[ALL + 1], by[ALL + 2]];
            let mut off = dot(slope) + stage - now + a1 * (now - then);
            let spin = layout.spins.then(|| layout.free_angles.binary_search(&e).expect("it resists"));
            if let Some(f) = spin {
                off -= self.rate * mixed(self.from, dx, layout.state(), first + f);
            }
            let varied = a * dot(turned);
            let on: [f64; ALL] = std::array::from_fn(|i| {
                dot(&matrix[ALL * i..ALL * (i + 1)]) + a * turned[i] * off + slope[i] * varied
            });
            self.before.add_edge(e, &on[3..6], varied * (a1 - 1.0));
            self.earlier.add_edge(e, &on[..3], -varied * a1);
            if let Some(f) = spin {
                mixed_add(self.from, rx, layout.state(), first + f, [-self.rate * varied]);
            }
            stage_add(system, e, &on[6..], varied, ru);
        }
        for (past, on) in [&mut self.before, &mut self.earlier].into_iter().zip(&*on_places) {
            past.displacement.iter_mut().zip(on).for_each(|(d, on)| *d += on);
        }
        self.second = work;
        self.transpose_add(system, rx);
    }

    /// Adds ∂²(μᵀG)/∂w∂g of a change of the inertia of sections, and of α/η by `rate`, to (rx,
    /// ru), with what was kept last; returns ∂(μᵀG)/∂g.
    pub(crate) fn second_of_change(
        &mut self,
        system: &System,
        (inertia, [k, c], rate): (&[f64], [f64; 2], f64),
        [rx, ru]: [&mut [f64]; 2],
    ) -> f64 {
        let layout = &system.layout;
        let ([_, a1], first) = (self.from, layout.first_spin());
        let (mut sum, work) = (0.0, std::mem::take(&mut self.second));
        self.clear();
        for v in &work.varied {
            let e = v.edge;
            let more = inertia.get(e).copied().unwrap_or(0.0) * (k + c);
            let slower = system.rod.spin_inertia[e] * rate;
            let moment = more * v.off + slower * v.spun;
            sum += moment * v.rate;
            let by_spin = (more + slower) * v.rate;
            let on: [f64; ALL] = std::array::from_fn(|i| by_spin * v.slope[i] + moment * v.turned[i]);
            self.before.add_edge(e, &on[3..6], by_spin * (a1 - 1.0));
            self.earlier.add_edge(e, &on[..3], -by_spin * a1);
            let f = layout.free_angles.binary_search(&e).expect("a given angle does not resist");
            mixed_add(self.from, rx, layout.state(), first + f, [-self.rate * more * v.rate]);
            stage_add(system, e, &on[6..], by_spin, ru);
        }
        self.second = work;
        self.transpose_add(system, rx);
        sum
    }

    /// ∂²(μᵀG)/∂g∂g' of two such changes.
    pub(crate) fn second_of_changes(&self, inertia: [&[f64]; 2], rates: [f64; 2]) -> f64 {
        let of = |v: &Varied| {
            let [a, b] = inertia.map(|i| i.get(v.edge).copied().unwrap_or(0.0));
            (a * rates[1] + b * rates[0]) * v.spun * v.rate
        };
        self.second.varied.iter().map(of).sum()
    }

    /// Increments of the three edges of an edge, and of their angles.
    fn moved_at(&self, system: &System, e: usize, du: &[f64]) -> [f64; ALL + 3] {
        let layout = &system.layout;
        let of = |full: usize| match layout.unknown[full] {
            FIXED => 0.0,
            unknown => du[unknown],
        };
        let moved = |past: &Configuration| past.displacement[e + 1] - past.displacement[e];
        let then = if self.with_past { moved(&self.earlier) } else { Vector3::zeros() };
        let now = moved(&self.before);
        let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
        std::array::from_fn(|i| match i {
            0..3 => then[i],
            3..6 => now[i - 3],
            6..9 => of(b + i - 6) - of(a + i - 6),
            9 if self.with_past => self.earlier.turned[e],
            9 => 0.0,
            10 => self.before.turned[e],
            _ => of(layout.angle(e)),
        })
    }
}

/// Adds what acts on an edge of the stage and on its angle.
fn stage_add(system: &System, e: usize, on: &[f64], turned: f64, ru: &mut [f64]) {
    let layout = &system.layout;
    let entries = [-on[0], -on[1], -on[2], turned, on[0], on[1], on[2]];
    for (&unknown, value) in layout.unknown[layout.vertex(e)..][..7].iter().zip(entries) {
        if unknown != FIXED {
            ru[unknown] += value;
        }
    }
}

impl Configuration {
    /// What a band makes of the increment of places, in `all`; `by` and `on` are work space.
    fn curved(
        &self,
        system: &System,
        band: &[f64],
        [by, on]: [&mut Vec<f64>; 2],
        all: &mut Vec<Vector3<f64>>,
    ) {
        let layout = &system.layout;
        for zeroed in [&mut *by, on] {
            zeroed.clear();
            zeroed.resize(layout.unknowns, 0.0);
        }
        all.resize(self.displacement.len(), Vector3::zeros());
        let place = |v: usize| layout.unknown[layout.vertex(v)];
        for &v in &layout.free_vertices {
            by[place(v)..place(v) + 3].copy_from_slice(self.displacement[v].as_slice());
        }
        band_product_add(layout.half_bandwidth, band, by, on);
        for &v in &layout.free_vertices {
            all[v] = Vector3::from_column_slice(&on[place(v)..place(v) + 3]);
        }
    }

    fn add_edge(&mut self, e: usize, force: &[f64], turned: f64) {
        let force = Vector3::from_column_slice(force);
        self.displacement[e] -= force;
        self.displacement[e + 1] += force;
        self.turned[e] += turned;
    }
}
