//! What a covariance of a scene must satisfy beyond the type of each key.

use varda_implicit::line::Ends;

use super::invalid::{Check, invalid, one_of};
use super::{Covariance, KernelCovariance, Model, Taper};

/// A covariance of a model's control, at `path`.
pub(super) fn validate_covariance(covariance: &Covariance, path: &str, model: &Model) -> Check {
    match (covariance, model) {
        (Covariance::Kernel(k), Model::Rod(_)) => validate_kernel(k, path),
        (Covariance::Line(k), Model::LinearAdvection(_) | Model::Burgers(_)) => {
            validate_taper(k.taper, k.localization_length, path)?;
            match k.taper {
                Taper::Triangle if model.line().is_some_and(|line| line.ends == Ends::Periodic) => invalid(
                    format!("{path}.taper"),
                    "a triangle is no covariance on a circle: take \"gaspari-cohn\"",
                ),
                _ => Ok(()),
            }
        }
        (Covariance::Climatology(_), Model::Lorenz63(_) | Model::Lorenz96(_)) => Ok(()),
        (_, Model::Rod(_)) => invalid(format!("{path}.kind"), "rods take kind = \"kernel\""),
        (Covariance::Diagonal(_), _) => Ok(()),
        (_, Model::Lorenz63(_) | Model::Lorenz96(_)) => {
            invalid(format!("{path}.kind"), "Lorenz models take kind = \"diagonal\" or \"climatology\"")
        }
        (Covariance::Kernel(_) | Covariance::Climatology(_), _) => {
            invalid(format!("{path}.kind"), "a field along a line takes kind = \"line\" or \"diagonal\"")
        }
    }
}

fn validate_taper(taper: Taper, length: Option<f64>, section: &str) -> Check {
    match (taper, length) {
        (Taper::None, Some(_)) => {
            invalid(format!("{section}.localization_length"), "there is no taper to use it")
        }
        (Taper::Triangle | Taper::GaspariCohn, None) => {
            invalid(section, "a taper needs `localization_length` [m]")
        }
        _ => Ok(()),
    }
}

fn validate_kernel(k: &KernelCovariance, section: &str) -> Check {
    one_of(
        section,
        ("sigma_x", k.sigma_x.is_some()),
        ("sigma_x_over_length", k.sigma_x_over_length.is_some()),
    )?;
    one_of(
        section,
        ("sigma_v", k.sigma_v.is_some()),
        ("sigma_v_over_mean_speed", k.sigma_v_over_mean_speed.is_some()),
    )?;
    validate_taper(k.taper, k.localization_length, section)
}
