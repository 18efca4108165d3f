//! Second derivatives of steps, with constants of a rod and loads of the motion: products with the exact
//! Hessian of a sum over a window, against differences of its gradient.

mod common;

use std::ops::Range;
use std::sync::Arc;

use common::rods_with_parameters::{Case, DOWN, LOST, PLAIN, cases, control, loaded_step, rod, step};
use common::{dot, noise, norm};
use varda_implicit::{ImplicitModel, Model, ParametricStep, Scheme, WithParameters};
use varda_rod::{
    Damping, Drag, Dual64, EdgeLoad, EdgeMotion, FollowerForce, Load, Loads, Moment, RodStep, Vector3, check,
};

const STEPS: usize = 4;

/// Σ_k c_k·x_k over a window.
struct Window {
    model: ImplicitModel<WithParameters<RodStep>>,
    weights: Vec<Vec<f64>>,
    states: Vec<Vec<f64>>,
}

impl Window {
    fn new(step: RodStep) -> Window {
        let model = ImplicitModel::new(WithParameters::new(step, 1), 0, 0.01);
        let n = Model::dim(&model);
        let weights = (0..=STEPS).map(|k| noise(20 + k).take(n).collect()).collect();
        Window { model, weights, states: vec![vec![0.0; n]; STEPS + 1] }
    }

    fn gradient(&mut self, z: &[f64]) -> Vec<f64> {
        let Window { model, weights, states } = self;
        model.initial_state(z, &mut states[0]).unwrap();
        for k in 0..STEPS {
            let (past, next) = states.split_at_mut(k + 1);
            model.step(k, &past[k], &mut next[0]).unwrap();
            model.linearize(k, k, &past[k], &next[0]).unwrap();
        }
        let mut lambda = weights[STEPS].clone();
        for k in (0..STEPS).rev() {
            model.adjoint(k, &mut lambda);
            lambda.iter_mut().zip(&weights[k]).for_each(|(l, w)| *l += w);
        }
        let mut dz = vec![0.0; z.len()];
        model.initial_adjoint(&lambda, &mut dz);
        dz
    }

    /// At the control of the last gradient.
    fn product(&mut self, dz: &[f64]) -> Vec<f64> {
        let Window { model, weights, states } = self;
        let mut dx = states[0].clone();
        model.initial_tangent(dz, &mut dx);
        let mut path = vec![dx];
        let second = model.second_order().unwrap();
        for k in 0..STEPS {
            let mut dx = path[k].clone();
            second.tangent_kept(k, &mut dx);
            path.push(dx);
        }
        let (mut lambda, mut derivative) = (weights[STEPS].clone(), vec![0.0; states[0].len()]);
        for k in (0..STEPS).rev() {
            second.adjoint_derivative(k, &path[k], &lambda, &mut derivative).unwrap();
            second.adjoint(k, &mut lambda);
            lambda.iter_mut().zip(&weights[k]).for_each(|(l, w)| *l += w);
        }
        let mut out = vec![0.0; dz.len()];
        second.initial_adjoint(&derivative, &mut out);
        second.initial_adjoint_derivative(dz, &lambda, &mut out);
        out
    }
}

/// A direction of the whole control, and each parameter alone.
fn directions(z: &[f64], parameters: usize) -> Vec<Vec<f64>> {
    let first = z.len() - 1 - parameters;
    let all: Vec<f64> = noise(7).take(z.len()).enumerate().map(|(i, e)| scale(i, first) * e).collect();
    let alone = |p: usize| (0..z.len()).map(|i| if i == p { scale(i, first) } else { 0.0 }).collect();
    std::iter::once(all).chain((first..z.len() - 1).map(alone)).collect()
}

/// Of a number of the control, the parameters starting at `first`.
fn scale(i: usize, first: usize) -> f64 {
    if i < first / 2 {
        0.004
    } else if i < first {
        0.04
    } else {
        0.5
    }
}

