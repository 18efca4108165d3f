//! Keys of a scene as values that cannot be wrong: each choice between keys is read, and refused, in one
//! place.

use varda_implicit::Scheme;
use varda_implicit::line::Line;
use varda_rod::Rod;

use super::invalid::{Either, Invalid, invalid, one_of};
use super::{
    Background, ClimatologyCovariance, Covariance, DiagonalCovariance, Ensemble, ErrorCorrelation,
    Integrator, Kernel, KernelCovariance, LineCovariance, Origin, RodModel, Root, Synthetic, Taper,
};

/// A standard deviation, given as it is or relative to another quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Sigma {
    /// In its own unit.
    Value(f64),
    /// As a fraction of a scale: the length of a rod, a mean speed.
    Relative(f64),
}

impl Sigma {
    fn from_keys(given: Either<f64, f64>) -> Sigma {
        match given {
            Either::First(value) => Sigma::Value(value),
            Either::Second(fraction) => Sigma::Relative(fraction),
        }
    }

    /// Its value, given the scale.
    pub(crate) fn of(self, scale: f64) -> f64 {
        match self {
            Sigma::Value(value) => value,
            Sigma::Relative(fraction) => fraction * scale,
        }
    }
}

impl KernelCovariance {
    /// σ of positions (relative to the length of the rod) and of velocities (relative to the mean speed).
    pub(crate) fn sigmas(&self, section: &str) -> Result<[Sigma; 2], Invalid> {
        let x =
            one_of(section, ("sigma_x", self.sigma_x), ("sigma_x_over_length", self.sigma_x_over_length))?;
        let v = one_of(
            section,
            ("sigma_v", self.sigma_v),
            ("sigma_v_over_mean_speed", self.sigma_v_over_mean_speed),
        )?;
        Ok([Sigma::from_keys(x), Sigma::from_keys(v)])
    }

    /// σ of angles and spins, where they are unknowns.
    pub(crate) fn spin_sigmas(&self, section: &str) -> Result<Option<[f64; 2]>, Invalid> {
        match (self.sigma_theta, self.sigma_spin) {
            (None, None) => Ok(None),
            (Some(angle), Some(spin)) => Ok(Some([angle, spin])),
            (Some(_), None) => invalid(section, "`sigma_theta` needs `sigma_spin` [rad/s] beside it"),
            (None, Some(_)) => invalid(section, "`sigma_spin` needs `sigma_theta` [rad] beside it"),
        }
    }

    /// Its taper.
    pub(crate) fn taper(&self, section: &str) -> Result<varda_covariance::Taper, Invalid> {
        taper(self.taper, Taper::Triangle, self.localization_length, section)
    }

    /// The square root it is given.
    pub(crate) fn root(&self) -> Root {
        root(self.root, self.kernel, self.taper, self.localization_length)
    }

    /// Whether it is that of a Markov process along a line: a Matérn kernel without a taper, whose Cholesky
    /// root is a recursion.
    pub(crate) fn is_markov(&self) -> bool {
        is_markov(self.root(), self.kernel, self.taper, self.localization_length)
    }
}

impl LineCovariance {
    /// Its taper.
    pub(crate) fn taper(&self, section: &str) -> Result<varda_covariance::Taper, Invalid> {
        taper(self.taper, Taper::GaspariCohn, self.localization_length, section)
    }

    /// The square root it is given.
    pub(crate) fn root(&self) -> Root {
        root(self.root, self.kernel, self.taper, self.localization_length)
    }

    /// Whether it is that of a Markov process along a line: a Matérn kernel without a taper, whose Cholesky
    /// root is a recursion.
    pub(crate) fn is_markov(&self) -> bool {
        is_markov(self.root(), self.kernel, self.taper, self.localization_length)
    }
}

