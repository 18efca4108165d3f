//! From `[background.covariance]` to B.

use varda_covariance::{
    BlockDiagonal, Covariance, CovarianceFunction, Dense, Diagonal, Interleaved, Kernel, Taper, Truncated,
};

use crate::Error;
use crate::scene::{self, KernelCovariance, Prior, Root, SceneFile};

const PATH: &str = "background.covariance";

/// B = σ² I of a state of n components.
///
/// # Errors
/// [`Error::Scene`].
pub fn diagonal(file: &SceneFile, n: usize, sigma: f64) -> Result<Box<dyn Covariance>, Error> {
    Ok(Box::new(Diagonal::uniform(n, sigma).map_err(|e| file.invalid(PATH, e.to_string()))?))
}

/// B = `scale` × a symmetric n × n matrix, by rows.
///
/// # Errors
/// [`Error::Scene`] where it is not positive definite.
pub fn scaled(file: &SceneFile, n: usize, scale: f64, matrix: &[f64]) -> Result<Box<dyn Covariance>, Error> {
    let matrix: Vec<f64> = matrix.iter().map(|c| scale * c).collect();
    Ok(Box::new(Dense::new(n, &matrix).map_err(|e| file.invalid(PATH, e.to_string()))?))
}

/// The arc lengths a rod's B is about \[m\].
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// Of the free vertices.
    pub free: Vec<f64>,
    /// Of the prescribed vertices, which have no error.
    pub known: Vec<f64>,
}

/// B of [X₀, V₀]: one block for the positions (σ_x \[m\]) and one for the velocities (σ_v [m/s]), each shared by x, y and z.
///
/// # Errors
/// [`Error::Scene`] where B has no root of the kind asked for.
pub fn localized(
    file: &SceneFile,
    k: &KernelCovariance,
    places: &Places,
    sigma_x: f64,
    sigma_v: f64,
) -> Result<Box<dyn Covariance>, Error> {
    let support = k.localization_length.unwrap_or(f64::INFINITY);
    let taper = match k.taper {
        scene::Taper::Triangle => Taper::Triangle { support },
        scene::Taper::GaspariCohn => Taper::GaspariCohn { support },
        scene::Taper::None => Taper::None,
    };
    let n = places.free.len();
    blocks(file, k, places, sigma_x, sigma_v, taper, |matrix| match k.root {
        Root::Cholesky => {
            Dense::new(n, matrix).map(|root| Box::new(root) as Box<dyn Covariance>).map_err(|e| {
                file.invalid(
                    PATH,
                    format!(
                        "{e}: B has no Cholesky root; take root = \"truncated\", a taper, or a rougher kernel"
                    ),
                )
            })
        }
        Root::Truncated => Truncated::eigen(n, matrix, k.truncation)
            .map(|root| Box::new(root) as Box<dyn Covariance>)
            .map_err(|e| file.invalid(PATH, e.to_string())),
    })
}

/// The covariance the paper draws its background errors from: the same kernel before localization. It is smooth, so
/// singular to working precision; its root is truncated at rounding.
///
/// # Errors
/// [`Error::Scene`].
pub fn unlocalized(
    file: &SceneFile,
    k: &KernelCovariance,
    places: &Places,
    sigma_x: f64,
    sigma_v: f64,
) -> Result<Box<dyn Covariance>, Error> {
    let n = places.free.len();
    blocks(file, k, places, sigma_x, sigma_v, Taper::None, |matrix| {
        let root = Truncated::eigen(n, matrix, 1e-14).map_err(|e| file.invalid(PATH, e.to_string()))?;
        Ok(Box::new(root))
    })
}

fn blocks(
    file: &SceneFile,
    k: &KernelCovariance,
    places: &Places,
    sigma_x: f64,
    sigma_v: f64,
    taper: Taper,
    root: impl Fn(&[f64]) -> Result<Box<dyn Covariance>, Error>,
) -> Result<Box<dyn Covariance>, Error> {
    let block = |sigma: f64, length: f64| -> Result<Interleaved<Box<dyn Covariance>>, Error> {
        let kernel = match k.kernel {
            scene::Kernel::Gaussian => Kernel::Gaussian { length },
            scene::Kernel::Matern12 => Kernel::Matern12 { length },
            scene::Kernel::Matern32 => Kernel::Matern32 { length },
            scene::Kernel::Matern52 => Kernel::Matern52 { length },
        };
        let function = CovarianceFunction { sigma, kernel, taper };
        let matrix = match k.prior {
            Prior::Clamp => function.conditioned_matrix(&places.free, &places.known),
            Prior::Plain => function.matrix(&places.free),
        };
        let matrix = matrix.map_err(|e| file.invalid(PATH, e.to_string()))?;
        Ok(Interleaved::new(root(&matrix)?, 3))
    };
    let parts = vec![block(sigma_x, k.correlation_length_x)?, block(sigma_v, k.correlation_length_v)?];
    Ok(Box::new(BlockDiagonal::new(parts)))
}