/// The larger error of a product against differences, extrapolated three times, relative to itself: of
/// places and velocities, or of parameters; and the slope of plain differences.
fn errors(
    window: &mut Window,
    z: &[f64],
    (dz, reach): (&[f64], f64),
    parameters: usize,
) -> (f64, Option<f64>) {
    let mut difference = |h: f64| -> Vec<f64> {
        let mut at = |h: f64| window.gradient(&z.iter().zip(dz).map(|(z, d)| z + h * d).collect::<Vec<_>>());
        at(h).iter().zip(at(-h)).map(|(p, m)| (p - m) / (2.0 * h)).collect()
    };
    let steps = [8.0, 4.0, 2.0, 1.0].map(|share| difference(share * reach));
    let mut best = steps.to_vec();
    for k in [4.0, 16.0, 64.0] {
        let better = |(coarse, fine): (&f64, &f64)| fine + (fine - coarse) / (k - 1.0);
        best = best.windows(2).map(|pair| pair[0].iter().zip(&pair[1]).map(better).collect()).collect();
    }
    let best = &best[0];
    window.gradient(z);
    let product = window.product(dz);
    let first = z.len() - 1 - parameters;
    let weighed = |a: &[f64], b: &[f64], range: std::ops::Range<usize>| {
        norm(&range.map(|i| scale(i, first) * (a[i] - b[i])).collect::<Vec<_>>())
    };
    let whole = 0..z.len() - 1;
    let size = weighed(&product, &vec![0.0; z.len()], whole.clone());
    if size == 0.0 {
        // a parameter that nothing depends on
        return (weighed(&steps[1], &product, whole), None);
    }
    let error = [0..first, first..z.len() - 1].map(|r| weighed(best, &product, r) / size);
    let [coarse, fine] = [1, 2].map(|i| weighed(&steps[i], &product, whole.clone()));
    // where rounding does not show
    (error[0].max(error[1]), (coarse > 1e-4 * size).then(|| (coarse / fine).log2()))
}

fn cases_with_second_derivatives() -> impl Iterator<Item = Case> {
    cases().into_iter().chain(LOADED)
}

/// In a fluid, pushed by forces that turn with sections, turned by moments; held by no director.
const LOADED: [Case; 13] = [
    Case { name: "in a fluid", drag: true, ..PLAIN },
    Case { name: "in a fluid, damped", anisotropic: true, curved: true, drag: true, damping: LOST, ..PLAIN },
    Case { name: "pushed", pushed: true, ..PLAIN },
    Case { name: "pushed, anisotropic", pushed: true, anisotropic: true, curved: true, ..PLAIN },
    Case { name: "free to turn", anisotropic: true, curved: true, held: false, damping: LOST, ..PLAIN },
    Case { name: "free to turn in a fluid", anisotropic: true, drag: true, held: false, ..PLAIN },
    Case { name: "pushed, held at both ends", pushed: true, drag: true, end: true, damping: LOST, ..PLAIN },
    Case { name: "spinning, pushed", spins: true, pushed: true, anisotropic: true, ..PLAIN },
    Case { name: "moved and pushed", moved: true, pushed: true, drag: true, curved: true, ..PLAIN },
    Case { name: "moved at both ends in a fluid", anisotropic: true, drag: true, ..MOVED_ENDS },
    Case { name: "moved at both ends and pushed", curved: true, pushed: true, ..MOVED_ENDS },
    Case { name: "moved at its end alone", curved: true, held: false, anisotropic: true, ..MOVED_ENDS },
    Case { name: FIRST_SPINS, spins: true, end: true, curved: true, ..PLAIN },
];

const MOVED_ENDS: Case = Case { moved: true, end: true, damping: LOST, ..PLAIN };

const FIRST_SPINS: &str = "spinning from the start, held at both ends";

/// Of the last case angles and spins at the start are in the control.
fn made(case: Case, scheme: Scheme) -> RodStep {
    let step = step(case, scheme);
    if case.name == FIRST_SPINS { step.with_spins_in_control() } else { step }
}

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];

/// Of differences, in units of a direction; a product that is off is off at every one.
const REACHES: [f64; 4] = [0.05, 0.012, 0.003, 0.00075];

