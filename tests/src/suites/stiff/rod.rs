//! Rods in motion: stiff, slender, cut fine, driven hard, wildly strained.
//!
//! The measured error of a step is its distance from the root: the forces at the accepted state are computed anew by the
//! formulas below (stretching by length, bending of an isotropic rod by the angle φ alone, E = 2 EI tan²(φ/2)/l̄), and
//! Newton's correction for what they leave is taken with the step's own Jacobian.

use super::{condition, interval, work};
use crate::problems::{rod_scale, wave};
use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use std::sync::Arc;
use varda_implicit::{Counts, ImplicitModel, ImplicitStep, LinearSolver, Model, check};
use varda_rod::{Clamp, Damping, Loads, Material, Rod, RodStep, Section, Supports};

const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];

/// Distance from the root over L that counts as solved: a step ends when an update falls below 1e-11 L. Convergence is quadratic
/// there, so that mostly rounding alone is left, some ε.
const ROOT: f64 = 1e-11;

/// A rod of circular section hanging from a clamp that moves sideways at a constant speed.
#[derive(Clone)]
struct Hanging {
    length: f64,
    segments: usize,
    section: Section,
    dt: f64,
    /// What the clamp moves in a step, in segments.
    moved: f64,
}

const SILICONE: Material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1100.0 };

impl Hanging {
    /// The paper's rod: 1 m of silicone, 10 mm in radius, 25 segments; 0.3 segments per step of 0.01 s.
    fn paper() -> Hanging {
        Hanging { length: 1.0, segments: 25, section: Section::circle(&SILICONE, 0.01), dt: 0.01, moved: 0.3 }
    }

    fn model(&self) -> Result<ImplicitModel<RodStep>, varda_rod::Error> {
        let rod = Rod::uniform(self.length, self.segments, &self.section)?;
        let speed = self.moved * self.length / self.segments as f64 / self.dt;
        let clamp = Clamp {
            position: Arc::new(move |t: f64| [speed * t, 0.0, 0.0]),
            tangent: Arc::new([0.0, 0.0, -1.0]),
            director: Arc::new([1.0, 0.0, 0.0]),
        };
        let loads = Loads { gravity: GRAVITY, ..Loads::default() };
        let step = RodStep::new(rod, Supports::clamped_start(clamp), loads, Damping::default())?;
        Ok(ImplicitModel::new(step, 0, self.dt))
    }

    /// Straight down, unstretched, at rest; each segment strained by up to `strain` and turned by up to `turn`, at random.
    fn start(&self, strain: f64, turn: f64) -> Vec<f64> {
        let l = self.length / self.segments as f64;
        let mut z = vec![0.0; 6 * (self.segments - 1)];
        let mut at = [0.0, 0.0, -l];
        for e in 1..self.segments {
            let tilt = [turn * wave(e, 5), turn * wave(e, 6), -1.0];
            let size = tilt.iter().map(|t| t * t).sum::<f64>().sqrt();
            for c in 0..3 {
                at[c] += l * (1.0 + strain * wave(e, 7)) * tilt[c] / size;
                z[3 * (e - 1) + c] = at[c];
            }
        }
        z
    }
}

