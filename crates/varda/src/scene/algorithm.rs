//! `[algorithm]`: the method, its minimizer, and their settings.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Cycles, Ensemble, Hessian, Method, Minimizer, ModelError};

/// How the cost is minimised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Algorithm {
    /// The member of the variational family.
    pub method: Method,
    /// The minimizer of methods 4dvar, 3dvar and weak-forcing. The other methods have their own loop.
    pub minimizer: Minimizer,
    /// The Hessian (methods 4dvar and 3dvar with minimizer auto or trust-region).
    #[serde(skip_serializing_if = "is_gauss_newton")]
    pub hessian: Hessian,
    /// Most outer iterations, at most 1e6: over all that a run of one window does, further starts, σ stages
    /// and sub-windows included.
    #[schemars(extend("minimum" = 1, "maximum" = 1000000))]
    pub max_iterations: usize,
    /// Converged when the gradient in the control variable is this much smaller than at the background.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub gradient_tolerance: f64,
    /// Observation-error continuation: σ of the observations is multiplied by these factors in turn, each
    /// stage starting where the last one ended. The last factor must be 1. Empty: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sigma_stages: Vec<f64>,
    /// Robust observations (methods 4dvar and 3dvar): departures beyond this many σ count linearly, not
    /// squared (Huber norm).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub robust: Option<f64>,
    /// Background check: observed values farther than this many √(HBHᵀ + R) from the background are
    /// refused before the minimization; the result lists them.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub background_check: Option<f64>,
    /// Growing window (4D methods): ends of sub-windows in steps, in turn, each started where the last one
    /// ended. The last must be the window. Empty: the whole window at once.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub window_growth: Vec<usize>,
    /// The error of the model (methods weak-forcing and weak-state; others with [algorithm.cycles]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model_error: Option<ModelError>,
    /// The ensemble (methods 4denvar and hybrid-4denvar).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ensemble: Option<Ensemble>,
    /// Window after window along a long run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cycles: Option<Cycles>,
}

fn is_gauss_newton(hessian: &Hessian) -> bool {
    *hessian == Hessian::GaussNewton
}

impl Default for Algorithm {
    fn default() -> Self {
        Algorithm {
            method: Method::FourDVar,
            minimizer: Minimizer::Auto,
            hessian: Hessian::GaussNewton,
            max_iterations: 1000,
            gradient_tolerance: 1e-8,
            sigma_stages: Vec::new(),
            robust: None,
            background_check: None,
            window_growth: Vec::new(),
            model_error: None,
            ensemble: None,
            cycles: None,
        }
    }
}

impl Algorithm {
    /// The ensemble of the method: that of the scene or the default one; `None` for methods without one.
    pub fn members(&self) -> Option<Ensemble> {
        self.method.is_ensemble().then(|| self.ensemble.clone().unwrap_or_default())
    }

    /// The solver of the method's problem in tables: its minimizer, or its own loop.
    pub fn solver_name(&self) -> &'static str {
        match self.method {
            Method::FourDVar | Method::ThreeDVar | Method::Static | Method::WeakForcing => {
                self.minimizer.name()
            }
            Method::FourDVarIncremental | Method::ThreeDVarIncremental | Method::WeakState => "outer-loop",
            Method::FourDEnVar | Method::HybridFourDEnVar => "ensemble",
            Method::FourDPsas | Method::Psas => "outer-loop-dual",
            Method::Blue => "closed-form",
        }
    }
}