#[test]
fn products_are_those_of_differences() {
    for (scheme, case) in
        SCHEMES.into_iter().flat_map(|s| cases_with_second_derivatives().map(move |c| (s, c)))
    {
        let step = made(case, scheme);
        let parameters = step.parameters();
        let z: Vec<f64> = control(&step).into_iter().chain([3.0]).collect();
        let mut window = Window::new(step);
        // rounding of gradients over differences of 0.1 of what they see least: 4e-9 and less; 1.2e-8 where
        // the common turn is held by 1e-6 of a stiffness
        let bound = if case.held { 1e-8 } else { 3e-8 };
        for (i, dz) in directions(&z, parameters).iter().enumerate() {
            // what bends a rod little wants long differences, what turns it far wants short ones
            let (mut error, mut slope) = (f64::INFINITY, None);
            for reach in REACHES {
                let found = errors(&mut window, &z, (dz, reach), parameters);
                if found.0 < error {
                    (error, slope) = found;
                }
                if error <= bound {
                    break;
                }
            }
            let name = format!("{}, {scheme:?}, direction {i}: {error:.1e}, slope {slope:?}", case.name);
            assert!(error <= bound, "{name}");
            assert!(slope.is_none_or(|slope| (slope - 2.0).abs() <= 0.05), "{name}");
        }
    }
}

/// A load whose second derivatives are wrong in one entry.
struct Mutated {
    load: Arc<dyn Load>,
    entry: &'static str,
}

impl Load for Mutated {
    fn has_potential(&self) -> bool {
        self.load.has_potential()
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        self.load.edges(segments)
    }

    fn uses_directors(&self) -> bool {
        self.load.uses_directors()
    }

    fn has_moment(&self) -> bool {
        self.load.has_moment()
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        self.load.on_edge(motion)
    }

    fn has_second_derivatives(&self) -> bool {
        self.load.has_second_derivatives()
    }

    fn on_moved_edge(&self, motion: &EdgeMotion<Dual64>) -> EdgeLoad<Dual64> {
        let mut acts = self.load.on_moved_edge(motion);
        let entry = match self.entry {
            "by_places" => &mut acts.by_places[(4, 3)],
            "by_velocities" => &mut acts.by_velocities[(4, 4)],
            "by_angle" => &mut acts.by_angle[4],
            // of the free end of the edge beside a clamp, by the held one
            "by_held_places" if motion.edge == 1 => &mut acts.by_places[(4, 0)],
            "by_held_places" => return acts,
            _ => &mut acts.moment_by_places[4],
        };
        entry.eps *= 1.1;
        acts
    }
}

#[test]
fn a_wrong_entry_is_seen() {
    let rod = rod(PLAIN);
    let drag = Drag { flow: Vector3::new(3.0, 1.0, 0.4), ..Drag::of(40.0, 0.02) };
    let push = FollowerForce::new(&rod, 0.7, [0.2, -0.3, 0.1]).unwrap();
    let moment = Moment::new(&rod, 0.55, [0.02, -0.03, 0.04]).unwrap();
    let loads: [(Arc<dyn Load>, &[&str]); 3] = [
        (Arc::new(drag), &["by_places", "by_velocities"]),
        (Arc::new(push), &["by_places", "by_angle"]),
        (Arc::new(moment), &["by_places", "moment_by_places"]),
    ];
    for (load, entries) in loads {
        for entry in entries {
            let mutated = Arc::new(Mutated { load: load.clone(), entry });
            let report = check::load(&*mutated, &rod, 0.1, 0.5, 3).unwrap();
            assert!(!report.passed(), "the check for users does not see {entry}:\n{report}");
            let loads = Loads { of_motion: vec![mutated], ..DOWN };
            let step = loaded_step(Case { curved: true, ..PLAIN }, Scheme::Bdf2, loads);
            let parameters = step.parameters();
            let z: Vec<f64> = control(&step).into_iter().chain([3.0]).collect();
            let dz = &directions(&z, parameters)[0];
            let (error, _) = errors(&mut Window::new(step), &z, (dz, 0.005), parameters);
            assert!(!(error <= 1e-7), "{entry} is not seen: {error:e}");
        }
    }
}

/// What a support that is moved does through a load on the edge beside it.
#[test]
fn a_wrong_entry_of_a_held_vertex_is_seen() {
    let load = Arc::new(Drag { flow: Vector3::new(3.0, 1.0, 0.4), ..Drag::of(40.0, 0.02) });
    for (wrong, entry) in [(false, "none"), (true, "by_held_places")] {
        let mutated = Arc::new(Mutated { load: load.clone(), entry });
        let of_motion: Vec<Arc<dyn Load>> = if wrong { vec![mutated] } else { vec![load.clone()] };
        let step = loaded_step(MOVED_ENDS, Scheme::Bdf2, Loads { of_motion, ..DOWN });
        let parameters = step.parameters();
        let z: Vec<f64> = control(&step).into_iter().chain([3.0]).collect();
        let dz = &directions(&z, parameters)[0];
        let (error, _) = errors(&mut Window::new(step), &z, (dz, 0.004), parameters);
        assert!((error <= 1e-7) != wrong, "{entry}: {error:e}");
    }
}