pub(super) fn run(rows: &mut Rows, options: &Options) {
    let base = Hanging::paper();
    for youngs in [1e5, 1e6, 1e8, 1e10, 1e12] {
        let material = Material { youngs_modulus: youngs, shear_modulus: youngs / 3.0, ..SILICONE };
        let section = Section::circle(&material, 0.01);
        swung(rows, &format!("E = {youngs:.0e} Pa"), &Hanging { section, ..base.clone() }, 10);
    }
    for slenderness in [1e1, 1e2, 1e3, 1e4, 1e5] {
        let section = Section::circle(&SILICONE, 1.0 / slenderness);
        swung(
            rows,
            &format!("slenderness L/r = {slenderness:.0e}"),
            &Hanging { section, ..base.clone() },
            10,
        );
    }
    // EA l²/EI of the paper's rod is 64: from 1 to 1e10, softer and stiffer in stretch, then softer in bending.
    for ratio in [1e0_f64, 1e2, 1e4, 1e6, 1e8, 1e10] {
        let mut section = base.section;
        let l2 = (base.length / base.segments as f64).powi(2);
        let geometric = (section.ea * l2 * section.ei1).sqrt();
        (section.ea, section.ei1) = (geometric * ratio.sqrt() / l2, geometric / ratio.sqrt());
        section.ei2 = section.ei1;
        swung(rows, &format!("EA l²/EI = {ratio:.0e}"), &Hanging { section, ..base.clone() }, 10);
    }
    // everything at once: stiff and fine
    for segments in [400, 1600] {
        let stiff = Material { youngs_modulus: 1e12, shear_modulus: 1e12 / 3.0, ..SILICONE };
        let section = Section::circle(&stiff, 0.01);
        let hanging = Hanging { section, segments, dt: 0.02, moved: 1.0, ..base.clone() };
        swung(rows, &format!("E = 1e12 Pa, {segments} segments"), &hanging, 3);
    }
    let fine: &[(usize, usize)] =
        if options.quick { &[(400, 5), (1600, 3)] } else { &[(400, 10), (1600, 10), (20_000, 4)] };
    for &(segments, steps) in fine {
        swung(rows, &format!("{segments} segments"), &Hanging { segments, ..base.clone() }, steps);
    }
    let driven: &[usize] = if options.quick { &[25, 400] } else { &[25, 400, 1600] };
    for &segments in driven {
        for moved in [0.1, 1.0, 2.5, 10.0] {
            let hanging = Hanging { segments, moved, dt: 0.02, ..base.clone() };
            swung(rows, &format!("{segments} segments, clamp moves {moved} of them in 0.02 s"), &hanging, 5);
        }
    }
    for (segments, youngs) in [(25, 1e6), (100, 1e6), (400, 1e6), (25, 1e9), (100, 1e9)] {
        let material = Material { youngs_modulus: youngs, shear_modulus: youngs / 3.0, ..SILICONE };
        let hanging = Hanging { segments, section: Section::circle(&material, 0.01), ..base.clone() };
        let name = format!("15 % random strain, turned by 0.3, {segments} segments, E = {youngs:.0e} Pa");
        from(rows, &name, &hanging, &hanging.start(0.15, 0.3), 10);
    }
    // A pendulum of 1 m swings in about 1.6 s.
    for periods in [1e-6, 1e-4, 1e-2, 1e-1, 1.0, 10.0] {
        let hanging = Hanging { dt: 1.6 * periods, ..base.clone() };
        swung(rows, &format!("steps of {periods:.0e} periods"), &hanging, 10);
    }
}

fn swung(rows: &mut Rows, name: &str, hanging: &Hanging, steps: usize) {
    from(rows, name, hanging, &hanging.start(0.0, 0.0), steps);
}

/// Runs the steps and measures their distance from the root; derivatives of the last one.
fn from(rows: &mut Rows, name: &str, hanging: &Hanging, z: &[f64], steps: usize) {
    rows.case(name, |case| {
        let mut model = hanging.model()?;
        let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(z, &mut x)?;
        let mut worst = Distance::default();
        for k in 0..steps {
            let parts = model.counts().substeps;
            model.step(k, &x, &mut next)?;
            if model.counts().substeps == parts {
                worst = worst.max(distance(&mut model, hanging, k, &x, &next));
            }
            if k + 1 < steps {
                std::mem::swap(&mut x, &mut next);
            }
        }
        let note = work(&model, &Counts::default(), worst.condition);
        case.at_most(&format!("distance from the root over L, {steps} steps"), worst.root, ROOT, "-")
            .computed(worst.condition)
            .note(note);
        if hanging.segments <= 400 {
            derivatives(case, &mut model, hanging.dt, steps - 1, &x, &next, worst.condition)?;
        }
        Ok(())
    });
}

/// Dot product and Taylor slope of step k from x to `next`.
fn derivatives(
    case: &mut Case,
    model: &mut ImplicitModel<RodStep>,
    dt: f64,
    k: usize,
    x: &[f64],
    next: &[f64],
    condition: f64,
) -> Outcome {
    let scale = rod_scale(model.step_ref());
    model.linearize(k, x, next)?;
    let dot = check::dot_product(model, k..k + 1, &scale, 11)?;
    // V' = (X' − X)/Δt: a rounding ε of δX becomes ε δX/Δt in δV, however well M itself is conditioned
    let divided = 50.0 * f64::EPSILON * scale[0] / (dt * scale[scale.len() / 2]);
    case.at_most("dot product of the step", dot.value, dot.bound.max(divided), "-");
    // perturbations of a tenth of a segment, and 0.1 m/s
    let l = model.step_ref().rod().rest_lengths[0];
    let direction: Vec<f64> =
        scale.iter().enumerate().map(|(i, s)| if *s < 1.0 { 0.1 * l } else { 0.1 } * wave(i, 12)).collect();
    let taylor = check::taylor_step(model, k, x, &direction, &scale)?;
    // A solve errs by ε times the condition: beyond 1e9 the remainder falls like h before h² can be seen over ten halvings. Then
    // what is left of it at the smallest step, over h ‖M d‖, is that error.
    if condition > 1e9 && taylor.slope < 1.95 {
        let mut tangent = direction;
        model.tangent(k, &mut tangent);
        let size = tangent.iter().zip(&scale).map(|(t, s)| (t / s).powi(2)).sum::<f64>().sqrt();
        let left = taylor.points.last().map_or(f64::NAN, |(h, rest)| rest / (h * size));
        case.at_most("tangent of the step, relative error", left, 10.0 * f64::EPSILON * condition, "-");
        return Ok(());
    }
    case.at_most("Taylor slope of the step, 2 − slope", 2.0 - taylor.slope, 0.05, "-").computed(taylor.slope);
    Ok(())
}