/// The taper of a covariance; `default` where a localization length stands alone.
fn taper(
    written: Option<Taper>,
    default: Taper,
    length: Option<f64>,
    section: &str,
) -> Result<varda_covariance::Taper, Invalid> {
    let Some(support) = length else {
        return match written {
            None | Some(Taper::None) => Ok(varda_covariance::Taper::None),
            Some(_) => invalid(section, "a taper needs `localization_length` [m]"),
        };
    };
    match written.unwrap_or(default) {
        Taper::Triangle => Ok(varda_covariance::Taper::Triangle { support }),
        Taper::GaspariCohn => Ok(varda_covariance::Taper::GaspariCohn { support }),
        Taper::None => invalid(format!("{section}.localization_length"), "there is no taper to use it"),
    }
}

/// The root that is written, else one that the smoothness of the kernel allows.
fn root(written: Option<Root>, kernel: Kernel, taper: Option<Taper>, length: Option<f64>) -> Root {
    written.unwrap_or(match kernel {
        Kernel::Gaussian if !is_tapered(taper, length) => Root::Truncated,
        _ => Root::Cholesky,
    })
}

fn is_markov(root: Root, kernel: Kernel, taper: Option<Taper>, length: Option<f64>) -> bool {
    root == Root::Cholesky && kernel != Kernel::Gaussian && !is_tapered(taper, length)
}

fn is_tapered(taper: Option<Taper>, length: Option<f64>) -> bool {
    length.is_some() && taper != Some(Taper::None)
}

impl Ensemble {
    /// The taper that localizes it; `None` without localization.
    pub(crate) fn localization(&self) -> Result<Option<varda_covariance::Taper>, Invalid> {
        let path = "algorithm.ensemble";
        match (self.localization_length, self.taper) {
            (None, None | Some(Taper::None)) => Ok(None),
            (None, Some(Taper::Triangle | Taper::GaspariCohn)) => {
                invalid(format!("{path}.taper"), "a taper needs `localization_length`")
            }
            (Some(_), Some(Taper::None)) => {
                invalid(format!("{path}.localization_length"), "there is no taper to use it")
            }
            (Some(support), Some(Taper::Triangle)) => Ok(Some(varda_covariance::Taper::Triangle { support })),
            (Some(support), None | Some(Taper::GaspariCohn)) => {
                Ok(Some(varda_covariance::Taper::GaspariCohn { support }))
            }
        }
    }
}

/// A covariance of a model that is not a rod.
pub(crate) enum ComponentCovariance<'a> {
    /// Independent errors.
    Diagonal(&'a DiagonalCovariance),
    /// That of the states the model passes through.
    Climatology(&'a ClimatologyCovariance),
    /// A kernel along a line.
    Line(&'a LineCovariance, Line),
    /// No error.
    Known,
}

impl Covariance {
    /// The covariance of a rod's control; `None` where that is known.
    pub(crate) fn of_rod(&self, path: &str) -> Result<Option<&KernelCovariance>, Invalid> {
        match self {
            Covariance::Kernel(k) => Ok(Some(k)),
            Covariance::Known(_) => Ok(None),
            _ => invalid(format!("{path}.kind"), "rods take kind = \"kernel\" or \"known\""),
        }
    }

    /// The covariance of a Lorenz model's state.
    pub(crate) fn of_lorenz(&self, path: &str) -> Result<ComponentCovariance<'_>, Invalid> {
        match self {
            Covariance::Diagonal(d) => Ok(ComponentCovariance::Diagonal(d)),
            Covariance::Climatology(c) => Ok(ComponentCovariance::Climatology(c)),
            Covariance::Known(_) => Ok(ComponentCovariance::Known),
            Covariance::Kernel(_) | Covariance::Line(_) => {
                invalid(format!("{path}.kind"), "Lorenz models take kind = \"diagonal\" or \"climatology\"")
            }
        }
    }

    /// The covariance of a field along a line.
    pub(crate) fn of_line(&self, path: &str, line: Line) -> Result<ComponentCovariance<'_>, Invalid> {
        match self {
            Covariance::Diagonal(d) => Ok(ComponentCovariance::Diagonal(d)),
            Covariance::Line(k) => Ok(ComponentCovariance::Line(k, line)),
            Covariance::Known(_) => Ok(ComponentCovariance::Known),
            Covariance::Kernel(_) | Covariance::Climatology(_) => {
                invalid(format!("{path}.kind"), "a field along a line takes kind = \"line\" or \"diagonal\"")
            }
        }
    }
}

