//! Rods in extreme shapes, where the answer is known: free fall, straight, slack, buckled, nearly folded,
//! without mass.

use super::common::{condition, interval, refused, statics, work};
use super::rod::{ROOT, ROOT_REASON, distance};
use crate::row::{Outcome, Rows, Work};
use problems::counted::Counted;
use problems::rods::{rod_scale, wave};
use std::f64::consts::TAU;
use std::sync::Arc;
use varda_implicit::{Equations, ImplicitModel, ImplicitStep, Model, check};
use varda_rod::{
    Clamp, ClampAt, Damping, Error, Framed, Loads, Material, Motion, Rest, Rod, RodStep, Section, Supports,
    Vector3, derivatives, equilibrium, straight_guess,
};

pub(super) const SILICONE: Material =
    Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1100.0 };
pub(super) const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

pub(super) fn weight() -> Loads {
    Loads { gravity: [0.0, 0.0, -9.81].into(), ..Loads::default() }
}

pub(super) fn section() -> Section {
    Section::circle(&SILICONE, 0.01)
}

pub(super) fn chain() -> Section {
    Section { ei1: 0.0, ei2: 0.0, gj: 0.0, ..section() }
}

pub(super) fn fixed_clamp() -> Clamp {
    Clamp::new(ClampAt::Edge, [0.0; 3], DOWN, [1.0, 0.0, 0.0])
}

pub(super) fn held(vertex: usize, place: impl Motion + 'static) -> (usize, Arc<dyn Motion>) {
    (vertex, Arc::new(place))
}

pub(super) fn model(
    rod: Rod,
    supports: Supports,
    loads: Loads,
    dt: f64,
) -> Result<Counted<ImplicitModel<RodStep>>, Error> {
    let step = RodStep::new(rod, supports, loads, Damping::default())?;
    Ok(Counted::new(ImplicitModel::new(step, 0, dt)))
}

/// The state after `steps` steps from places of all vertices (those of the free ones are taken), at rest.
pub(super) fn run_from(
    model: &mut Counted<ImplicitModel<RodStep>>,
    vertices: &[impl Into<Vector3<f64>> + Copy],
    steps: usize,
) -> Result<Vec<f64>, varda_implicit::Error> {
    let vertices = vertices.iter().map(|v| (*v).into()).collect();
    let z = model.step_ref().control_at_rest(&Rest { vertices, theta: Vec::new() });
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// Condition of ∂G/∂u at the step k from x to itself.
fn condition_at(model: &mut Counted<ImplicitModel<RodStep>>, k: usize, dt: f64, x: &[f64]) -> f64 {
    let at = interval(k, model.time(k), dt);
    let step = model.step_mut();
    let (n, structure) = (step.unknowns(), step.structure());
    let mut u = vec![0.0; n];
    step.recover(&at, x, x, &mut u);
    let mut values = vec![0.0; varda_implicit::LinearSolver::new(n, &structure).values_len()];
    let assembled = step
        .equations(&at, x)
        .and_then(|mut equations| equations.assemble(&u, &mut vec![0.0; n], Some(&mut values)));
    match assembled {
        Ok(_) => condition(n, &structure, &values),
        Err(_) => f64::NAN,
    }
}

/// Condition at step k, and the work done so far.
pub(super) fn figures(model: &mut Counted<ImplicitModel<RodStep>>, k: usize, dt: f64, x: &[f64]) -> Work {
    let condition = condition_at(model, k, dt, x);
    work(model, condition)
}

pub(super) fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |m: f64, v| if v.abs() <= m { m } else { v.abs() })
}

pub(super) fn line(from: [f64; 3], along: [f64; 3], lengths: &[f64]) -> Vec<Vector3<f64>> {
    let (mut at, along) = (Vector3::from(from), Vector3::from(along));
    let mut all = vec![at];
    for l in lengths {
        at += along * *l;
        all.push(at);
    }
    all
}

