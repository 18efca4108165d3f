//! The control variable transform z = z_b + B^{1/2} v.

use crate::Error;
use varda_covariance::Covariance;

/// From the control variable v (prior N(0, I)) to the control z of the model (prior N(z_b, B)):
///
/// ```text
///     z = z_b + U v,    U = B^{1/2},    ‖v‖² = ‖z − z_b‖²_{B⁻¹}
/// ```
///
/// All costs are minimised in v: their Hessian is I + (something positive), no inverse of B is needed, and B
/// may be singular (v is then shorter than z, and z − z_b stays in the range of B).
///
/// ```
/// use varda_assimilation::ControlTransform;
/// use varda_covariance::Diagonal;
///
/// let b = Diagonal::new(vec![0.5, 2.0])?;
/// let transform = ControlTransform::new(vec![1.0, 10.0], &b)?;
/// let mut z = [0.0; 2];
/// transform.control(&[1.0, -1.0], &mut z); // one standard deviation up, one down
/// assert_eq!(z, [1.5, 8.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct ControlTransform<'a> {
    background: Vec<f64>,
    covariance: &'a dyn Covariance,
}

impl<'a> ControlTransform<'a> {
    /// Around the background z_b, with covariance B.
    ///
    /// # Errors
    /// A background of another length than B, or with a value that is not finite.
    pub fn new(background: Vec<f64>, covariance: &'a dyn Covariance) -> Result<Self, Error> {
        if background.len() != covariance.dim() {
            return Err(Error::Length {
                what: "the background",
                expected: covariance.dim(),
                found: background.len(),
            });
        }
        if !background.iter().all(|z| z.is_finite()) {
            return Err(Error::NonFinite { what: "the background", step: 0 });
        }
        Ok(Self { background, covariance })
    }

    /// Around a background that was checked before.
    pub(crate) fn checked(background: Vec<f64>, covariance: &'a dyn Covariance) -> Self {
        Self { background, covariance }
    }

    /// Length of v.
    pub fn dim(&self) -> usize {
        self.covariance.root_dim()
    }

    /// Length of z.
    pub fn control_dim(&self) -> usize {
        self.background.len()
    }

    /// z_b.
    pub fn background(&self) -> &[f64] {
        &self.background
    }

    /// B.
    pub fn covariance(&self) -> &'a dyn Covariance {
        self.covariance
    }

    /// z = z_b + U v.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn control(&self, v: &[f64], z: &mut [f64]) {
        self.covariance.root(v, z);
        for (z, b) in z.iter_mut().zip(&self.background) {
            *z += b;
        }
    }

    /// dz = U dv.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn tangent(&self, dv: &[f64], dz: &mut [f64]) {
        self.covariance.root(dv, dz);
    }

    /// dv = Uᵀ dz.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn adjoint(&self, dz: &[f64], dv: &mut [f64]) {
        self.covariance.root_transpose(dz, dv);
    }
}
