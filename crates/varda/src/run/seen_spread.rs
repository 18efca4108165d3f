//! σ of what is observed, of a covariance that is carried along a run.

use varda_assimilation::{Carried, ObservationSet, Prediction};

use crate::Error;

/// σ of the rows of a set of observations, step by step: √diag(H P Hᵀ), H linearized at the run.
pub(super) struct SeenSpread<'a> {
    set: ObservationSet,
    /// The run, one state after the other, and the length of a state.
    states: &'a [f64],
    dim: usize,
    /// H(x) of it.
    run: Prediction,
    /// The first observation that is not done.
    next: usize,
    /// For each observation that is done σ of its rows; empty for the others.
    pub(super) sigma: Vec<Vec<f64>>,
}

/// Called with the place of an observation, a row of it, H(x), and what each column does to that row.
pub(super) type OnRow<'r> = dyn FnMut(usize, usize, f64, &mut dyn Iterator<Item = f64>) + 'r;

impl<'a> SeenSpread<'a> {
    /// Of a run, as far as it got.
    ///
    /// # Errors
    /// [`Error::Assimilation`] where a state cannot be observed.
    pub(super) fn new(mut set: ObservationSet, states: &'a [f64], dim: usize) -> Result<Self, Error> {
        let mut run = set.prediction();
        for k in 0..=set.last_step().unwrap_or(0) {
            let Some(x) = states.get(k * dim..(k + 1) * dim) else { break };
            set.observe_add(k, x, &mut run)?;
        }
        let sigma = vec![Vec::new(); set.observations().len()];
        Ok(SeenSpread { set, states, dim, run, next: 0, sigma })
    }

    /// Whether columns of the step before are asked for.
    pub(super) fn looks_back(&self) -> bool {
        self.set.observations()[self.next..].iter().any(|o| o.step < o.last_step())
    }

    /// The rows whose observations end at this step.
    pub(super) fn see(&mut self, at: &Carried, on_row: &mut OnRow) {
        let (k, n, first) = (at.step, self.dim, self.next);
        let Self { set, run, states, .. } = self;
        let ended = |o: &&varda_assimilation::Observation| o.last_step() <= k;
        let count = set.observations()[first..].iter().take_while(ended).count();
        if count == 0 {
            return;
        }
        let looks_back = set.observations()[first..first + count].iter().any(|o| o.step < k);
        let rows = set.rows(first).start..set.rows(first + count - 1).end;
        let (mut dy, mut values) = (vec![0.0; set.dim()], Vec::new());
        for (c, column) in at.now.chunks_exact(n).enumerate() {
            if looks_back {
                let (before, k) = (&at.before[c * n..(c + 1) * n], k - 1);
                set.tangent_add(k, &states[k * n..(k + 1) * n], before, run, &mut dy);
            }
            set.tangent_add(k, &states[k * n..(k + 1) * n], column, run, &mut dy);
            values.extend_from_slice(&dy[rows.clone()]);
            for k in [k.saturating_sub(1), k] {
                dy[set.rows_at(k)].fill(0.0);
            }
        }
        let squares = at.sum_of_squares(rows.len(), values.chunks_exact(rows.len().max(1)));
        for i in first..first + count {
            let own = set.observations()[i].rows.len();
            let size = |row: usize| squares[row - rows.start].sqrt();
            self.sigma[i] = set.rows(i).take(own).map(size).collect();
            for (c, row) in set.rows(i).take(own).enumerate() {
                let mut of_row = values.chunks_exact(rows.len()).map(|column| column[row - rows.start]);
                on_row(i, c, run.values()[row], &mut of_row);
            }
        }
        self.next += count;
    }
}
