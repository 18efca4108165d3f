//! A cost in the raw variables z of the model, as the paper minimises it.

use crate::cost::Counts;
use crate::{ControlTransform, CostFunction, CostTerms, Error};
use varda_covariance::Precision;

/// The cost J of a control variable v seen as a function of z = z_b + B^{1/2} v:
///
/// ```text
///     J(z) = J(v),    v = B^{-1/2} (z − z_b),    ∇_z J = B^{-T/2} ∇_v J = B⁻¹ B^{1/2} ∇_v J
/// ```
///
/// What a minimizer without a Hessian meets when nothing is done about the scales and couplings of the
/// variables. It needs B⁻¹, hence [`Precision`] in the signature: a B of less than full rank has no such
/// form. For comparisons only; all else works in v.
///
/// Cost beyond that of the inner J: a product with B^{-1/2}, B^{1/2} and B⁻¹ each. Memory: four vectors.
pub struct RawVariables<'a> {
    cost: &'a mut (dyn CostFunction + 'a),
    precision: &'a dyn Precision,
    background: Vec<f64>,
    shift: Vec<f64>,
    v: Vec<f64>,
    gradient: Vec<f64>,
}

impl<'a> RawVariables<'a> {
    /// Of a cost in the control variable of `transform`, whose covariance is `precision`.
    ///
    /// # Errors
    /// A cost, a transform and a covariance of different lengths.
    pub fn new(
        cost: &'a mut (dyn CostFunction + 'a),
        transform: &ControlTransform,
        precision: &'a dyn Precision,
    ) -> Result<Self, Error> {
        let n = precision.dim();
        for (what, found) in [
            ("the control variable", cost.dim()),
            ("the background", transform.control_dim()),
            ("the square root of B", precision.root_dim()),
        ] {
            if found != n {
                return Err(Error::Length { what, expected: n, found });
            }
        }
        let background = transform.background().to_vec();
        Ok(Self { cost, precision, background, shift: vec![0.0; n], v: vec![0.0; n], gradient: vec![0.0; n] })
    }
}

impl CostFunction for RawVariables<'_> {
    fn dim(&self) -> usize {
        self.background.len()
    }

    fn evaluate(&mut self, z: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        assert_eq!(z.len(), self.dim(), "length of z");
        for ((shift, z), b) in self.shift.iter_mut().zip(z).zip(&self.background) {
            *shift = z - b;
        }
        self.precision.whiten(&self.shift, &mut self.v);
        match gradient {
            None => self.cost.evaluate(&self.v, None),
            Some(gradient) => {
                let value = self.cost.evaluate(&self.v, Some(&mut self.gradient))?;
                self.precision.root(&self.gradient, &mut self.shift);
                self.precision.solve(&self.shift, gradient);
                Ok(value)
            }
        }
    }

    fn terms(&self) -> CostTerms {
        self.cost.terms()
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.cost.set_observation_scale(scale);
    }

    fn counts(&self) -> Counts {
        self.cost.counts()
    }

    /// z has the units of the model.
    fn is_whitened(&self) -> bool {
        false
    }
}
