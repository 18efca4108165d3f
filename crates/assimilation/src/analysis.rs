//! What an assimilation gives: plain data.

use crate::{ControlTransform, CostTerms, Minimum, Posterior};

/// The analysis of one window, per component of the control z.
///
/// ```
/// # use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// # use varda_covariance::Diagonal;
/// # use varda_implicit::{Rk4, lorenz::Lorenz63};
/// # let (mut model, b) = (Rk4::new(Lorenz63::default(), 0, 0.01), Diagonal::uniform(3, 1.0)?);
/// # let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// # let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
/// # let mut observations = ObservationSet::new(20, vec![all], seen)?;
/// # let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// # let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
/// // x₀ and x₂ of Lorenz-63 seen at step 20: `cost` is its strong constraint.
/// let mut v = vec![0.0; 3];
/// let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// let posterior = Posterior::new(&mut cost)?;
/// let analysis = Analysis::new(&transform, &v, &minimum, &posterior, 2);
/// assert!(analysis.sigma_analysis[0] < analysis.sigma_background[0]);
/// assert!(analysis.degrees_of_freedom < 2.0); // two values seen
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// z_b.
    pub background: Vec<f64>,
    /// z_a = z_b + B^{1/2} v.
    pub analysis: Vec<f64>,
    /// σ_b, the square roots of the diagonal of B.
    pub sigma_background: Vec<f64>,
    /// σ_a, the square roots of the diagonal of P_a.
    pub sigma_analysis: Vec<f64>,
    /// J at the analysis.
    pub value: f64,
    /// Its parts.
    pub terms: CostTerms,
    /// m, the number of observed values.
    pub observations: usize,
    /// χ² = 2J/m: about 1 where B and R are what they should be; 0 where nothing is observed.
    pub chi2: f64,
    /// Degrees of freedom for signal.
    pub degrees_of_freedom: f64,
}

impl Analysis {
    /// The analysis at v, with the posterior there and m observations.
    ///
    /// # Panics
    /// If a length does not agree with the transform.
    pub fn new(
        transform: &ControlTransform,
        v: &[f64],
        minimum: &Minimum,
        posterior: &Posterior,
        observations: usize,
    ) -> Self {
        let n = transform.control_dim();
        let mut analysis = vec![0.0; n];
        transform.control(v, &mut analysis);
        let mut sigma_background = vec![0.0; n];
        transform.covariance().variance(&mut sigma_background);
        let mut sigma_analysis = posterior.variance(transform);
        for sigma in sigma_background.iter_mut().chain(&mut sigma_analysis) {
            *sigma = sigma.max(0.0).sqrt();
        }
        Self {
            background: transform.background().to_vec(),
            analysis,
            sigma_background,
            sigma_analysis,
            value: minimum.value,
            terms: minimum.terms,
            observations,
            chi2: if observations == 0 { 0.0 } else { 2.0 * minimum.value / observations as f64 },
            degrees_of_freedom: posterior.degrees_of_freedom(),
        }
    }
}
