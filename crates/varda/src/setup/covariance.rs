//! From a `covariance` table of a scene to B or Q.

use varda_covariance::{
    BlockDiagonal, Covariance, CovarianceFunction, Dense, Diagonal, Interleaved, Kernel, Markov, Precision,
    Taper, Truncated, correlation,
};
use varda_implicit::line::{Ends, Line};

use crate::Error;
use crate::scene::{self, KernelCovariance, LineCovariance, Prior, Root, SceneFile};

/// A covariance, and whether it has an inverse.
pub enum Factored {
    /// Of full rank.
    Full(Box<dyn Precision>),
    /// Without an inverse: with a truncated root, or singular to working precision.
    Singular(Box<dyn Covariance>),
}

impl Factored {
    /// The covariance with its inverse; `None` for a singular one.
    pub fn precision(&self) -> Option<&dyn Precision> {
        match self {
            Factored::Full(c) => Some(c.as_ref()),
            Factored::Singular(_) => None,
        }
    }
}

impl AsRef<dyn Covariance> for Factored {
    fn as_ref(&self) -> &(dyn Covariance + 'static) {
        match self {
            Factored::Full(c) => c.as_ref(),
            Factored::Singular(c) => c.as_ref(),
        }
    }
}

/// `n` components without error.
pub(crate) fn none(n: usize) -> Factored {
    Factored::Singular(Box::new(WithoutError(n)))
}

/// The covariance of numbers without error.
pub(crate) struct WithoutError(pub(crate) usize);

impl Covariance for WithoutError {
    fn dim(&self) -> usize {
        self.0
    }
    fn root_dim(&self) -> usize {
        0
    }
    fn apply(&self, _: &[f64], y: &mut [f64]) {
        y.fill(0.0);
    }
    fn root(&self, _: &[f64], x: &mut [f64]) {
        x.fill(0.0);
    }
    fn root_transpose(&self, _: &[f64], _: &mut [f64]) {}
    fn variance(&self, variance: &mut [f64]) {
        variance.fill(0.0);
    }
}

/// Independent errors of one σ in `n` components.
///
/// # Errors
/// [`Error::Scene`].
pub(crate) fn diagonal(file: &SceneFile, path: &str, n: usize, sigma: f64) -> Result<Factored, Error> {
    let c = Diagonal::uniform(n, sigma).map_err(|e| file.invalid(path, e.to_string()))?;
    Ok(Factored::Full(Box::new(c)))
}

/// `scale` × a symmetric n × n matrix, by rows.
///
/// # Errors
/// [`Error::Scene`] where it is not positive definite.
pub fn scaled(file: &SceneFile, path: &str, n: usize, scale: f64, matrix: &[f64]) -> Result<Factored, Error> {
    let matrix: Vec<f64> = matrix.iter().map(|c| scale * c).collect();
    Ok(Factored::Full(Box::new(cholesky(file, path, n, &matrix)?)))
}

/// Distance \[m\] of two points of a line: the chord where it closes to a circle.
pub fn line_distance(line: &Line, i: usize, j: usize) -> f64 {
    let d = (line.position(i) - line.position(j)).abs();
    match line.ends {
        Ends::Periodic => {
            line.length / std::f64::consts::PI * (std::f64::consts::PI * d / line.length).sin().abs()
        }
        Ends::Fixed { .. } => d,
    }
}