pub(super) const DOT_REASON: &str = "50 ε times ‖M‖ ‖δx‖/‖M δx‖";
const TAYLOR_REASON: &str = "a fit over ten halvings";
const STATICS_REASON: &str = "statics end with an update below 1e-11 L";

pub(super) fn run(rows: &mut Rows) {
    free_fall(rows);
    straight(rows);
    nearly_folded(rows);
    degenerate_edges(rows);
    tips(rows);
}

/// Without supports V_k = V₀ + k Δt g and X_k = X₀ + k Δt V₀ + k(k+1)/2 Δt² g, whatever the shape.
fn free_fall(rows: &mut Rows) {
    for (youngs, dt) in rows.grid("free fall", [(1e6, 0.01), (1e12, 0.01), (1e6, 1.0)]) {
        rows.case(&format!("free fall, E = {youngs:.0e} Pa, Δt = {dt} s"), |case| {
            let material = Material { youngs_modulus: youngs, shear_modulus: youngs / 3.0, ..SILICONE };
            let rod = Rod::uniform(1.0, 25, &Section::circle(&material, 0.01))?;
            let start = line([0.0; 3], [0.6, 0.8, 0.0], &rod.rest_lengths);
            let mut model = model(rod, Supports::default(), weight(), dt)?;
            let steps = 50;
            let x = run_from(&mut model, &start, steps)?;
            let fallen = -9.81 * dt * dt * (steps * (steps + 1) / 2) as f64;
            let error = largest(start.iter().enumerate().flat_map(|(v, s)| {
                let x = &x[3 * v..3 * v + 3];
                [x[0] - s[0], x[1] - s[1], x[2] - s[2] - fallen]
            }));
            let work = figures(&mut model, 0, dt, &x);
            case.at_most("error of places over distance fallen", error / fallen.abs().max(1.0), 1e-11, "-")
                .because(
                    "steps solved to 1e-11 L; fifty sums, each rounded at the size of what has been fallen",
                )
                .work(work);
            Ok(())
        });
    }
}

/// Taut and straight: no bending, no stretch, nothing moves; at rest without a load even a chain.
fn straight(rows: &mut Rows) {
    for (name, section) in [("rod", section()), ("chain", chain())] {
        rows.case(&format!("{name} held straight and unstretched at both ends"), |case| {
            let rod = Rod::uniform(1.0, 40, &section)?;
            let start = line([0.0; 3], [1.0, 0.0, 0.0], &rod.rest_lengths);
            let ends = vec![held(0, start[0]), held(40, start[40])];
            let supports = Supports { prescribed: ends, ..Supports::default() };
            let mut model = model(rod.clone(), supports.clone(), Loads::default(), 0.01)?;
            let x = run_from(&mut model, &start, 20)?;
            let moved = largest(
                (0..39)
                    .flat_map(|f| (0..3).map(move |c| (f, c)))
                    .map(|(f, c)| x[3 * f + c] - start[f + 1][c]),
            );
            let work = figures(&mut model, 0, 0.01, &x);
            case.at_most("moved in 20 steps", moved, 1e-14, "m")
                .because("coordinates of 1 m, built by forty sums")
                .work(work);
            let guess = Rest { vertices: start.clone(), theta: vec![0.0; 40] };
            let (rest, report) = equilibrium(&rod, &supports, &Loads::default(), 0.0, &guess)?;
            let moved =
                largest(rest.vertices.iter().zip(&start).flat_map(|(a, b)| (0..3).map(move |c| a[c] - b[c])));
            let (bound, reason) = match name {
                "chain" => (
                    f64::EPSILON.sqrt(),
                    "held across by rounding alone: moving by √ε L changes lengths by ε L",
                ),
                _ => (1e-11, STATICS_REASON),
            };
            let (work, note) = statics(&report);
            case.at_most("moved by statics", moved, bound, "m").because(reason).work(work).note(note);
            let gradient = {
                let scale = rod_scale(model.step_ref());
                check::window(&mut model, &x, 5, &scale, 3)?
            };
            case.at_most("dot product of five steps", gradient.value, gradient.bound, "-")
                .because(DOT_REASON);
            Ok(())
        });
        rows.case(&format!("{name} hanging straight from an unstretched guess"), |case| {
            let rod = Rod::uniform(1.0, 40, &section)?;
            let supports = Supports { prescribed: vec![held(0, [0.0; 3])], ..Supports::default() };
            let guess = straight_guess(&rod, &supports, 0.0, DOWN)?;
            let (rest, report) = equilibrium(&rod, &supports, &weight(), 0.0, &guess)?;
            // the tension at edge e carries all masses below it
            let mut z = 0.0;
            let mut error: f64 = 0.0;
            for e in 0..40 {
                let below: f64 = rod.masses[e + 1..].iter().sum();
                z -= rod.rest_lengths[e] * (1.0 + 9.81 * below / rod.ea[e]);
                error = error.max((rest.vertices[e + 1][2] - z).abs());
            }
            let (work, note) = statics(&report);
            case.at_most("error of places", error, 1e-11, "m").because(STATICS_REASON).work(work).note(note);
            Ok(())
        });
    }
    rows.case("unstretched guess of a hanging chain, level", |case| {
        let rod = Rod::uniform(1.0, 40, &chain())?;
        let supports = Supports { prescribed: vec![held(0, [0.0; 3])], ..Supports::default() };
        let guess = straight_guess(&rod, &supports, 0.0, [1.0, 0.0, 0.0])?;
        let (rest, report) = equilibrium(&rod, &supports, &weight(), 0.0, &guess)?;
        let aside = largest(rest.vertices.iter().flat_map(|v| [v[0], v[1]]));
        let (work, note) = statics(&report);
        case.at_most("distance from the plumb line", aside, 1e-11, "m")
            .because(STATICS_REASON)
            .work(work)
            .note(note);
        Ok(())
    });
}

