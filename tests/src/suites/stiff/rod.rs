//! Rods in motion: stiff, slender, cut fine, driven hard, wildly strained.
//!
//! The measured error of a step is its distance from the root: the forces at the accepted state are computed
//! anew by the formulas below (stretching by length, bending of an isotropic rod by the angle φ alone, E = 2
//! EI tan²(φ/2)/l̄), and Newton's correction for what they leave is taken with the step's own Jacobian.

use super::common::{condition, interval, work};
use crate::row::{Case, Outcome, Rows};
use problems::counted::Counted;
use problems::rods::{rod_scale, wave};
use varda_implicit::{
    Equations, Error, ImplicitModel, ImplicitStep, LinearSolver, Model, NewtonOptions, Scheme, check,
};
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Section, Supports, TwistUnknowns, Vector3,
};

const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];

/// Distance from the root over L that counts as solved.
pub(super) const ROOT: f64 = 1e-11;
pub(super) const ROOT_REASON: &str = "a step ends at an update below 1e-11 L";

/// A rod of circular section hanging from a clamp that moves sideways at a constant speed.
#[derive(Clone)]
struct Hanging {
    length: f64,
    segments: usize,
    section: Section,
    dt: f64,
    /// What the clamp moves in a step, in segments.
    moved: f64,
    scheme: Scheme,
    twist: TwistUnknowns,
}

const SILICONE: Material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1100.0 };

/// A round rod of 10 mm in radius of this stiffness.
fn round(youngs_modulus: f64) -> Section {
    Section::circle(&Material { youngs_modulus, shear_modulus: youngs_modulus / 3.0, ..SILICONE }, 0.01)
}

impl Hanging {
    /// The paper's rod: 1 m of silicone, 10 mm in radius, 25 segments; 0.3 segments per step of 0.01 s.
    fn paper() -> Hanging {
        Hanging {
            length: 1.0,
            segments: 25,
            section: round(1e6),
            dt: 0.01,
            moved: 0.3,
            scheme: Scheme::BackwardEuler,
            twist: TwistUnknowns::WhereNeeded,
        }
    }

    /// Sections whose EA l²/EI is this, at the geometric mean of the paper's two (there it is 64).
    fn with_ratio(mut self, ratio: f64) -> Hanging {
        let l2 = (self.length / self.segments as f64).powi(2);
        let geometric = (self.section.ea * l2 * self.section.ei1).sqrt();
        (self.section.ea, self.section.ei1) = (geometric * ratio.sqrt() / l2, geometric / ratio.sqrt());
        self.section.ei2 = self.section.ei1;
        self
    }

