//! What was measured at one time by one operator.

use crate::Error;
use crate::correlated::{Chain, Correlated};
use std::sync::Arc;
use varda_covariance::{Covariance, Dense, Kernel, Precision};

/// What was measured at one time by one operator: some of its rows, each with its value and standard
/// deviation.
///
/// A time between two steps is a fraction of the way. A component that was not measured is a row left out.
///
/// ```
/// use varda_assimilation::Observation;
///
/// // Rows 0 and 2 of operator 0 at step 20, both with σ = 0.1.
/// let first = Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1);
/// // Row 0 of operator 1, half way between steps 30 and 31.
/// let second = Observation::new(30, vec![0], vec![15.4], 0.2).between(0.5).operator(1).label("tip");
/// assert_eq!((first.weight, second.weight), (0.0, 0.5));
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Observation {
    /// Index of the operator in the set.
    pub operator: usize,
    /// The rows of the operator that were measured.
    pub rows: Vec<usize>,
    /// Step k of the window (0 is the initial state).
    pub step: usize,
    /// w ∈ [0, 1): the fraction of the way to step k + 1. Time t_k + w Δt.
    pub weight: f64,
    /// y, one for each row.
    pub values: Vec<f64>,
    /// σ > 0, one for each row, in the unit of the value.
    pub sigma: Vec<f64>,
    /// Their covariance, where the errors of the rows are correlated.
    pub correlation: Option<Correlated>,
    /// Where the errors of its rows are correlated with those of other observations.
    pub chain: Option<Chain>,
    /// Whether its values are one sighting, which the background check believes or refuses whole.
    pub together: bool,
    /// The name of the instrument or place; for reports only.
    pub label: String,
}

impl Observation {
    /// Some rows of operator 0, measured at a step of the window with independent errors of one standard
    /// deviation σ.
    ///
    /// Nothing is checked here: [`ObservationSet::new`](crate::ObservationSet::new) checks all observations
    /// of a window.
    pub fn new(step: usize, rows: Vec<usize>, values: Vec<f64>, sigma: f64) -> Self {
        let sigma = vec![sigma; rows.len()];
        Self {
            operator: 0,
            rows,
            step,
            weight: 0.0,
            values,
            sigma,
            correlation: None,
            chain: None,
            together: false,
            label: String::new(),
        }
    }

    /// With a standard deviation σ for each row, and independent errors.
    pub fn sigmas(self, sigma: Vec<f64>) -> Self {
        Self { sigma, correlation: None, chain: None, ..self }
    }

    /// At another step.
    pub fn at_step(self, step: usize) -> Self {
        Self { step, ..self }
    }

    /// The last step whose state it needs.
    pub fn last_step(&self) -> usize {
        self.step + usize::from(self.weight > 0.0)
    }

    /// Between its step k and step k + 1: `weight` w ∈ [0, 1) is the fraction of the way.
    pub fn between(self, weight: f64) -> Self {
        Self { weight, ..self }
    }

    /// Through another operator of the set than the first.
    pub fn operator(self, operator: usize) -> Self {
        Self { operator, ..self }
    }

    /// As one sighting, the three coordinates of a marker, say: where one of its values is a gross error the
    /// others are not believed either. The background check judges them together.
    pub fn together(self) -> Self {
        Self { together: true, ..self }
    }

    /// With a name for reports.
    pub fn label(self, label: impl Into<String>) -> Self {
        Self { label: label.into(), ..self }
    }
}

impl Observation {
    /// With errors of its rows that are correlated: R_k instead of diag σ², one row of R_k for each row of
    /// the observation. Its standard deviations become the square roots of the diagonal of R_k.
    ///
    /// ```
    /// use std::sync::Arc;
    /// use varda_assimilation::Observation;
    /// use varda_covariance::Dense;
    ///
    /// let r = Arc::new(Dense::new(2, &[0.04, 0.03, 0.03, 0.09])?);
    /// let seen = Observation::new(20, vec![0, 2], vec![8.1, 14.9], 1.0).correlated(r);
    /// assert!((seen.sigma[0] - 0.2).abs() < 1e-15 && (seen.sigma[1] - 0.3).abs() < 1e-15);
    /// # Ok::<(), varda_covariance::Error>(())
    /// ```
    pub fn correlated(self, r: Arc<dyn Precision + Send + Sync>) -> Self {
        let mut sigma = vec![0.0; r.dim()];
        r.variance(&mut sigma);
        sigma.iter_mut().for_each(|s| *s = s.sqrt());
        Self { sigma, correlation: Some(Correlated(r)), chain: None, ..self }
    }

    /// With errors that are correlated along lines with those of other observations: for each row the number
    /// of its chain and its place there. See [`Chain`].
    ///
    /// ```
    /// use varda_assimilation::{Observation, ObservationSet, Selection};
    /// use varda_covariance::Kernel;
    ///
    /// // One component every step, with errors that forget themselves in two steps.
    /// let memory = Kernel::Matern12 { length: 2.0 };
    /// let seen = |k: usize| Observation::new(k, vec![0], vec![1.0], 0.5);
    /// let one = |k: usize| seen(k).chained(memory, vec![(0, k as f64)]);
    /// let h = Selection::new(vec![0], 3)?;
    /// let set = ObservationSet::new(2, vec![Box::new(h)], (0..3).map(one).collect())?;
    /// let r = set.error_covariance();
    /// assert!((r[0] - 0.25).abs() < 1e-15 && (r[2] - 0.25 * (-1.0_f64).exp()).abs() < 1e-15);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn chained(self, kernel: Kernel, entries: Vec<(usize, f64)>) -> Self {
        Self { chain: Some(Chain { kernel, entries }), correlation: None, ..self }
    }

    /// Without the rows that `keep` refuses; of a correlated block the marginal covariance of the rows that
    /// stay.
    pub(crate) fn retain(&mut self, keep: &dyn Fn(usize) -> bool) -> Result<(), Error> {
        let kept: Vec<usize> = (0..self.rows.len()).filter(|&i| keep(i)).collect();
        if kept.len() == self.rows.len() {
            return Ok(());
        }
        self.rows = kept.iter().map(|&i| self.rows[i]).collect();
        self.values = kept.iter().map(|&i| self.values[i]).collect();
        self.sigma = kept.iter().map(|&i| self.sigma[i]).collect();
        if let Some(chain) = &mut self.chain {
            chain.entries = kept.iter().map(|&i| chain.entries[i]).collect();
        }
        if let Some(Correlated(r)) = self.correlation.take()
            && !kept.is_empty()
        {
            let (mut unit, mut column) = (vec![0.0; r.dim()], vec![0.0; r.dim()]);
            let mut marginal = Vec::new();
            for &j in &kept {
                unit[j] = 1.0;
                r.apply(&unit, &mut column);
                unit[j] = 0.0;
                marginal.extend(kept.iter().map(|&i| column[i]));
            }
            self.correlation = Some(Correlated(Arc::new(Dense::new(kept.len(), &marginal)?)));
        }
        Ok(())
    }
}