/// Two edges that turn by π − δ: E = 2 EI/(l̄ tan²(δ/2)) and its derivative, exact down to δ = 1e-6,
/// an error below.
fn nearly_folded(rows: &mut Rows) {
    for delta in rows.grid("turning angles", [1e-2_f64, 1e-3, 1e-4, 1e-5, 2e-6, 5e-7, 1e-7, 1e-8]) {
        rows.case(&format!("turning angle π − {delta:e}"), |case| {
            let rod = Rod::uniform(0.2, 2, &section())?;
            let tip = Vector3::new(0.1 - 0.1 * delta.cos(), 0.1 * delta.sin(), 0.0);
            let vertices = [Vector3::zeros(), Vector3::x() * 0.1, tip];
            let framed = |vertices: &[Vector3<f64>]| {
                derivatives(
                    &rod,
                    &Framed {
                        vertices,
                        directors: &[Vector3::z(); 2],
                        reference_twist: &[0.0],
                        theta: &[0.0; 2],
                    },
                )
            };
            let supports = Supports {
                prescribed: vec![held(0, vertices[0]), held(1, vertices[1])],
                ..Supports::default()
            };
            let mut model = model(rod.clone(), supports, Loads::default(), 1e-3)?;
            // within 1e-6 rad of π the description says fold
            if delta < 1e-6 {
                refused(case, "refused, naming the vertex", framed(&vertices), "vertex 1");
                let step = run_from(&mut model, &vertices, 1);
                refused(
                    case,
                    "step refused, naming step and vertex",
                    step,
                    "step 0: edges 0 and 1 are folded onto each other at vertex 1",
                );
                return Ok(());
            }
            let d = framed(&vertices)?;
            let (ei, l) = (rod.ei[0][0], rod.voronoi_lengths[0]);
            let energy = 2.0 * ei / (l * (0.5 * delta).tan().powi(2));
            let (bound, condition) = (50.0 * f64::EPSILON / delta, 1.0 / delta);
            let reason =
                "roundings of the tangents over δ, twice in the square, and as many in the place of the tip";
            case.at_most("relative error of the energy", (d.energy.bend / energy - 1.0).abs(), bound, "-")
                .because(reason)
                .work(Work { condition: Some(condition), ..Work::default() });
            // the tip turns about vertex 1: ∂E/∂δ = −E·2/sin δ, along (sin δ, cos δ) at 0.1 m
            let torque = 0.1 * (delta.sin() * d.gradient[6] + delta.cos() * d.gradient[7]);
            let expected = -2.0 * energy / delta.sin();
            case.at_most("relative error of the moment", (torque / expected - 1.0).abs(), bound, "-")
                .because(reason);
            // released from there, a step solves it, or says which one it is
            match run_from(&mut model, &vertices, 3) {
                Ok(x) => {
                    let speed2: f64 = x[3..].iter().map(|v| v * v).sum();
                    let kinetic = 0.5 * model.step_ref().rod().masses[2] * speed2;
                    let after = framed(&[vertices[0], vertices[1], Vector3::new(x[0], x[1], x[2])])?;
                    let left = (after.energy.total() + kinetic) / energy;
                    case.at_most("released: energy left after three steps", left, 1.0, "-")
                        .because("backward Euler of a potential never gains energy")
                        .work(work(&model, f64::NAN));
                }
                Err(error) => {
                    refused(case, "released: refused, naming the step", Err::<(), _>(error), "step 0");
                }
            }
            Ok(())
        });
    }
}

