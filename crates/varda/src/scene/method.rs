//! The members of the variational family and the minimizers, by their names in a scene.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A member of the variational family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Method {
    /// Strong-constraint 4D-Var.
    #[serde(rename = "4dvar")]
    FourDVar,
    /// Incremental 4D-Var: quadratic inner problems in the control space, re-linearized in an outer loop.
    #[serde(rename = "4dvar-incremental")]
    FourDVarIncremental,
    /// 4D-PSAS: the same inner problems solved in observation space (dual).
    #[serde(rename = "4d-psas")]
    FourDPsas,
    /// BLUE, the closed form, linearized once at the background: exact where model and observations are
    /// linear; otherwise one full Gauss-Newton step, with status "max_iterations" if its gradient is not
    /// below the tolerance. Dense.
    #[serde(rename = "blue")]
    Blue,
    /// 3D-Var: everything is observed at step 0.
    #[serde(rename = "3dvar")]
    ThreeDVar,
    /// Incremental 3D-Var: everything is observed at step 0.
    #[serde(rename = "3dvar-incremental")]
    ThreeDVarIncremental,
    /// PSAS, the dual of incremental 3D-Var: everything is observed at step 0.
    #[serde(rename = "psas")]
    Psas,
    /// Shapes without times: a rod at rest, whose constants [estimate] alone are unknown. Observed places are
    /// those of the equilibrium, by 3D-Var over the constants. Without [time] and [background], and with a
    /// file that has no column `time_s`.
    #[serde(rename = "static")]
    Static,
    /// Weak-constraint 4D-Var over the initial state and the forcing η of the model.
    #[serde(rename = "weak-forcing")]
    WeakForcing,
    /// Weak-constraint 4D-Var over the states at the ends of the sub-windows; B and Q need an inverse.
    #[serde(rename = "weak-state")]
    WeakState,
    /// 4D-EnVar: forward runs of an ensemble in the place of tangent and adjoint, relinearized up to
    /// `max_iterations` times (1: 4D-EnVar proper; more: the iterative ensemble smoother). J is that of the
    /// run of the analysis; one linearization of a nonlinear problem ends as `linearized_once`.
    #[serde(rename = "4denvar")]
    FourDEnVar,
    /// Hybrid 4D-EnVar: a static part of B beside the ensemble's, its increments constant through the window.
    /// Linearized once, and says so where the problem is nonlinear (`linearized_once`).
    #[serde(rename = "hybrid-4denvar")]
    HybridFourDEnVar,
}

impl Method {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Method::FourDVar => "4dvar",
            Method::FourDVarIncremental => "4dvar-incremental",
            Method::FourDPsas => "4d-psas",
            Method::Blue => "blue",
            Method::ThreeDVar => "3dvar",
            Method::ThreeDVarIncremental => "3dvar-incremental",
            Method::Psas => "psas",
            Method::Static => "static",
            Method::WeakForcing => "weak-forcing",
            Method::WeakState => "weak-state",
            Method::FourDEnVar => "4denvar",
            Method::HybridFourDEnVar => "hybrid-4denvar",
        }
    }

    /// All of them.
    pub const ALL: [Method; 12] = [
        Method::FourDVar,
        Method::FourDVarIncremental,
        Method::FourDPsas,
        Method::Blue,
        Method::ThreeDVar,
        Method::ThreeDVarIncremental,
        Method::Psas,
        Method::Static,
        Method::WeakForcing,
        Method::WeakState,
        Method::FourDEnVar,
        Method::HybridFourDEnVar,
    ];

    /// Takes a minimizer, and with it σ stages.
    pub fn takes_minimizer(self) -> bool {
        matches!(self, Method::FourDVar | Method::ThreeDVar | Method::Static | Method::WeakForcing)
    }

    /// Takes the Huber norm.
    pub fn takes_robust(self) -> bool {
        matches!(self, Method::FourDVar | Method::ThreeDVar | Method::Static)
    }

    /// Estimates the error of the model.
    pub fn is_weak(self) -> bool {
        matches!(self, Method::WeakForcing | Method::WeakState)
    }

    /// Its analysis is a run of the model, found with tangent or adjoint.
    pub fn is_strong(self) -> bool {
        !self.is_weak() && !self.is_ensemble()
    }

    /// Runs an ensemble.
    pub fn is_ensemble(self) -> bool {
        matches!(self, Method::FourDEnVar | Method::HybridFourDEnVar)
    }

    /// Can grow its window: a 4D method with a loop.
    pub fn takes_window_growth(self) -> bool {
        self != Method::Blue && !self.is_of_one_instant()
    }

    /// Analyses one instant: nothing may be observed after step 0.
    pub fn is_of_one_instant(self) -> bool {
        matches!(self, Method::ThreeDVar | Method::ThreeDVarIncremental | Method::Psas | Method::Static)
    }
}