/// How far an accepted step is from the root.
#[derive(Default, Clone, Copy)]
struct Distance {
    /// Largest component of Newton's correction, over L.
    root: f64,
    /// Of the step's Jacobian.
    condition: f64,
}

impl Distance {
    fn max(self, other: Distance) -> Distance {
        // not f64::max, which forgets a NaN
        let larger = |a: f64, b: f64| if a >= b { a } else { b };
        Distance { root: larger(self.root, other.root), condition: larger(self.condition, other.condition) }
    }
}

fn distance(
    model: &mut ImplicitModel<RodStep>,
    hanging: &Hanging,
    k: usize,
    x: &[f64],
    next: &[f64],
) -> Distance {
    let at = interval(k, model.time(k), hanging.dt);
    let step = model.step_mut();
    let n = step.unknowns();
    let structure = step.structure();
    let mut solver = LinearSolver::new(n, &structure);
    let (mut u, mut g, mut values) = (vec![0.0; n], vec![0.0; n], vec![0.0; solver.values_len()]);
    step.recover(&at, x, next, &mut u);
    if step.assemble(&at, x, &u, &mut g, Some(&mut values)).is_err() {
        return Distance { root: f64::NAN, condition: f64::NAN };
    }
    let vertices = step.vertices(at.end(), next).expect("it was assembled");
    let mut residual = forces(step.rod(), &vertices);
    let (m, dt) = (&step.rod().masses, hanging.dt);
    let free = n / 3;
    for f in 0..free {
        for c in 0..3 {
            let (place, velocity) = (x[3 * f + c], x[3 * (free + f) + c]);
            let inertia = (next[3 * f + c] - place - dt * velocity) / (dt * dt) - GRAVITY[c];
            residual[3 * (f + 2) + c] += m[f + 2] * inertia;
        }
    }
    let mut correction = residual.split_off(6);
    let mut factor = solver.empty_factor();
    if solver.factor(&values, &mut factor).is_err() {
        return Distance { root: f64::NAN, condition: f64::INFINITY };
    }
    solver.solve(&factor, &mut correction);
    let root = correction.iter().fold(0.0, |m: f64, c| if c.abs() <= m { m } else { c.abs() });
    Distance { root: root / hanging.length, condition: condition(n, &structure, &values) }
}

/// ∂E/∂x of an isotropic, naturally straight rod, three numbers per vertex: with c = t·t', |κb|² = 4 (1 − c)/(1 + c).
fn forces(rod: &Rod, x: &[[f64; 3]]) -> Vec<f64> {
    let n = rod.segments();
    let mut out = vec![0.0; 3 * (n + 1)];
    let edge = |e: usize| -> ([f64; 3], f64) {
        let d: [f64; 3] = std::array::from_fn(|c| x[e + 1][c] - x[e][c]);
        let l = dot(d, d).sqrt();
        (d.map(|d| d / l), l)
    };
    for e in 0..n {
        let (t, l) = edge(e);
        let force = rod.ea[e] * (l - rod.rest_lengths[e]) / rod.rest_lengths[e];
        for c in 0..3 {
            out[3 * e + c] -= force * t[c];
            out[3 * e + 3 + c] += force * t[c];
        }
    }
    for i in 1..n {
        let ((p, lp), (q, lq)) = (edge(i - 1), edge(i));
        let sum: [f64; 3] = std::array::from_fn(|c| p[c] + q[c]);
        let chi = 0.5 * dot(sum, sum);
        let slope = -4.0 * rod.ei[i - 1][0] / (rod.voronoi_lengths[i - 1] * chi * chi);
        // q − (p·q) p = p × (q × p) = (p × (q − p)) × p
        let axis = cross(p, std::array::from_fn(|c| q[c] - p[c]));
        let (along_p, along_q) = (cross(axis, p), cross(q, axis));
        for c in 0..3 {
            let (a, b) = (slope * along_p[c] / lp, slope * along_q[c] / lq);
            out[3 * (i - 1) + c] -= a;
            out[3 * i + c] += a - b;
            out[3 * (i + 1) + c] += b;
        }
    }
    out
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