/// Edges without length are refused by name; very short ones are not.
fn degenerate_edges(rows: &mut Rows) {
    for length in rows.grid("short edges", [0.0, 1e-300, 1e-160]) {
        rows.case(&format!("edge of {length:e} m"), |case| {
            let rod = Rod::uniform(0.5, 5, &section())?;
            let mut vertices = line([0.0; 3], DOWN, &rod.rest_lengths);
            vertices[4] = vertices[3] + Vector3::x() * length;
            if length > 0.0 {
                // so short that it vanishes beside a coordinate: put it at the origin
                vertices.iter_mut().for_each(|v| v[2] += 0.3);
                vertices[3] = Vector3::zeros();
                vertices[4] = Vector3::x() * length;
            }
            let frame = Framed {
                vertices: &vertices,
                directors: &[Vector3::y(); 5],
                reference_twist: &[0.0; 4],
                theta: &[0.0; 5],
            };
            refused(case, "energy refused, naming the edge", derivatives(&rod, &frame), "edge 3");
            let supports = Supports { prescribed: vec![held(0, vertices[0])], ..Supports::default() };
            let mut model = model(rod, supports, weight(), 0.01)?;
            // the step itself looks at the old shape only where it needs its strains
            let step = run_from(&mut model, &vertices, 1);
            refused(case, "step refused, naming step and edge", step, "step 0: edge 3");
            Ok(())
        });
    }
    rows.case("coincident vertices that are no neighbours", |case| {
        // a regular polygon of n edges, closed: every turn is 2π/n, E = n − 1 times 2 EI tan²(π/n)/l̄
        let n = 12;
        let rod = Rod::uniform(1.2, n, &section())?;
        let radius = 0.05 / (0.5 * TAU / n as f64).sin();
        let vertices: Vec<_> = (0..=n)
            .map(|v| TAU * (v % n) as f64 / n as f64)
            .map(|phi| Vector3::new(radius * phi.cos(), radius * phi.sin(), 0.0))
            .collect();
        let frame = Framed {
            vertices: &vertices,
            directors: &vec![Vector3::z(); n],
            reference_twist: &vec![0.0; n - 1],
            theta: &vec![0.0; n],
        };
        let d = derivatives(&rod, &frame)?;
        let each = 2.0 * rod.ei[0][0] * (0.5 * TAU / n as f64).tan().powi(2) / 0.1;
        let error = (d.energy.bend / (each * (n - 1) as f64) - 1.0).abs();
        case.at_most("relative error of the energy", error, 1e-13, "-")
            .because("eleven terms of some ten roundings each");
        let supports = Supports { prescribed: vec![held(0, vertices[0])], ..Supports::default() };
        let mut model = model(rod, supports, weight(), 0.01)?;
        let x = run_from(&mut model, &vertices, 3)?;
        let scale = rod_scale(model.step_ref());
        let dot = check::window(&mut model, &x, 3, &scale, 4)?;
        case.at_most("dot product of three steps", dot.value, dot.bound, "-")
            .because(DOT_REASON)
            .work(work(&model, f64::NAN));
        Ok(())
    });
    rows.case("edge of rest length zero", |case| {
        refused(
            case,
            "rod refused, naming the field",
            Rod::with_segments(&[0.1, 0.0, 0.1], &section()),
            "rest length",
        );
        refused(case, "not a number", Rod::with_segments(&[0.1, f64::NAN], &section()), "rest length");
        Ok(())
    });
    rows.case("edge lengths 1 : 1e4 in turn", |case| {
        let lengths: Vec<f64> = (0..20).map(|e| if e % 2 == 0 { 0.05 } else { 5e-6 }).collect();
        let rod = Rod::with_segments(&lengths, &section())?;
        let start = line([0.0; 3], DOWN, &lengths);
        let drive = |t: f64| [0.5 * t, 0.0, 0.0];
        let clamp = Clamp::new(ClampAt::Edge, drive, DOWN, [1.0, 0.0, 0.0]);
        let mut model = model(rod, Supports::clamped_start(clamp), weight(), 0.01)?;
        let x = run_from(&mut model, &start, 20)?;
        let mut next = x.clone();
        model.step(20, &x, &mut next)?;
        let root = distance(&mut model, 0.01, 20, &x, &next).root;
        let work = figures(&mut model, 20, 0.01, &x);
        model.linearize(20, 20, &x, &next)?;
        let scale = rod_scale(model.step_ref());
        let dot = check::dot_product(&mut model, 20..21, &scale, 5)?;
        case.at_most("dot product of step 20", dot.value, dot.bound, "-").because(DOT_REASON).work(work);
        case.at_most("distance of step 20 from the root over L", root, ROOT, "-").because(ROOT_REASON);
        // a tenth of the short edges, and 0.1 m/s
        let direction: Vec<f64> =
            scale.iter().enumerate().map(|(i, s)| if *s < 1.0 { 5e-7 } else { 0.1 } * wave(i, 12)).collect();
        let taylor = check::taylor_step(&mut model, 20, &x, &direction, &scale)?;
        case.at_most("Taylor slope of step 20, 2 − slope", 2.0 - taylor.slope, 0.05, "-")
            .because(TAYLOR_REASON)
            .computed(taylor.slope);
        Ok(())
    });
}

