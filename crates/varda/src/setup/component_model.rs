//! Models that are not rods, from a scene.

use std::f64::consts::TAU;

use varda_implicit::kuramoto::KuramotoSivashinsky;
use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{
    ChosenParameters, ImplicitModel, Law, Model, OneLeg, ParametricRhs, RhsWithParameters, Rk4,
    WithParameters,
};

use crate::scene::LineStep;

/// Newton's method ends at an update of this fraction of the field's size.
const TOLERANCE: f64 = 1e-11;

/// The equation of a model and how it is stepped.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Equation {
    /// Lorenz's three equations.
    Lorenz63(Lorenz63),
    /// Lorenz's ring.
    Lorenz96 { variables: usize, forcing: f64 },
    /// A field along a line.
    AlongLine { line: Line, field: Field, step: LineStep },
}

/// What moves a field along a line.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Field {
    /// Advection and diffusion, of itself or at a constant speed.
    Transport(Transport),
    /// Fronts that feed on long waves.
    Fronts(KuramotoSivashinsky),
}

impl Equation {
    /// Length of the state.
    pub(crate) fn dim(&self) -> usize {
        match self {
            Equation::Lorenz63(_) => 3,
            Equation::Lorenz96 { variables, .. } => *variables,
            Equation::AlongLine { line, .. } => line.points,
        }
    }

    /// The line of a field along one.
    pub(crate) fn line(&self) -> Option<Line> {
        match self {
            Equation::AlongLine { line, .. } => Some(*line),
            Equation::Lorenz63(_) | Equation::Lorenz96 { .. } => None,
        }
    }

    /// Whether its steps are explicit.
    pub(crate) fn is_explicit(&self) -> bool {
        !matches!(self, Equation::AlongLine { step: LineStep::Implicit(_), .. })
    }

    /// The state that is usual for the model at its time 0.
    pub(crate) fn start(&self) -> Vec<f64> {
        match self {
            Equation::Lorenz63(_) => vec![1.508870, -1.531271, 25.46091],
            Equation::Lorenz96 { variables, forcing } => {
                // Lorenz's own start: the unstable equilibrium, one component a little off.
                let mut x = vec![*forcing; *variables];
                x[variables / 2] += 0.008;
                x
            }
            Equation::AlongLine { line, .. } => {
                (0..line.points).map(|i| hump(line, line.position(i))).collect()
            }
        }
    }

    /// Names, units and values of the constants, in the order of the equation's parameters.
    pub(crate) fn constants(&self) -> Vec<(&'static str, &'static str, f64)> {
        match self {
            Equation::Lorenz63(m) => {
                vec![("sigma", "1", m.sigma), ("rho", "1", m.rho), ("beta", "1", m.beta)]
            }
            Equation::Lorenz96 { forcing, .. } => vec![("forcing", "1", *forcing)],
            Equation::AlongLine { field: Field::Transport(transport), .. } => {
                let [speed, diffusivity] = transport.constants();
                let name = if transport.steepens() { "viscosity" } else { "diffusivity" };
                vec![("speed", "m/s", speed), (name, "m²/s", diffusivity)]
            }
            Equation::AlongLine { field: Field::Fronts(_), .. } => Vec::new(),
        }
    }

    /// Makes the model with some constants, by their place in [`Equation::constants`], and `carried` numbers
    /// behind its state.
    pub(crate) fn factory_with(
        self,
        chosen: Vec<(usize, Law)>,
        carried: usize,
        start: &[f64],
        length: f64,
    ) -> impl Fn(usize) -> Box<dyn Model + Send> + 'static {
        let tolerance = tolerance(start);
        let known: Vec<f64> = self.constants().iter().map(|c| c.2).collect();
        move |first| {
            let grid = (first, length);
            match self {
                Equation::Lorenz63(equation) => explicit(unknown(equation, &known, &chosen), carried, grid),
                Equation::Lorenz96 { variables, forcing } => {
                    explicit(unknown(Lorenz96::new(variables, forcing), &known, &chosen), carried, grid)
                }
                Equation::AlongLine { field: Field::Transport(field), step, .. } => {
                    along_line(unknown(field, &known, &chosen), carried, step, tolerance, grid)
                }
                Equation::AlongLine { field: Field::Fronts(field), step, .. } => {
                    along_line(unknown(field, &known, &chosen), carried, step, tolerance, grid)
                }
            }
        }
    }

    /// Makes the model, its step 0 being step `first` of the model's time; `start` is a state of usual size.
    pub(crate) fn factory(
        self,
        start: &[f64],
        length: f64,
    ) -> impl Fn(usize) -> Box<dyn Model + Send> + 'static {
        let tolerance = tolerance(start);
        move |first| match self {
            Equation::Lorenz63(equation) => equation.rk4(first, length),
            Equation::Lorenz96 { variables, forcing } => Lorenz96::new(variables, forcing).rk4(first, length),
            Equation::AlongLine { field, step, .. } => match (field, step) {
                (Field::Transport(transport), LineStep::Rk4) => transport.rk4(first, length),
                (Field::Fronts(fronts), LineStep::Rk4) => fronts.rk4(first, length),
                (Field::Transport(transport), LineStep::Implicit(scheme)) => {
                    transport.implicit(scheme, tolerance, first, length)
                }
                (Field::Fronts(fronts), LineStep::Implicit(scheme)) => {
                    fronts.implicit(scheme, tolerance, first, length)
                }
            },
        }
    }
}

/// At which Newton's method ends, `start` being a state of usual size.
fn tolerance(start: &[f64]) -> f64 {
    let size = start.iter().fold(0.0_f64, |size, u| size.max(u.abs()));
    TOLERANCE * if size > 0.0 { size } else { 1.0 }
}

fn unknown<R: ParametricRhs>(rhs: R, known: &[f64], chosen: &[(usize, Law)]) -> ChosenParameters<R> {
    ChosenParameters::new(rhs, known, chosen.to_vec())
}

type Grid = (usize, f64);

fn explicit<R>(rhs: R, carried: usize, (first, length): Grid) -> Box<dyn Model + Send>
where
    R: ParametricRhs + Clone + Send + 'static,
{
    Box::new(Rk4::new(RhsWithParameters::new(rhs, carried), first, length))
}

fn along_line<R>(
    rhs: R,
    carried: usize,
    step: LineStep,
    tolerance: f64,
    (first, length): Grid,
) -> Box<dyn Model + Send>
where
    R: ParametricRhs + Clone + Send + 'static,
{
    match step {
        LineStep::Rk4 => explicit(rhs, carried, (first, length)),
        LineStep::Implicit(scheme) => {
            let step = WithParameters::new(OneLeg::new(rhs, scheme, tolerance), carried);
            Box::new(ImplicitModel::new(step, first, length))
        }
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
