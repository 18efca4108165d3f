//! What a covariance of a scene must satisfy beyond the type of each key.

use varda_covariance::Taper;
use varda_implicit::line::Ends;

use super::invalid::{Check, invalid};
use super::parsed::ComponentCovariance;
use super::{Covariance, Model};

/// Checks a covariance of a model's control, at `path`.
pub(super) fn validate_covariance(covariance: &Covariance, path: &str, model: &Model) -> Check {
    match model {
        Model::Rod(rod) => {
            let Some(kernel) = covariance.of_rod(path)? else { return Ok(()) };
            kernel.sigmas(path)?;
            if kernel.spin_sigmas(path)?.is_some() && !rod.twist_inertia {
                let message = "sections without inertia have their angles in equilibrium: set \
                               model.twist_inertia = true, or leave sigma_theta and sigma_spin out";
                return invalid(format!("{path}.sigma_theta"), message);
            }
            kernel.taper(path)?;
        }
        _ => match model.line() {
            None => {
                covariance.of_lorenz(path)?;
            }
            Some(line) => {
                if let ComponentCovariance::Line(k, line) = covariance.of_line(path, line)? {
                    let taper = k.taper(path)?;
                    if matches!(taper, Taper::Triangle { .. }) && line.ends == Ends::Periodic {
                        return invalid(
                            format!("{path}.taper"),
                            "a triangle is not a covariance on a circle: take \"gaspari-cohn\"",
                        );
                    }
                }
            }
        },
    }
    Ok(())
}