/// Where x_b comes from, with the file where it is one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BackgroundSource<'a> {
    /// The truth of a twin experiment plus a drawn error.
    TruthPlusDraw,
    /// The static equilibrium of a rod.
    StaticEquilibrium,
    /// A CSV file.
    File(&'a str),
}

impl Background {
    /// Where x_b comes from.
    pub(crate) fn source(&self) -> Result<BackgroundSource<'_>, Invalid> {
        match (self.from, &self.file) {
            (Origin::File, Some(file)) => Ok(BackgroundSource::File(file)),
            (Origin::TruthPlusDraw, None) => Ok(BackgroundSource::TruthPlusDraw),
            (Origin::StaticEquilibrium, None) => Ok(BackgroundSource::StaticEquilibrium),
            (Origin::File, None) => invalid("background", "from = \"file\" needs the key `file`"),
            (_, Some(_)) => invalid("background.file", "a file is read only with from = \"file\""),
        }
    }
}

impl Background {
    /// The file of x_b for a model that is not a rod; `None` for that of a twin experiment.
    pub(crate) fn file_of_components(&self) -> Result<Option<&str>, Invalid> {
        match self.source()? {
            BackgroundSource::TruthPlusDraw => Ok(None),
            BackgroundSource::File(name) => Ok(Some(name)),
            BackgroundSource::StaticEquilibrium => {
                invalid("background.from", "only rods have a static equilibrium")
            }
        }
    }
}

impl Synthetic {
    /// The steps of a window at which something is observed.
    pub(crate) fn observed_steps(&self, window: usize) -> Result<Vec<usize>, Invalid> {
        let given = one_of("observations", ("every", self.every), ("steps", self.steps.as_ref()))?;
        Ok(match given {
            Either::First(every) => (1..=window / every).map(|i| i * every).collect(),
            Either::Second(steps) => steps.clone(),
        })
    }

    /// σ of an observed component, which cannot be relative to a length.
    pub(crate) fn component_sigma(&self) -> Result<f64, Invalid> {
        match self.sigma()? {
            Sigma::Value(sigma) => Ok(sigma),
            Sigma::Relative(_) => {
                invalid("observations.sigma_over_length", "this model has no length; give `sigma`")
            }
        }
    }

    /// σ of an observed value (relative to the length of the rod).
    pub(crate) fn sigma(&self) -> Result<Sigma, Invalid> {
        let given =
            one_of("observations", ("sigma", self.sigma), ("sigma_over_length", self.sigma_over_length))?;
        Ok(Sigma::from_keys(given))
    }

    /// σ of a coordinate of a rod; `None` where cameras or sensors alone observe it.
    pub(crate) fn place_sigma(&self) -> Result<Option<Sigma>, Invalid> {
        match (self.sigma, self.sigma_over_length) {
            (None, None) if !self.cameras.is_empty() => Ok(None),
            (None, None) if self.places.is_empty() && !self.sensors.is_empty() => Ok(None),
            _ => self.sigma().map(Some),
        }
    }
}

/// What errors of observations are correlated along.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Along {
    /// The rod or line, with this correlation length \[m\].
    Length(f64),
    /// Time, with this correlation time \[s\].
    Time(f64),
}

impl ErrorCorrelation {
    /// What errors are correlated along.
    pub(crate) fn along(&self) -> Result<Along, Invalid> {
        let given = one_of("observations.correlation", ("length", self.length), ("time", self.time))?;
        Ok(match given {
            Either::First(length) => Along::Length(length),
            Either::Second(time) => Along::Time(time),
        })
    }
}

/// How the material of a rod answers to shear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shear {
    /// Poisson's ratio ν.
    PoissonRatio(f64),
    /// The shear modulus G \[Pa\].
    Modulus(f64),
}