/// The Hessian of minimizers and posterior.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Hessian {
    /// Without second derivatives of the model: I + GᵀG.
    #[default]
    GaussNewton,
    /// With them, by the second-order adjoint: the minimizer uses it where it predicts better, and σ of the
    /// analysis is that of the exact Hessian at the minimum, beside the largest difference from
    /// Gauss–Newton's and a check by draws that the posterior is Gaussian. For models and observations
    /// with second derivatives: not with `[[observations.sensors]]` of a rod at rest.
    Exact,
}

/// The enumeration of minimizers: each is the variant of the same name of `varda_assimilation::Minimizer`.
macro_rules! minimizers {
    ($($(#[$attribute:meta])* $variant:ident,)*) => {
        /// A minimizer.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "kebab-case")]
        pub enum Minimizer {
            $($(#[$attribute])* $variant,)*
        }

        impl Minimizer {
            /// All of them.
            pub const ALL: &[Minimizer] = &[$(Minimizer::$variant,)*];

            /// The library's minimizer, with its default settings.
            pub fn settings(self) -> varda_assimilation::Minimizer {
                match self {
                    $(Minimizer::$variant => varda_assimilation::Minimizer::$variant(Default::default()),)*
                }
            }
        }
    };
}

minimizers! {
    /// The default: the trust region, and further starts of it if one is not to be trusted. One is enough
    /// if it converges and J_o ≤ 10 m at the background (m observed values), or ends within the band of a
    /// fit, 2J/m ≤ 1 + 3 √(2/m). Otherwise the trust region starts again through enlarged σ (× 10, 3,
    /// 1 and × 16, 8, 4, 2, 1) and from up to six draws of the prior, until an end is within the band, two
    /// agree on the lowest J, or three in turn bring a settled J less than a tenth of the way to the band.
    /// The lowest end is the result; `attempts` in summary.json lists what each gained.
    Auto,
    /// Gauss–Newton with a trust region (Levenberg–Marquardt in the B⁻¹ norm).
    TrustRegion,
    /// The paper's Newton: dense Gauss–Newton Hessian (2.18), full steps. May diverge.
    Newton,
    /// Gauss–Newton with truncated conjugate gradients.
    #[serde(rename = "gauss-newton-cg")]
    NewtonCg,
    /// Limited-memory BFGS: gradients only.
    Lbfgs,
    /// Adam, the paper's other minimizer: gradients only, slow.
    Adam,
    /// L-BFGS of the argmin crate, for comparison.
    ArgminLbfgs,
    /// Trust region of the argmin crate, for comparison.
    ArgminTrustRegion,
}

impl Minimizer {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        self.settings().name()
    }
}

#[cfg(test)]
mod tests {
    use super::Minimizer;

    /// A scene can name every minimizer of the library, by the library's name.
    #[test]
    fn names_are_those_of_the_library() {
        let written: Vec<String> =
            Minimizer::ALL.iter().map(|m| serde_json::to_string(m).unwrap().replace('"', "")).collect();
        let names: Vec<&str> = Minimizer::ALL.iter().map(|m| m.name()).collect();
        assert_eq!(written, names);
        let mut library = varda_assimilation::Minimizer::NAMES.to_vec();
        library.sort_unstable();
        let mut names = names;
        names.sort_unstable();
        assert_eq!(names, library);
    }
}
