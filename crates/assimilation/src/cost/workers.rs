//! Further models that take a share of the columns of a sweep.

use crate::Error;
#[cfg(feature = "rayon")]
use rayon::prelude::*;
use varda_implicit::{Counts, Model};

/// Columns that an implicit step takes through its factor at once (a share of fewer would pay for as many).
#[cfg(feature = "rayon")]
const COLUMNS: usize = 16;

/// A product with many columns, in place.
pub(super) type Product = fn(&mut dyn Model, usize, &mut [f64]);

/// The models, and the work it took to make them.
#[derive(Default)]
pub(super) struct Workers {
    models: Vec<Box<dyn Model + Send>>,
    before: Counts,
}

impl Workers {
    /// So many models of states of length `dim`; none without the feature `rayon`.
    pub(super) fn new(
        make_model: &dyn Fn() -> Box<dyn Model + Send>,
        count: usize,
        dim: usize,
    ) -> Result<Self, Error> {
        let mut workers = Self::default();
        let count = if cfg!(feature = "rayon") { count } else { 0 };
        for _ in 0..count {
            let mut model = make_model();
            if model.dim() != dim {
                return Err(Error::Length {
                    what: "the state of a worker",
                    expected: dim,
                    found: model.dim(),
                });
            }
            model.keep_at_most(1);
            workers.before = workers.before + model.counts();
            workers.models.push(model);
        }
        Ok(workers)
    }

    /// The work of all since they were made.
    pub(super) fn counts(&self) -> Counts {
        self.models.iter().fold(Counts::default(), |sum, model| sum + model.counts()) - self.before
    }

    /// The product of step k with every column: the first share by `model`, where the step is linearized, the others by the workers, each
    /// of which linearizes it for itself. Who takes a column does not matter to its bits. The error is that of the first worker that failed.
    #[cfg(feature = "rayon")]
    pub(super) fn apply(
        &mut self,
        product: Product,
        model: &mut dyn Model,
        k: usize,
        [x, x_next]: [&[f64]; 2],
        columns: &mut [f64],
    ) -> Result<(), varda_implicit::Error> {
        let share =
            (columns.len() / x.len()).div_ceil(self.models.len() + 1).next_multiple_of(COLUMNS) * x.len();
        let (own, others) = columns.split_at_mut(share.min(columns.len()));
        if others.is_empty() {
            product(model, k, own);
            return Ok(());
        }
        let mut ended: Vec<Result<(), varda_implicit::Error>> = Vec::new();
        // In place: the model need not be `Send`.
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| {
                let shares = self.models.par_iter_mut().zip(others.par_chunks_mut(share));
                shares
                    .map(|(worker, columns)| {
                        worker.linearize(k, x, x_next)?;
                        product(&mut **worker, k, columns);
                        Ok(())
                    })
                    .collect_into_vec(&mut ended);
            });
            product(model, k, own);
        });
        ended.into_iter().collect()
    }

    /// The product of step k with every column.
    #[cfg(not(feature = "rayon"))]
    pub(super) fn apply(
        &mut self,
        product: Product,
        model: &mut dyn Model,
        k: usize,
        _: [&[f64]; 2],
        columns: &mut [f64],
    ) -> Result<(), varda_implicit::Error> {
        product(model, k, columns);
        Ok(())
    }
}