/// The material of a solid section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolidMaterial {
    pub(crate) youngs_modulus: f64,
    pub(crate) shear: Shear,
    pub(crate) density: f64,
}

impl RodModel {
    /// Rest length of every segment \[m\]; of one that a clamp holds at its face, what stands out.
    pub(crate) fn rest_lengths(&self) -> Result<Vec<f64>, Invalid> {
        let given =
            one_of("model", ("segment_lengths", self.segment_lengths.as_ref()), ("length", self.length))?;
        let lengths = match (given, self.segments) {
            (Either::First(lengths), None) => lengths.clone(),
            (Either::Second(length), Some(n)) => Rod::equal_segments(length, n, self.faces()),
            (Either::First(_), Some(_)) | (Either::Second(_), None) => {
                return invalid("model", "`length` and `segments` go together");
            }
        };
        if let Some(i) = lengths.iter().position(|l| !(*l > 0.0)) {
            return invalid(format!("model.segment_lengths.{i}"), "a segment must be longer than 0 [m]");
        }
        if lengths.len() < 2 {
            return invalid("model.segment_lengths", "a rod needs at least 2 segments");
        }
        if lengths.len() < 3 && self.start.is_some() && self.end.is_some() {
            return invalid("model", "a rod between two clamps needs at least 3 segments: each holds one");
        }
        Ok(lengths)
    }

    /// Whether the shear modulus follows from Young's.
    pub(crate) fn shear_follows(&self) -> bool {
        self.solid_material().is_ok_and(|m| matches!(m.shear, Shear::PoissonRatio(_)))
    }

    /// The material of a section that needs one.
    pub(crate) fn solid_material(&self) -> Result<SolidMaterial, Invalid> {
        let Some(m) = &self.material else {
            let message = "[model.material] is missing: the section needs youngs_modulus, density and \
                           poisson_ratio or shear_modulus";
            return invalid("model", message);
        };
        let shear = match one_of(
            "model.material",
            ("poisson_ratio", m.poisson_ratio),
            ("shear_modulus", m.shear_modulus),
        )? {
            Either::First(ratio) => Shear::PoissonRatio(ratio),
            Either::Second(modulus) => Shear::Modulus(modulus),
        };
        Ok(SolidMaterial { youngs_modulus: m.youngs_modulus, shear, density: m.density })
    }
}

/// How a field along a line is stepped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LineStep {
    /// Explicit Runge–Kutta of fourth order.
    Rk4,
    /// An implicit scheme.
    Implicit(Scheme),
}

impl Integrator {
    /// The scheme of a rod.
    pub(crate) fn of_rod(self) -> Result<Scheme, Invalid> {
        match self {
            Integrator::BackwardEuler | Integrator::QuasiStatic => Ok(Scheme::BackwardEuler),
            Integrator::Midpoint => Ok(Scheme::Midpoint),
            Integrator::Bdf2 => Ok(Scheme::Bdf2),
            Integrator::Rk4 => {
                unsupported("rods are", "\"backward-euler\" or \"midpoint\" or \"bdf2\" or \"quasi-static\"")
            }
        }
    }

    /// The step of a field along a line.
    pub(crate) fn of_line(self) -> Result<LineStep, Invalid> {
        match self {
            Integrator::BackwardEuler => Ok(LineStep::Implicit(Scheme::BackwardEuler)),
            Integrator::Midpoint => Ok(LineStep::Implicit(Scheme::Midpoint)),
            Integrator::Rk4 => Ok(LineStep::Rk4),
            Integrator::Bdf2 | Integrator::QuasiStatic => {
                unsupported("fields along a line are", "\"backward-euler\" or \"midpoint\" or \"rk4\"")
            }
        }
    }

    /// Lorenz models have one step.
    pub(crate) fn of_lorenz(self) -> Result<(), Invalid> {
        match self {
            Integrator::Rk4 => Ok(()),
            _ => unsupported("Lorenz models are", "\"rk4\""),
        }
    }
}

fn unsupported<T>(what: &str, names: &str) -> Result<T, Invalid> {
    invalid("time.integrator", format!("{what} integrated with {names}"))
}