/// A kernel times a taper of the distance along a line.
///
/// # Errors
/// [`Error::Scene`] where it has no root of the kind asked for.
pub(crate) fn along_line(
    file: &SceneFile,
    path: &str,
    k: &LineCovariance,
    line: &Line,
) -> Result<Factored, Error> {
    let (kernel, taper) = (kernel(k.kernel, k.correlation_length), file.checked(k.taper(path))?);
    let n = line.points;
    if k.is_markov() && matches!(line.ends, Ends::Fixed { .. }) {
        let places: Vec<f64> = (0..n).map(|i| line.position(i)).collect();
        let b = Markov::new(&CovarianceFunction { sigma: k.sigma, kernel, taper }, &places, &[]);
        let b = b.map_err(|e| file.invalid(path, e.to_string()))?;
        return Ok(recursive(b.is_well_determined(), b));
    }
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            matrix[i * n + j] = k.sigma * k.sigma * correlation(kernel, taper, line_distance(line, i, j));
        }
    }
    let full =
        || -> Result<Factored, Error> { Ok(Factored::Full(Box::new(cholesky(file, path, n, &matrix)?))) };
    let of_rank = || -> Result<Factored, Error> {
        Ok(Factored::Singular(Box::new(truncated(file, path, n, &matrix, k.truncation, k.sigma * k.sigma)?)))
    };
    factored(k.root(), k.root.is_some(), full, of_rank)
}

/// A Matérn covariance by recursion, at every size: its root is Cholesky's. Its inverse counts where it is
/// determined by more than rounding.
fn recursive(is_well_determined: bool, b: impl Precision + 'static) -> Factored {
    match is_well_determined {
        true => Factored::Full(Box::new(b)),
        false => Factored::Singular(Box::new(b)),
    }
}

/// The root asked for; where a scene does not write one, a truncated root where there is no Cholesky root.
fn factored(
    root: Root,
    is_written: bool,
    full: impl FnOnce() -> Result<Factored, Error>,
    of_rank: impl FnOnce() -> Result<Factored, Error>,
) -> Result<Factored, Error> {
    match root {
        Root::Truncated => of_rank(),
        Root::Cholesky if is_written => full(),
        Root::Cholesky => full().or_else(|_| of_rank()),
    }
}

/// Arc lengths of the vertices of a rod \[m\].
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// Vertices that move freely.
    pub free: Vec<f64>,
    /// Prescribed vertices, which have no error.
    pub known: Vec<f64>,
    /// Middles of the edges whose angle and spin are unknowns.
    pub edges: Vec<f64>,
    /// Middles of the edges that clamps hold.
    pub held_edges: Vec<f64>,
}

/// Standard deviations of the groups of a rod's control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sigmas {
    /// Of positions \[m\].
    pub x: f64,
    /// Of velocities [m/s].
    pub v: f64,
    /// Of angles \[rad\] and spins [rad/s], where these are unknowns.
    pub spins: Option<[f64; 2]>,
}

/// The covariance of [X, V]: one block for the positions and one for the velocities, each shared by x, y and
/// z; of [X, V, θ, ω] one more for the angles and one for the spins.
///
/// # Errors
/// [`Error::Scene`] where it has no root of the kind asked for.
pub fn localized(
    file: &SceneFile,
    path: &str,
    k: &KernelCovariance,
    places: &Places,
    sigmas: Sigmas,
) -> Result<Factored, Error> {
    let taper = file.checked(k.taper(path))?;
    if k.is_markov() {
        let b = markov_blocks(file, path, k, places, sigmas)?;
        let is_well_determined = b.parts().iter().all(|block| block.part().is_well_determined());
        return Ok(recursive(is_well_determined, b));
    }
    let full = || -> Result<Factored, Error> {
        let root = |n, matrix: &[f64], _: f64| cholesky(file, path, n, matrix);
        Ok(Factored::Full(Box::new(matrix_blocks(file, path, k, places, sigmas, taper, root)?)))
    };
    let of_rank = || -> Result<Factored, Error> {
        let root = |n, matrix: &[f64], variance| truncated(file, path, n, matrix, k.truncation, variance);
        Ok(Factored::Singular(Box::new(matrix_blocks(file, path, k, places, sigmas, taper, root)?)))
    };
    factored(k.root(), k.root.is_some(), full, of_rank)
}

/// The covariance from which the paper draws its background errors: the same kernel before localization. A
/// Gaussian one is smooth, hence singular to working precision; its root is truncated at the rounding level.
///
/// # Errors
/// [`Error::Scene`].
pub fn unlocalized(
    file: &SceneFile,
    path: &str,
    k: &KernelCovariance,
    places: &Places,
    sigmas: Sigmas,
) -> Result<Box<dyn Covariance>, Error> {
    if k.kernel != scene::Kernel::Gaussian {
        return Ok(Box::new(markov_blocks(file, path, k, places, sigmas)?));
    }
    let root = |n, matrix: &[f64], variance| truncated(file, path, n, matrix, 1e-14, variance);
    Ok(Box::new(matrix_blocks(file, path, k, places, sigmas, Taper::None, root)?))
}