    fn model(&self) -> Result<Counted<ImplicitModel<RodStep>>, varda_rod::Error> {
        let rod = Rod::uniform(self.length, self.segments, &self.section)?;
        let speed = self.moved * self.length / self.segments as f64 / self.dt;
        let clamp =
            Clamp::new(ClampAt::Edge, move |t: f64| [speed * t, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
        let loads = Loads { gravity: GRAVITY.into(), ..Loads::default() };
        let supports = Supports::clamped_start(clamp);
        let step = RodStep::with_twist(rod, supports, loads, Damping::default(), self.twist)?;
        Ok(Counted::new(ImplicitModel::new(step.with_scheme(self.scheme), 0, self.dt)))
    }

    /// Straight down, unstretched, at rest; each segment strained by up to `strain` and turned by up to
    /// `turn`, at random.
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

pub(super) fn run(rows: &mut Rows) {
    let base = Hanging::paper();
    for youngs in rows.grid("E", [1e5, 1e6, 1e8, 1e10, 1e12]) {
        let hanging = Hanging { section: round(youngs), ..base.clone() };
        swung(rows, &format!("E = {youngs:.0e} Pa"), &hanging, 10);
    }
    for slenderness in rows.grid("slenderness", [1e1, 1e2, 1e3, 1e4, 1e5]) {
        let section = Section::circle(&SILICONE, 1.0 / slenderness);
        swung(
            rows,
            &format!("slenderness L/r = {slenderness:.0e}"),
            &Hanging { section, ..base.clone() },
            10,
        );
    }
    for ratio in rows.grid("EA l²/EI", [1e0_f64, 1e2, 1e4, 1e6, 1e8, 1e10]) {
        swung(rows, &format!("EA l²/EI = {ratio:.0e}"), &base.clone().with_ratio(ratio), 10);
    }
    // everything at once: stiff and fine
    for segments in rows.grid("segments at E = 1e12 Pa", [400, 1600]) {
        let hanging = Hanging { section: round(1e12), segments, dt: 0.02, moved: 1.0, ..base.clone() };
        swung(rows, &format!("E = 1e12 Pa, {segments} segments"), &hanging, 3);
    }
    for (segments, steps) in rows.grid("segments", [(25, 10), (400, 10), (1600, 10), (20_000, 4)]) {
        swung(rows, &format!("{segments} segments"), &Hanging { segments, ..base.clone() }, steps);
    }
    let moves = [25, 400, 1600].into_iter().flat_map(|n| [0.1, 1.0, 2.5, 10.0].map(|moved| (n, moved)));
    for (segments, moved) in rows.grid("moves of the clamp", moves) {
        let hanging = Hanging { segments, moved, dt: 0.02, ..base.clone() };
        swung(rows, &format!("{segments} segments, clamp moves {moved} of them in 0.02 s"), &hanging, 5);
    }
    let strained = [(25, 1e6), (100, 1e6), (400, 1e6), (1600, 1e6), (25, 1e9), (100, 1e9), (400, 1e9)];
    for (segments, youngs) in rows.grid("random strain", strained) {
        let hanging = Hanging { segments, section: round(youngs), ..base.clone() };
        let name = format!("15 % random strain, turned by 0.3, {segments} segments, E = {youngs:.0e} Pa");
        from(rows, &name, &hanging, &hanging.start(0.15, 0.3), 10);
    }
    for periods in rows.grid("lengths of a step", [1e-6, 1e-4, 1e-2, 1e-1, 1.0, 10.0]) {
        swung(
            rows,
            &format!("steps of {periods:.0e} periods"),
            &Hanging { dt: PERIOD * periods, ..base.clone() },
            10,
        );
    }
    for (name, scheme, twist) in [
        ("backward Euler with twist", Scheme::BackwardEuler, TwistUnknowns::Always),
        ("midpoint", Scheme::Midpoint, TwistUnknowns::WhereNeeded),
        ("midpoint with twist", Scheme::Midpoint, TwistUnknowns::Always),
        ("BDF2", Scheme::Bdf2, TwistUnknowns::WhereNeeded),
        ("BDF2 with twist", Scheme::Bdf2, TwistUnknowns::Always),
    ] {
        stiff_ends(rows, name, &Hanging { scheme, twist, ..base.clone() });
    }
    for (name, scheme) in
        [("backward Euler", Scheme::BackwardEuler), ("midpoint", Scheme::Midpoint), ("BDF2", Scheme::Bdf2)]
    {
        let hanging = Hanging { scheme, twist: TwistUnknowns::Always, moved: 10.0, ..base.clone() };
        rows.case(&format!("steps forced into parts, {name} with twist"), |case| in_parts(case, &hanging));
    }
}

/// A pendulum of 1 m swings in about 1.6 s.
const PERIOD: f64 = 1.6;

/// The far ends of every list above, for another scheme or with angles that could be left out.
fn stiff_ends(rows: &mut Rows, name: &str, base: &Hanging) {
    let fine = Hanging { segments: 400, dt: 0.02, ..base.clone() };
    let slender = Section::circle(&SILICONE, 1e-5);
    let ends = [
        ("E = 1e5 Pa", Hanging { section: round(1e5), ..base.clone() }),
        ("E = 1e12 Pa", Hanging { section: round(1e12), ..base.clone() }),
        ("slenderness L/r = 1e5", Hanging { section: slender, ..base.clone() }),
        ("EA l²/EI = 1e0", base.clone().with_ratio(1e0)),
        ("EA l²/EI = 1e10", base.clone().with_ratio(1e10)),
        ("1600 segments", Hanging { segments: 1600, ..base.clone() }),
        ("25 segments, clamp moves 10 of them in 0.02 s", Hanging { moved: 10.0, dt: 0.02, ..base.clone() }),
        ("400 segments, clamp moves 2.5 of them in 0.02 s", Hanging { moved: 2.5, ..fine.clone() }),
        ("400 segments, clamp moves 10 of them in 0.02 s", Hanging { moved: 10.0, ..fine }),
        ("steps of 1e-6 periods", Hanging { dt: 1e-6 * PERIOD, ..base.clone() }),
        ("steps of 1e1 periods", Hanging { dt: 10.0 * PERIOD, ..base.clone() }),
    ];
    for (what, hanging) in rows.grid(&format!("{name}, far ends"), ends) {
        swung(rows, &format!("{name}, {what}"), &hanging, 5);
    }
    for youngs in rows.grid(&format!("{name}, random strain"), [1e6, 1e9]) {
        let hanging = Hanging { section: round(youngs), ..base.clone() };
        let name = format!("{name}, 15 % random strain, turned by 0.3, E = {youngs:.0e} Pa");
        from(rows, &name, &hanging, &hanging.start(0.15, 0.3), 5);
    }
}

/// Too few Newton iterations for whole steps: they are taken in parts, and derivatives go through these.
fn in_parts(case: &mut Case, hanging: &Hanging) -> Outcome {
    let options = NewtonOptions::default().with_max_iterations(3);
    let mut model = Counted::new(hanging.model()?.into_inner().with_options(options));
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&hanging.start(0.0, 0.0), &mut x)?;
    for k in 0..3 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    let before = model.counts().substeps;
    model.step(3, &x, &mut next)?;
    let parts = model.counts().substeps - before;
    let split = if parts > 0 { 0.0 } else { f64::NAN };
    case.at_most("step 3 is taken in parts, at least one more", split, 0.0, "-")
        .computed(parts as f64)
        .work(work(&model, f64::NAN));
    dot_product(case, &mut model, hanging.dt, 3, &x, &next)?;
    taylor(case, &mut model, 3, &x, 0.0)
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
        let (mut worst, mut measured) = (Distance::default(), 0);
        for k in 0..steps {
            let parts = model.counts().substeps;
            model.step(k, &x, &mut next)?;
            if model.counts().substeps == parts {
                worst = worst.max(distance(&mut model, hanging.dt, k, &x, &next));
                measured += 1;
            }
            if k + 1 < steps {
                std::mem::swap(&mut x, &mut next);
            }
        }
        let root = if measured > 0 { worst.root } else { f64::NAN };
        case.at_most("distance from the root over L", root, ROOT, "-")
            .because(ROOT_REASON)
            .work(work(&model, worst.condition))
            .note(format!("{measured} of {steps} steps measured"));
        let dt = hanging.dt;
        dot_product(case, &mut model, dt, steps - 1, &x, &next)?;
        // thirty more runs of the step: not for the largest
        if hanging.segments > 1600 {
            return Ok(());
        }
        taylor(case, &mut model, steps - 1, &x, worst.condition)
    });
}

