//! Models that are not rods, from a scene.

use std::f64::consts::TAU;

use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{Model, Scheme};

use crate::scene::{self, Integrator, Scene};

/// Newton's method ends at an update of this part of the field's size.
const TOLERANCE: f64 = 1e-11;

/// The state the truth starts from: the scene's, or one that is usual for the model.
pub(crate) fn start(scene: &Scene) -> Vec<f64> {
    if let Some(truth) = &scene.truth {
        return truth.state.clone();
    }
    match (&scene.model, scene.model.line()) {
        (scene::Model::Lorenz96(m), _) => {
            // Lorenz's own start: the unstable equilibrium, one component a little off.
            let mut x = vec![m.forcing; m.variables];
            x[m.variables / 2] += 0.008;
            x
        }
        (_, Some(line)) => (0..line.points).map(|i| hump(&line, line.position(i))).collect(),
        (_, None) => vec![1.508870, -1.531271, 25.46091],
    }
}

/// On a circle ½ + ½ sin with a smaller wave on it; between fixed ends half a wave above the straight line.
fn hump(line: &Line, s: f64) -> f64 {
    let turn = TAU * s / line.length;
    match line.ends {
        Ends::Periodic => 0.5 + 0.5 * turn.sin() + 0.2 * (3.0 * turn + 1.0).cos(),
        Ends::Fixed { left, right } => left + (right - left) * s / line.length + (0.5 * turn).sin(),
    }
}

/// Makes the model of a scene, its step 0 being step `first` of the model's time.
pub(crate) fn factory(
    scene: &Scene,
    start: &[f64],
    step: f64,
) -> impl Fn(usize) -> Box<dyn Model + Send> + 'static {
    let (model, integrator) = (scene.model.clone(), scene.time.integrator);
    let size = start.iter().fold(0.0_f64, |size, u| size.max(u.abs()));
    let tolerance = TOLERANCE * if size > 0.0 { size } else { 1.0 };
    move |first| match (&model, model.line()) {
        (scene::Model::Lorenz96(m), _) => Lorenz96::new(m.variables, m.forcing).rk4(first, step),
        (scene::Model::Lorenz63(m), _) => {
            Lorenz63 { sigma: m.sigma, rho: m.rho, beta: m.beta }.rk4(first, step)
        }
        (scene::Model::LinearAdvection(m), Some(line)) => {
            let rhs = Transport::advection_diffusion(line, m.speed, m.diffusivity);
            stepped(rhs, integrator, tolerance, first, step)
        }
        (scene::Model::Burgers(m), Some(line)) => {
            stepped(Transport::burgers(line, m.viscosity), integrator, tolerance, first, step)
        }
        _ => unreachable!("rods have their own problem"),
    }
}

fn stepped(
    equation: Transport,
    integrator: Integrator,
    tolerance: f64,
    first: usize,
    step: f64,
) -> Box<dyn Model + Send> {
    match integrator {
        Integrator::BackwardEuler => equation.implicit(Scheme::BackwardEuler, tolerance, first, step),
        Integrator::Midpoint => equation.implicit(Scheme::Midpoint, tolerance, first, step),
        _ => equation.rk4(first, step),
    }
}
