//! Errors of the crate: typed, with numbers, naming the observation or the step.

use varda_implicit::Refusal;

/// What can go wrong while an assimilation problem is set up or its cost is evaluated.
///
/// How a minimization *ended* is not an error: see [`Status`](crate::Status).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The model could not take or linearize a step.
    #[error(transparent)]
    Model(#[from] varda_implicit::Error),
    /// A covariance could not be built.
    #[error(transparent)]
    Covariance(#[from] varda_covariance::Error),
    /// An observation operator refused a state.
    #[error("observation operator {operator} at step {step}: {reason}")]
    Observe {
        /// Index of the operator.
        operator: usize,
        /// Index k of the step whose state was observed.
        step: usize,
        /// The typed error of the operator. Part of the message, hence not of the chain of sources as well.
        reason: Refusal,
    },
    /// A value that is not finite.
    #[error("step {step}: {what} is not finite")]
    NonFinite {
        /// Which quantity.
        what: &'static str,
        /// Index k of the step it belongs to.
        step: usize,
    },
    /// An observation names an operator that does not exist.
    #[error("observation {observation}: operator {operator} of {operators} does not exist")]
    UnknownOperator {
        /// Index of the observation, as given.
        observation: usize,
        /// The operator it names.
        operator: usize,
        /// How many there are.
        operators: usize,
    },
    /// An observation names a row its operator does not have.
    #[error("observation {observation}: row {row} of an operator with {rows} rows")]
    UnknownRow {
        /// Index of the observation, as given.
        observation: usize,
        /// The row it names.
        row: usize,
        /// How many there are.
        rows: usize,
    },
    /// An observation lies outside the window.
    #[error("observation {observation}: step {step} + {weight} is outside the window of {steps} steps")]
    OutsideWindow {
        /// Index of the observation, as given.
        observation: usize,
        /// Its step.
        step: usize,
        /// Its weight on the step after.
        weight: f64,
        /// Length K of the window in steps.
        steps: usize,
    },
    /// The weight on the later step is not in [0, 1).
    #[error("observation {observation}: weight {weight} is not in [0, 1)")]
    Weight {
        /// Index of the observation, as given.
        observation: usize,
        /// Its weight.
        weight: f64,
    },
    /// Rows, values and standard deviations differ in number.
    #[error("observation {observation}: {rows} rows, {values} values and {sigmas} standard deviations")]
    Lengths {
        /// Index of the observation, as given.
        observation: usize,
        /// Number of rows.
        rows: usize,
        /// Number of values.
        values: usize,
        /// Number of standard deviations.
        sigmas: usize,
    },
    /// A standard deviation that is not positive and finite.
    #[error("observation {observation}, entry {entry}: σ = {sigma} is not positive and finite")]
    Sigma {
        /// Index of the observation, as given.
        observation: usize,
        /// Position within the observation.
        entry: usize,
        /// The standard deviation.
        sigma: f64,
    },
    /// An observed value that is not finite.
    #[error("observation {observation}, entry {entry}: the value {value} is not finite")]
    Value {
        /// Index of the observation, as given.
        observation: usize,
        /// Position within the observation.
        entry: usize,
        /// The value.
        value: f64,
    },
    /// An observation operator was given an entry it cannot use.
    #[error("observation operator of {rows} × {columns}: entry {value} in row {row}, column {column}")]
    OperatorEntry {
        /// Row of the entry.
        row: usize,
        /// Number of rows.
        rows: usize,
        /// Column of the entry.
        column: usize,
        /// Number of columns, the length of the state.
        columns: usize,
        /// The entry.
        value: f64,
    },
    /// An observation operator reads a state of another length than the model's, or than the other
    /// operators'.
    #[error("observation operator {operator} reads a state of length {found}, not {expected}")]
    StateLength {
        /// Index of the operator.
        operator: usize,
        /// Length of the state.
        expected: usize,
        /// Length of the state that the operator reads.
        found: usize,
    },
    /// Values of one chain were given different kernels.
    #[error("the values of one chain of observations have different kernels")]
    MixedChain,
    /// A method for independent observation errors was given correlated ones.
    #[error("{what} asks for independent observation errors")]
    CorrelatedErrors {
        /// The method.
        what: &'static str,
    },
    /// A minimizer that uses the Hessian, or a joint cost, was given a cost whose control is not whitened.
    #[error("{minimizer} works in whitened variables, this cost does not (the outer loop and lbfgs take it)")]
    NotWhitened {
        /// Name of the minimizer, or "a joint cost".
        minimizer: &'static str,
    },
    /// Two parts of a problem disagree about a length.
    #[error("{what} has length {found}, expected {expected}")]
    Length {
        /// Which vector.
        what: &'static str,
        /// The length it must have.
        expected: usize,
        /// The length it has.
        found: usize,
    },
    /// The exact Hessian was asked for, and the model or an observation operator has no second derivatives.
    #[error(
        "no exact Hessian: the model or an observation operator has no second derivatives (a cost over \
         states has none either); use the Hessian of Gauss and Newton"
    )]
    NoSecondDerivatives,
    /// A setting outside its range.
    #[error("{what} = {value} is out of range")]
    Setting {
        /// Its name.
        what: &'static str,
        /// The value given.
        value: f64,
    },
    /// A carried covariance has no inverse.
    #[error(
        "the covariance that is carried on has {rank} directions of {dim}, and weak constraint over states \
         needs its inverse: leave nothing out of it, add a static part, or take the forcing form"
    )]
    Singular {
        /// Its rank.
        rank: usize,
        /// Its size.
        dim: usize,
    },
    /// A Hessian that should be positive definite is not, or its factorization failed.
    #[error("the Hessian is not positive definite: smallest eigenvalue {smallest:e}")]
    NotPositiveDefinite {
        /// Its smallest eigenvalue; NaN where the factorization itself failed.
        smallest: f64,
    },
}

impl From<varda_linalg::Error> for Error {
    fn from(error: varda_linalg::Error) -> Self {
        match error {
            varda_linalg::Error::NonFiniteProduct { .. } => {
                Error::NonFinite { what: "a product with the Hessian", step: 0 }
            }
            varda_linalg::Error::NegativeCurvature { curvature, .. } => {
                Error::NotPositiveDefinite { smallest: curvature }
            }
            _ => Error::NotPositiveDefinite { smallest: f64::NAN },
        }
    }
}