fn dot_product(
    case: &mut Case,
    model: &mut Counted<ImplicitModel<RodStep>>,
    dt: f64,
    k: usize,
    x: &[f64],
    next: &[f64],
) -> Outcome {
    let scale = rod_scale(model.step_ref());
    model.linearize(k, k, x, next)?;
    let dot = check::dot_product(model, k..k + 1, &scale, 11)?;
    // V' = (X' − X)/Δt: a rounding ε of δX becomes ε δX/Δt in δV, however well M itself is
    // conditioned
    let divided = 50.0 * f64::EPSILON * scale[0] / (dt * scale[scale.len() / 2]);
    case.at_most("dot product of the step", dot.value, dot.bound.max(divided), "-").because(
        "50 ε times ‖M‖ ‖δx‖/‖M δx‖, and as much for δX/Δt of the velocities, however well \
            M itself is conditioned",
    );
    Ok(())
}

/// Taylor slope of step k from x; where its condition hides that, the error of its tangent.
fn taylor(
    case: &mut Case,
    model: &mut Counted<ImplicitModel<RodStep>>,
    k: usize,
    x: &[f64],
    condition: f64,
) -> Outcome {
    let scale = rod_scale(model.step_ref());
    let parts = model.counts().substeps;
    // perturbations of a tenth of a segment, and 0.1 m/s
    let l = model.step_ref().rod().rest_lengths[0];
    let direction: Vec<f64> =
        scale.iter().enumerate().map(|(i, s)| if *s < 1.0 { 0.1 * l } else { 0.1 } * wave(i, 12)).collect();
    let taylor = match check::taylor_step(model, k, x, &direction, &scale) {
        Err(Error::EmptyTest { what }) if model.counts().substeps > parts => {
            // the step jumps where the pattern of its parts changes, as documented
            case.inform("Taylor slope of a step in parts", 0.0, "-").note(what);
            return Ok(());
        }
        other => other?,
    };
    // A solve errs by ε times the condition: beyond 1e9 the remainder falls like h before h² can be seen
    // over ten halvings. Then what is left of it at the smallest step, over h ‖M d‖, is that error.
    if condition > 1e9 && taylor.slope < 1.95 {
        let mut tangent = direction;
        model.tangent(k, &mut tangent);
        let size = tangent.iter().zip(&scale).map(|(t, s)| (t / s).powi(2)).sum::<f64>().sqrt();
        let left = taylor.points.last().map_or(f64::NAN, |(h, rest)| rest / (h * size));
        case.at_most("tangent of the step, relative error", left, 10.0 * f64::EPSILON * condition, "-")
            .because("a solve errs by ε times the condition, which hides the h² of a Taylor test");
        return Ok(());
    }
    case.at_most("Taylor slope of the step, 2 − slope", 2.0 - taylor.slope, 0.05, "-")
        .because("a fit over ten halvings")
        .computed(taylor.slope);
    Ok(())
}