type Blocks<C> = BlockDiagonal<Interleaved<C>>;

/// The blocks of a Matérn kernel without a taper.
fn markov_blocks(
    file: &SceneFile,
    path: &str,
    k: &KernelCovariance,
    places: &Places,
    sigmas: Sigmas,
) -> Result<Blocks<Markov>, Error> {
    blocks(file, path, k, places, sigmas, Taper::None, Markov::new)
}

/// The blocks of a matrix, with a root of it by its size, rows, and σ² before conditioning.
fn matrix_blocks<C: Covariance>(
    file: &SceneFile,
    path: &str,
    k: &KernelCovariance,
    places: &Places,
    sigmas: Sigmas,
    taper: Taper,
    root: impl Fn(usize, &[f64], f64) -> Result<C, Error>,
) -> Result<Blocks<C>, Error> {
    blocks(file, path, k, places, sigmas, taper, |function: &CovarianceFunction, free, known| {
        let matrix = function.conditioned_matrix(free, known)?;
        root(free.len(), &matrix, function.sigma * function.sigma)
    })
}

/// `make` builds the covariance of a function at free places, conditioned on known ones.
fn blocks<C: Covariance, E: Into<Error>>(
    file: &SceneFile,
    path: &str,
    k: &KernelCovariance,
    places: &Places,
    sigmas: Sigmas,
    taper: Taper,
    make: impl Fn(&CovarianceFunction, &[f64], &[f64]) -> Result<C, E>,
) -> Result<Blocks<C>, Error> {
    let vertices = (&places.free, &places.known, 3);
    let edges = (&places.edges, &places.held_edges, 1);
    let block = |sigma, length, (free, known, width): (&Vec<f64>, &Vec<f64>, usize)| {
        let function = CovarianceFunction { sigma, kernel: kernel(k.kernel, length), taper };
        let known = if k.prior == Prior::Clamp { known.as_slice() } else { &[] };
        let made = make(&function, free, known).map_err(|e| match e.into() {
            Error::Covariance(e) => file.invalid(path, e.to_string()),
            other => other,
        })?;
        Ok::<_, Error>(Interleaved::new(made, width))
    };
    let lengths = [k.correlation_length_x, k.correlation_length_v];
    let mut parts = vec![block(sigmas.x, lengths[0], vertices)?, block(sigmas.v, lengths[1], vertices)?];
    if let Some([angle, spin]) = sigmas.spins {
        parts.extend([block(angle, lengths[0], edges)?, block(spin, lengths[1], edges)?]);
    }
    Ok(BlockDiagonal::new(parts))
}

fn cholesky(file: &SceneFile, path: &str, n: usize, matrix: &[f64]) -> Result<Dense, Error> {
    let remedy = "take root = \"truncated\", a taper, or a rougher kernel";
    Dense::new(n, matrix)
        .map_err(|e| file.invalid(path, format!("{e}: this covariance has no Cholesky root; {remedy}")))
}

fn truncated(
    file: &SceneFile,
    path: &str,
    n: usize,
    matrix: &[f64],
    tolerance: f64,
    variance: f64,
) -> Result<Truncated, Error> {
    Truncated::of_kernel(n, matrix, tolerance, variance).map_err(|e| file.invalid(path, e.to_string()))
}

pub(super) fn kernel(kernel: scene::Kernel, length: f64) -> Kernel {
    match kernel {
        scene::Kernel::Gaussian => Kernel::Gaussian { length },
        scene::Kernel::Matern12 => Kernel::Matern12 { length },
        scene::Kernel::Matern32 => Kernel::Matern32 { length },
        scene::Kernel::Matern52 => Kernel::Matern52 { length },
    }
}