/// Where a damped rod has come to after a while, as a control without parameters: at time 0 all along.
fn settled(step: RodStep, control: &[f64]) -> Vec<f64> {
    let z = [control, &vec![0.0; step.parameters() + 1]].concat();
    let mut model = ImplicitModel::new(WithParameters::new(step, 1), 0, 0.05);
    let mut x = vec![0.0; Model::dim(&model)];
    model.initial_state(&z, &mut x).unwrap();
    for _ in 0..400 {
        let mut next = x.clone();
        model.step(0, &x, &mut next).unwrap();
        x = next;
    }
    x[..control.len()].to_vec()
}

/// Of a rod at rest at every step, the first state too, which follows from constants and supports alone.
#[test]
fn products_of_rods_at_rest_are_those_of_differences() {
    let mut seen = 0;
    // no equilibrium is near of two that are pushed
    let far = ["pushed, anisotropic", "moved at both ends and pushed"];
    let found = |case: &Case| case.held && !case.spins && !far.contains(&case.name);
    for case in cases_with_second_derivatives().filter(found) {
        let case = Case { damping: Damping::default(), drag: false, ..case };
        let step_of = |case| step(case, Scheme::BackwardEuler);
        let step = step_of(case).at_rest().unwrap();
        let parameters = step.parameters();
        let mut z: Vec<f64> = control(&step).into_iter().chain([3.0]).collect();
        if case.pushed {
            // without a potential Newton's method wants to start near
            let moving = step_of(Case { damping: Damping { mass: 8.0, ..LOST }, ..case });
            let own = z.len() - 1 - parameters;
            z.splice(..own, settled(moving, &z[..own]));
        }
        let mut window = Window::new(step);
        let all = directions(&z, parameters);
        let mut products = Vec::new();
        for (i, dz) in all.iter().enumerate() {
            let mut error = f64::INFINITY;
            for reach in [0.05, 0.0125, 0.003, 0.2] {
                if error > 1e-7 {
                    error = error.min(errors(&mut window, &z, (dz, reach), parameters).0);
                }
            }
            // rounding of gradients over the differences, as above; velocities are differences of places
            // over a step of 0.01 s
            assert!(error <= 1e-7, "{}, direction {i}: {error:e}", case.name);
            window.gradient(&z);
            products.push(window.product(dz));
        }
        for (i, j) in (0..all.len()).flat_map(|j| (0..j).map(move |i| (i, j))) {
            let [a, b] = [dot(&products[i], &all[j]), dot(&products[j], &all[i])];
            let size = norm(&products[i]) * norm(&all[j]) + norm(&products[j]) * norm(&all[i]);
            // rounding of solves: ∂G/∂u without inertia is stiff against stretching, soft in bending
            assert!((a - b).abs() <= 1e-9 * size, "{}: {i}, {j}: {a:e} and {b:e}", case.name);
        }
        seen += 1;
    }
    assert!(seen >= 12, "{seen} cases");
}

#[test]
fn products_are_symmetric() {
    for (scheme, case) in
        SCHEMES.into_iter().flat_map(|s| cases_with_second_derivatives().map(move |c| (s, c)))
    {
        let step = made(case, scheme);
        let parameters = step.parameters();
        let z: Vec<f64> = control(&step).into_iter().chain([3.0]).collect();
        let mut window = Window::new(step);
        let all = directions(&z, parameters);
        window.gradient(&z);
        let products: Vec<Vec<f64>> = all.iter().map(|dz| window.product(dz)).collect();
        for (a, by_a) in all.iter().zip(&products) {
            for (b, by_b) in all.iter().zip(&products) {
                let gap = (dot(by_a, b) - dot(by_b, a)).abs();
                assert!(gap <= 1e-12 * norm(b) * norm(by_a), "{}, {scheme:?}: {gap:e}", case.name);
            }
        }
    }
}
