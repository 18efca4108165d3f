//! What a rod at rest keeps of its first state.

use varda_implicit::{Factor, LinearSolver, NewtonWork, Structure};

/// What a rod at rest at every step has beside one in motion: its first state is an equilibrium too.
pub(crate) struct AtRest {
    /// Time of the first state \[s\], that state before it came to rest, and its unknowns at rest.
    pub(crate) t: f64,
    pub(crate) from: Vec<f64>,
    pub(crate) u: Vec<f64>,
    /// What the equilibrium keeps, as a step does.
    pub(crate) kept: Vec<f64>,
    pub(crate) work: NewtonWork,
    pub(crate) solver: LinearSolver,
    pub(crate) factor: Factor,
    pub(crate) values: Vec<f64>,
    pub(crate) g: Vec<f64>,
    /// The columns of ∂G/∂p, and an increment of x that is none.
    pub(crate) columns: Vec<f64>,
    pub(crate) none: Vec<f64>,
    /// One parameter alone.
    pub(crate) dp: Vec<f64>,
    pub(crate) second: SecondAtRest,
}

/// What products with second derivatives of the first state need at one equilibrium with one λ.
#[derive(Default)]
pub(crate) struct SecondAtRest {
    /// Empty where nothing is known of the equilibrium last found.
    pub(crate) lambda: Vec<f64>,
    pub(crate) mu: Vec<f64>,
    pub(crate) kept: Vec<f64>,
    /// The columns of ∂G/∂p and ∂²L/∂u∂p, and ∂²L/∂p².
    pub(crate) columns: Vec<f64>,
    pub(crate) by_u: Vec<f64>,
    pub(crate) square: Vec<f64>,
}

impl AtRest {
    /// Of so many unknowns, numbers of a state and of what a step keeps, and parameters.
    pub(crate) fn new(structure: &Structure, [unknowns, state, kept, parameters]: [usize; 4]) -> AtRest {
        let solver = LinearSolver::new(unknowns, structure);
        AtRest {
            t: f64::NAN,
            from: Vec::new(),
            u: vec![0.0; unknowns],
            kept: vec![0.0; kept],
            work: NewtonWork::new(unknowns, structure),
            factor: solver.empty_factor(),
            values: vec![0.0; solver.values_len()],
            solver,
            g: vec![0.0; unknowns],
            columns: vec![0.0; unknowns * parameters],
            none: vec![0.0; state],
            dp: vec![0.0; parameters],
            second: SecondAtRest::default(),
        }
    }
}
