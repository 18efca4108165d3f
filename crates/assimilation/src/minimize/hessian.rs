//! Which Hessian a quadratic model of J has.

/// The Hessian of a quadratic model of J.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Hessian {
    /// A = I + GᵀG, without second derivatives of the model.
    #[default]
    GaussNewton,
    /// ∇²J, with them: in [`trust_region`](crate::trust_region()) wherever it predicted the last change of
    /// the gradient better than A, which is near a minimum; far from one it is as a rule indefinite, and A
    /// the better guide.
    Exact,
}

impl Hessian {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Hessian::GaussNewton => "gauss-newton",
            Hessian::Exact => "exact",
        }
    }
}
