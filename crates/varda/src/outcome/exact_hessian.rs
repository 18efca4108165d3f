//! What second derivatives of the model do to the posterior.

use schemars::JsonSchema;
use serde::Serialize;

/// The exact Hessian at the analysis, beside Gauss–Newton's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct ExactHessian {
    /// Its smallest eigenvalue in the control variable, where Gauss–Newton's is at least 1; not positive
    /// where J is not convex. Of a posterior of low rank the smallest that was found; `None` where that has
    /// no error bound.
    pub smallest_eigenvalue: Option<f64>,
    /// The largest |σ/σ_GN − 1|; `None` where there is no posterior of the exact Hessian.
    pub sigma_change: Option<f64>,
    /// Draws of that posterior that were run through the model (0 of a posterior of low rank), and the share
    /// of them that counts: 1 for a Gaussian posterior.
    pub draws: usize,
    /// See `draws`.
    pub effective_share: Option<f64>,
}

/// A larger change of σ is said.
const LARGE: f64 = 0.1;
/// Below this share of draws that count the posterior is not Gaussian within its spread.
const GAUSSIAN: f64 = 0.5;

impl ExactHessian {
    /// What a user should know.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        match (self.smallest_eigenvalue, self.sigma_change) {
            (None, _) => remarks.push(
                "σ of the analysis is that of the Gauss–Newton Hessian: too many unknowns for a dense \
                 exact one, and its posterior of low rank leaves out more than can be bounded"
                    .into(),
            ),
            (Some(smallest), _) if !(smallest > 0.0) => remarks.push(format!(
                "J is not convex at the analysis (smallest eigenvalue of the exact Hessian {smallest:.2e}): \
                 it is no minimum, or a jump of J is near; σ is that of the Gauss–Newton Hessian"
            )),
            (_, Some(change)) if !(change <= LARGE) => remarks.push(format!(
                "second derivatives of the model change σ of the analysis by up to {:.0} %: σ here is that \
                 of the exact Hessian",
                100.0 * change
            )),
            _ => {}
        }
        if let Some(share) = self.effective_share.filter(|share| !(*share >= GAUSSIAN)) {
            remarks.push(format!(
                "the posterior is not Gaussian within its own spread: of {} draws run through the model \
                 {:.0} % count; believe the intervals as an order of magnitude",
                self.draws,
                100.0 * share
            ));
        }
        remarks
    }
}

#[cfg(test)]
mod tests {
    use super::ExactHessian;

    #[test]
    fn says_what_matters_and_no_more() {
        let quiet = ExactHessian {
            smallest_eigenvalue: Some(0.9),
            sigma_change: Some(0.05),
            draws: 32,
            effective_share: Some(0.8),
        };
        assert!(quiet.remarks().is_empty());
        let changed = ExactHessian { sigma_change: Some(0.185), ..quiet };
        assert!(changed.remarks()[0].contains("up to 18 %") || changed.remarks()[0].contains("up to 19 %"));
        let bent = ExactHessian { effective_share: Some(0.1), ..quiet };
        assert!(bent.remarks()[0].contains("10 % count"), "{:?}", bent.remarks());
        let saddle = ExactHessian { smallest_eigenvalue: Some(-0.2), sigma_change: None, ..quiet };
        assert!(saddle.remarks()[0].contains("not convex"));
    }
}
