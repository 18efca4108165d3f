//! Errors of a step: typed, with numbers, naming the step.

/// Why a step's own equations or an observation operator refuse a state: a fold, a zero edge, a value that is
/// not finite. It holds the typed error of the crate that defines them, which this crate need not know.
///
/// Any error becomes a refusal by `?`, and a refusal becomes a `Box<dyn Error>` by `?`; for that it is no
/// `Error` itself. It derefs to the error it holds: `downcast_ref` gets the typed one back.
///
/// ```
/// use varda_implicit::Refusal;
///
/// fn parsed(word: &str) -> Result<f64, Refusal> {
///     let x: f64 = word.parse()?;
///     if x > 0.0 { Ok(x) } else { Err(Refusal::new("not positive")) }
/// }
///
/// fn main() -> Result<(), Box<dyn std::error::Error>> {
///     assert_eq!(parsed("2")?, 2.0);
///     assert_eq!(parsed("-2").unwrap_err().to_string(), "not positive");
///     assert!(parsed("two").unwrap_err().downcast_ref::<std::num::ParseFloatError>().is_some());
///     Ok(())
/// }
/// ```
pub struct Refusal(Box<dyn std::error::Error + Send + Sync>);

impl Refusal {
    /// From an error, a boxed error, or text.
    pub fn new(reason: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self(reason.into())
    }

    /// The typed error.
    ///
    /// # Errors
    /// The refusal as it was, where it holds another type.
    pub fn downcast<E: std::error::Error + 'static>(self) -> Result<E, Self> {
        self.0.downcast().map(|error| *error).map_err(Self)
    }
}

impl<E: std::error::Error + Send + Sync + 'static> From<E> for Refusal {
    fn from(error: E) -> Self {
        Self(Box::new(error))
    }
}

impl From<Refusal> for Box<dyn std::error::Error + Send + Sync> {
    fn from(refusal: Refusal) -> Self {
        refusal.0
    }
}

impl From<Refusal> for Box<dyn std::error::Error> {
    fn from(refusal: Refusal) -> Self {
        refusal.0
    }
}

impl std::ops::Deref for Refusal {
    type Target = dyn std::error::Error + Send + Sync;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl std::fmt::Debug for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// What can go wrong while a step is taken or linearized.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Newton's method ran out of iterations, or its line search out of room, and so did the halving of the
    /// step.
    #[error(
        "step {step} (t = {} s, Δt = {} s): Newton stopped after {iterations} iterations with \
         |du| = {update:.3e} (wanted {tolerance:.3e})",
        rounded(*time),
        rounded(*length)
    )]
    NewtonDiverged {
        /// Index k of the step.
        step: usize,
        /// Time at the start of the interval that failed (s).
        time: f64,
        /// Length of the interval that failed (s).
        length: f64,
        /// Iterations done.
        iterations: usize,
        /// Size of the last update, in the step's own norm.
        update: f64,
        /// The size that was asked for.
        tolerance: f64,
    },
    /// ∂G/∂u has no usable factorization.
    #[error("step {step}: the Jacobian ∂G/∂u is singular at row {row}")]
    SingularJacobian {
        /// Index k of the step.
        step: usize,
        /// Row of the first unusable pivot.
        row: usize,
    },
    /// The Jacobian of a right-hand side is not the derivative that its tangent is, or its structure leaves
    /// out an entry.
    #[error(
        "step {step}: row {row} of ∂f/∂x dx is {jacobian:e} by the Jacobian and {tangent:e} by the \
         tangent; one of them is wrong, or the structure leaves out an entry"
    )]
    JacobianDisagrees {
        /// Index k of the step at which they were compared.
        step: usize,
        /// The first row that differs.
        row: usize,
        /// What the Jacobian gives there.
        jacobian: f64,
        /// What the tangent gives there.
        tangent: f64,
    },
    /// A pair of states to linearize at is not a step of the model.
    #[error(
        "step {step}: x_{{k+1}} does not follow from x_k; a step is linearized at a pair it was taken between"
    )]
    NotAStep {
        /// Index k of the step.
        step: usize,
    },
    /// A budget of memory too small for the sparest [`Storage`](crate::Storage).
    #[error("{budget} bytes are too few for this window: one checkpoint already takes {least}")]
    Memory {
        /// Bytes allowed.
        budget: usize,
        /// Bytes needed at least.
        least: usize,
    },
    /// A check that would have compared nothing with nothing, or rounding with rounding.
    #[error("an empty test: {what}")]
    EmptyTest {
        /// What was missing.
        what: &'static str,
    },
    /// A value that is not finite left a step.
    #[error("step {step}: {what} is not finite")]
    NonFinite {
        /// Index k of the step.
        step: usize,
        /// Which vector.
        what: &'static str,
    },
    /// The shortest step allowed is too long for the error asked for.
    #[error(
        "t = {} s: a step of {length:.3e} s has an error of {error:.3e} (wanted {tolerance:e}); no shorter \
         one is allowed",
        rounded(*time)
    )]
    ToleranceNotMet {
        /// Time at the start of the step (s).
        time: f64,
        /// Its length (s).
        length: f64,
        /// The error estimated.
        error: f64,
        /// The most it may be.
        tolerance: f64,
    },
    /// The step's own equations refused the state.
    #[error("step {step}: {reason}")]
    Refused {
        /// Index k of the step.
        step: usize,
        /// The typed error of the step. Part of the message, hence not of the chain of sources as well.
        reason: Refusal,
    },
}

impl Error {
    /// What a step's own equations refused; an error of this crate among it (of a solve within the step) is
    /// told as it is, once.
    #[cfg(feature = "implicit")]
    pub fn refused(step: usize, reason: Refusal) -> Error {
        match reason.downcast::<Error>() {
            Ok(error) => error.at_step(step),
            Err(reason) => Error::Refused { step, reason },
        }
    }

    /// The same error under the number that step has for the caller.
    pub(crate) fn at_step(mut self, k: usize) -> Error {
        match &mut self {
            Error::NewtonDiverged { step, .. }
            | Error::SingularJacobian { step, .. }
            | Error::NotAStep { step }
            | Error::JacobianDisagrees { step, .. }
            | Error::NonFinite { step, .. }
            | Error::Refused { step, .. } => *step = k,
            Error::EmptyTest { .. } | Error::ToleranceNotMet { .. } | Error::Memory { .. } => {}
        }
        self
    }
}

/// A number with the ten digits that matter in a message: 0.6, not 0.6000000000000001.
fn rounded(value: f64) -> f64 {
    format!("{value:.9e}").parse().unwrap_or(value)
}
