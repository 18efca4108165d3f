//! `[algorithm.ensemble]`: the members, for methods that run an ensemble instead of a tangent and an adjoint.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Taper;

/// The ensemble of methods 4denvar and hybrid-4denvar. Its members are drawn from N(x_b, B) with the seed's
/// stream for ensembles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ensemble {
    /// Number of members N; at most 1e9 numbers in all their runs together.
    #[schemars(extend("minimum" = 2, "maximum" = 10000))]
    pub members: usize,
    /// Distance beyond which the ensemble's covariances are set to zero: [m] on a rod or a line, in
    /// components on lorenz96's ring. Left out: no localization. On a rod, waves and tension carry
    /// what is seen farther than any such length within a window: take one well above the way that waves go
    /// between two observations, or method 4dvar, which needs none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub localization_length: Option<f64>,
    /// Shape of the localization; gaspari-cohn by default if a length is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taper: Option<Taper>,
    /// The members' deviations from their mean are multiplied by this before a window.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub inflation: f64,
    /// Weight β_s of the static part in β_s² B + β_e² B_e (method hybrid-4denvar): a factor on standard
    /// deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0))]
    pub static_weight: Option<f64>,
    /// Weight β_e of the ensemble part in β_s² B + β_e² B_e (method hybrid-4denvar): a factor on
    /// standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0))]
    pub ensemble_weight: Option<f64>,
}

impl Default for Ensemble {
    fn default() -> Self {
        Ensemble {
            members: 40,
            localization_length: None,
            taper: None,
            inflation: 1.0,
            static_weight: None,
            ensemble_weight: None,
        }
    }
}

impl Ensemble {
    /// β_s and β_e; by default √½ each, half of the covariance.
    pub fn weights(&self) -> [f64; 2] {
        [self.static_weight, self.ensemble_weight].map(|w| w.unwrap_or(std::f64::consts::FRAC_1_SQRT_2))
    }
}