/// Tips without mass are refused by name, light ones move; rods of one and two segments.
fn tips(rows: &mut Rows) {
    rows.case("massless tip", |case| {
        let mut rod = Rod::uniform(1.0, 10, &section())?;
        rod.masses[10] = 0.0;
        let supports = Supports::clamped_start(fixed_clamp());
        refused(case, "refused, naming the field", model(rod, supports, weight(), 0.01), "vertex mass");
        Ok(())
    });
    for share in rows.grid("light tips", [1e-4, 1e-8, 1e-12]) {
        rows.case(&format!("tip of {share:e} of its mass"), |case| {
            let mut rod = Rod::uniform(1.0, 10, &section())?;
            rod.masses[10] *= share;
            let guess = straight_guess(&rod, &Supports::clamped_start(fixed_clamp()), 0.0, DOWN)?;
            let drive = |t: f64| [0.5 * t, 0.0, 0.0];
            let clamp = Clamp::new(ClampAt::Edge, drive, DOWN, [1.0, 0.0, 0.0]);
            let mut model = model(rod, Supports::clamped_start(clamp), weight(), 0.01)?;
            let x = run_from(&mut model, &guess.vertices, 20)?;
            let work = figures(&mut model, 20, 0.01, &x);
            let mut next = x.clone();
            model.step(20, &x, &mut next)?;
            let root = distance(&mut model, 0.01, 20, &x, &next).root;
            case.at_most("distance of step 20 from the root over L", root, ROOT, "-")
                .because(ROOT_REASON)
                .work(work);
            let scale = rod_scale(model.step_ref());
            let dot = check::window(&mut model, &x, 1, &scale, 4)?;
            case.at_most("dot product", dot.value, dot.bound, "-").because(DOT_REASON);
            let direction: Vec<f64> = scale.iter().enumerate().map(|(i, s)| 0.1 * s * wave(i, 12)).collect();
            let taylor = check::taylor_step(&mut model, 0, &x, &direction, &scale)?;
            case.at_most("Taylor slope, 2 − slope", 2.0 - taylor.slope, 0.05, "-")
                .because(TAYLOR_REASON)
                .computed(taylor.slope);
            Ok(())
        });
    }
    // two vertices: a spring pendulum; backward Euler of r̈ = −(k/m)(r − l)e − g e_z along the
    // vertical
    rows.case("two vertices", |case| {
        let rod = Rod::uniform(0.5, 1, &section())?;
        let (m, k) = (rod.masses[1], rod.ea[0] / 0.5);
        let supports = Supports { prescribed: vec![held(0, [0.0; 3])], ..Supports::default() };
        let dt = 0.01;
        let mut model = model(rod, supports, weight(), dt)?;
        let x = run_from(&mut model, &[[0.0; 3], [0.0, 0.0, -0.5]], 100)?;
        let (mut z, mut v) = (-0.5, 0.0);
        for _ in 0..100 {
            // m (z' − z − Δt v)/Δt² = k (−z' − l) − m g, z' < 0
            let next = (m / (dt * dt) * (z + dt * v) - k * 0.5 - m * 9.81) / (m / (dt * dt) + k);
            (v, z) = ((next - z) / dt, next);
        }
        let work = figures(&mut model, 100, dt, &x);
        case.at_most("error of the tip after 100 steps", (x[2] - z).abs(), 1e-11, "m")
            .because("every step is solved to 1e-11 L, and damped by the scheme")
            .work(work);
        Ok(())
    });
    rows.case("two vertices, both clamped", |case| {
        let rod = Rod::uniform(0.5, 1, &section())?;
        let mut model = model(rod, Supports::clamped_start(fixed_clamp()), weight(), 0.01)?;
        // nothing is free: a state of no numbers, and steps that do nothing
        case.count("length of the state", model.dim(), 0);
        run_from(&mut model, &[[0.0; 3], [0.0, 0.0, -0.5]], 3)?;
        case.count("steps", model.counts().model_steps, 3);
        Ok(())
    });
    rows.case("three vertices", three_vertices);
}

