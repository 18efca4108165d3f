//! Cost functions of a control vector v, as minimizers see them.

mod background_check;
mod chi_squared;
mod dense;
mod dense_work;
mod dual;
mod ensemble;
mod exact;
mod exact_work;
mod function;
mod huber;
mod incremental;
mod joint;
mod least_squares;
mod model_error;
mod strong;
mod tridiagonal;
mod weak_forcing;
mod weak_state;
mod whitening;

pub use background_check::Rejection;
pub use chi_squared::highest_j_of_a_fit;
pub use dual::Dual;
pub(crate) use ensemble::run_each;
pub use ensemble::{EnVar, EnVarOptions, EnsembleUpdate};
pub use function::{CostFunction, CostTerms, Counts};
pub use huber::huber;
pub use incremental::InnerCost;
pub use joint::Joint;
pub use least_squares::LeastSquares;
pub(crate) use least_squares::{columns, dense_jacobian, parts, rows, solve_identity_plus};
pub use model_error::Forcing;
pub use strong::StrongConstraint;
pub use weak_forcing::WeakForcing;
pub use weak_state::WeakState;

pub(crate) use varda_linalg::{dot, norm};