/// How far an accepted step is from the root.
#[derive(Default, Clone, Copy)]
pub(super) struct Distance {
    /// Largest component of Newton's correction, over L.
    pub(super) root: f64,
    /// Of the step's Jacobian.
    condition: f64,
}

impl Distance {
    fn max(self, other: Distance) -> Distance {
        Distance { root: larger(self.root, other.root), condition: larger(self.condition, other.condition) }
    }
}

/// Not f64::max, which forgets a NaN.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a >= b { a } else { b }
}

/// Of the step k from x to `next` of a round rod clamped at its start under its own weight: Newton's
/// correction for the residual of its stage, and what is left of V's equation.
pub(super) fn distance(
    model: &mut Counted<ImplicitModel<RodStep>>,
    dt: f64,
    k: usize,
    x: &[f64],
    next: &[f64],
) -> Distance {
    const LOST: Distance = Distance { root: f64::NAN, condition: f64::INFINITY };
    let mut at = interval(k, model.time(k), dt);
    at.previous = (k > 0).then_some(dt);
    let step = model.step_mut();
    let stage = step.scheme().stage(&at);
    let (n, structure) = (step.unknowns(), step.structure());
    let mut solver = LinearSolver::new(n, &structure);
    let (mut u, mut g, mut values) = (vec![0.0; n], vec![0.0; n], vec![0.0; solver.values_len()]);
    let own = step.dim() - step.history();
    step.recover(&at, x, &next[..own], &mut u);
    let assembled =
        step.equations(&at, x).and_then(|mut equations| equations.assemble(&u, &mut g, Some(&mut values)));
    if assembled.is_err() {
        return LOST;
    }
    // the stage: y = X* + η V_y, with X* and V* between the last states, and x_{k+1} between y and x_k
    let free = 3 * step.free_vertices().len();
    let star = |i: usize| {
        let past = if stage.from[1] == 0.0 { 0.0 } else { stage.from[1] * x[own + i] };
        stage.from[0] * x[i] + past
    };
    let staged = |i: usize| (next[i] - stage.to[1] * x[i]) / stage.to[0];
    let y: Vec<f64> = (0..2 * free).map(staged).collect();
    let Ok(vertices) = step.vertices(stage.time, &y) else { return LOST };
    let (mut residual, rod) = (forces(step.rod(), &vertices), step.rod());
    let mut root: f64 = 0.0;
    for i in 0..free {
        let moved = (y[i] - star(i)) / stage.length;
        let inertia = (moved - star(free + i)) / stage.length - GRAVITY[i % 3];
        residual[6 + i] += rod.masses[i / 3 + 2] * inertia;
        root = larger(root, (y[free + i] - moved).abs() * dt);
    }
    // Along the rod every vertex follows an angle where there are any: θ^1, x_2, θ^2, … of the clamped
    // rod, E = ½ GJ (Δθ)²/l̄.
    let stride = n / (free / 3);
    let angle = |e: usize| if stride == 3 || e == 0 { 0.0 } else { u[stride * (e - 1)] };
    let moment = |i: usize| match rod.gj.get(i - 1) {
        Some(gj) if i < rod.segments() => gj * (angle(i) - angle(i - 1)) / rod.voronoi_lengths[i - 1],
        _ => 0.0,
    };
    let mut correction = vec![0.0; n];
    for v in 0..free / 3 {
        correction[stride * v + stride - 3..stride * (v + 1)]
            .copy_from_slice(&residual[6 + 3 * v..9 + 3 * v]);
        if stride == 4 {
            correction[4 * v] = moment(v + 1) - moment(v + 2);
        }
    }
    let mut factor = solver.empty_factor();
    if solver.factor(&values, &mut factor).is_err() {
        return LOST;
    }
    solver.solve(&factor, &mut correction);
    // an angle counts with the length of its edge
    for (i, c) in correction.iter().enumerate() {
        let angle = stride == 4 && i % 4 == 0;
        root = larger(root, c.abs() * if angle { step.rod().rest_lengths[i / 4 + 1] } else { 1.0 });
    }
    Distance { root: root / step.rod().length(), condition: condition(n, &structure, &values) }
}