/// One free vertex on a clamped edge; small motion: m ẍ = −(EI/l̄)(1/l²) x·… has one frequency, and
/// backward Euler its own damping.
fn three_vertices(case: &mut crate::row::Case) -> Outcome {
    let rod = Rod::uniform(0.2, 2, &section())?;
    let (m, l) = (rod.masses[2], 0.1);
    // φ = x/l, E = 2 (EI/l̄) tan²(φ/2) ≈ ½ (EI/l̄) φ²
    let omega2 = rod.ei[0][0] / (rod.voronoi_lengths[0] * l * l * m);
    let dt = 1e-3;
    let mut model = model(rod, Supports::clamped_start(fixed_clamp()), Loads::default(), dt)?;
    let x = run_from(&mut model, &[[0.0; 3], [0.0, 0.0, -0.1], [1e-6, 0.0, -0.2]], 50)?;
    let (mut a, mut v) = (1e-6, 0.0);
    for _ in 0..50 {
        let next = (a + dt * v) / (1.0 + dt * dt * omega2);
        (v, a) = ((next - a) / dt, next);
    }
    let work = figures(&mut model, 50, dt, &x);
    case.at_most("relative error of a small swing", ((x[0] - a) / 1e-6).abs(), 1e-5, "-")
        .because("of 1e-6 m: places are solved to 1e-11 of 0.2 m, terms of third order are 1e-10")
        .work(work);
    Ok(())
}
