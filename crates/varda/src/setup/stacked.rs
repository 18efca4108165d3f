//! Observation operators of one state, one above the other.

use varda_assimilation::ObservationOperator;
use varda_implicit::{At, Refusal};

/// y = (H_1(x), H_2(x), …).
pub(super) struct Stacked(Vec<Box<dyn ObservationOperator>>);

impl Stacked {
    /// One alone is itself.
    ///
    /// # Panics
    /// If there are none, or they are of states of different lengths.
    pub(super) fn of(mut parts: Vec<Box<dyn ObservationOperator>>) -> Box<dyn ObservationOperator> {
        assert!(parts.windows(2).all(|two| two[0].state_dim() == two[1].state_dim()), "of one state");
        match parts.len() {
            1 => parts.remove(0),
            _ => Box::new(Stacked(parts)),
        }
    }

    /// Each with its first row.
    fn each(&mut self) -> impl Iterator<Item = (std::ops::Range<usize>, &mut Box<dyn ObservationOperator>)> {
        self.0.iter_mut().scan(0, |row, part| {
            let first = *row;
            *row += part.dim();
            Some((first..*row, part))
        })
    }
}

impl ObservationOperator for Stacked {
    fn dim(&self) -> usize {
        self.0.iter().map(|part| part.dim()).sum()
    }

    fn state_dim(&self) -> usize {
        self.0[0].state_dim()
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.each().try_for_each(|(rows, part)| part.observe(at, x, &mut y[rows]))
    }

    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.each().for_each(|(rows, part)| part.tangent(at, x, dx, &mut dy[rows]));
    }

    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        self.each().for_each(|(rows, part)| part.adjoint_add(at, x, &dy[rows], dx));
    }

    fn has_second_derivatives(&self) -> bool {
        self.0.iter().all(|part| part.has_second_derivatives())
    }

    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        self.each().for_each(|(rows, part)| part.second_adjoint_add(at, x, dx, &dy[rows], out));
    }
}