/// ∂E/∂x of an isotropic, naturally straight rod, three numbers per vertex: with c = t·t', |κb|² = 4
/// (1 − c)/(1 + c).
fn forces(rod: &Rod, x: &[Vector3<f64>]) -> Vec<f64> {
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

/// What the measure of this file must see.
#[cfg(test)]
mod tests {
    use super::*;

    /// The third step of a driven rod by every scheme, and its distance from the root after `spoil`.
    fn after(spoil: impl Fn(&mut Hanging, &mut [f64])) -> Vec<f64> {
        let schemes = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];
        let each = schemes.map(|scheme| {
            [TwistUnknowns::WhereNeeded, TwistUnknowns::Always].map(|twist| {
                let mut hanging = Hanging { scheme, twist, ..Hanging::paper() };
                let mut model = hanging.model().unwrap();
                let mut x = vec![0.0; model.dim()];
                model.initial_state(&hanging.start(0.15, 0.3), &mut x).unwrap();
                let mut next = x.clone();
                for k in 0..3 {
                    std::mem::swap(&mut x, &mut next);
                    model.step(k, &x, &mut next).unwrap();
                }
                spoil(&mut hanging, &mut next);
                let mut judge = hanging.model().unwrap();
                distance(&mut judge, hanging.dt, 2, &x, &next).root
            })
        });
        each.concat()
    }

    #[test]
    fn a_step_that_is_off_is_seen() {
        let right = after(|_, _| {});
        assert!(right.iter().all(|root| *root <= ROOT), "{right:?}");
        // a place by 1e-9 L, a velocity by 1e-6 m/s, a stiffness by 0.1 %, a step by 1e-6 of itself
        let spoiled = [
            after(|_, next| next[7] += 1e-9),
            after(|_, next| next[72 + 7] += 1e-6),
            after(|hanging, _| hanging.section.ea *= 1.001),
            after(|hanging, _| {
                // both, so that the rod stays round
                hanging.section.ei1 *= 1.001;
                hanging.section.ei2 *= 1.001;
            }),
            after(|hanging, _| hanging.dt *= 1.000001),
            after(|_, next| next[11] = f64::NAN),
        ];
        for (i, distances) in spoiled.iter().enumerate() {
            assert!(distances.iter().all(|root| !(*root <= ROOT)), "spoiled in way {i}: {distances:?}");
        }
    }
}
