//! `[algorithm.model_error]`: Q, for the weak-constraint methods.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Covariance, defaults::is_default};

/// The error of the model: x_{k+1} = M_k(x_k) + η, η drawn from N(0, Q). Methods weak-forcing and
/// weak-state estimate it. With [algorithm.cycles] it goes with other methods too: Q then widens what a
/// window hands on, a propagated B by every error on the way to the next window, members by draws at its
/// start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelError {
    /// The covariance Q of one η, written as that of the background. On a rod it acts on [X, V]: positions
    /// [m] and velocities [m/s]; the angles obey the model exactly.
    pub covariance: Covariance,
    /// Steps of a sub-window: one η for each, entering at its end.
    #[serde(default = "one")]
    #[schemars(extend("minimum" = 1))]
    pub every: usize,
    /// Whether η enters after every step of its sub-window instead, a bias of the model (method
    /// weak-forcing).
    #[serde(default, skip_serializing_if = "is_default")]
    pub held: bool,
}

fn one() -> usize {
    1
}
