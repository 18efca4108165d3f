//! What is kept of a window between its forward run and its sweeps, and what that costs.

use crate::Error;

/// What is kept of a window of n steps for the sweeps along it. Every policy gives the same bits (the
/// linearization of a step is a function of its two states): they trade memory for work.
///
/// ```
/// use varda_implicit::Storage;
///
/// // 100 steps with ten states at a time: each is run about twice more.
/// let few = Storage::Checkpoints { states: 10 };
/// assert_eq!((Storage::KeepAll.executed_steps(100), few.executed_steps(100)), (100, 322));
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Storage {
    /// All states, and in the model the linearization of every step. A sweep runs nothing again.
    #[default]
    KeepAll,
    /// All states. Every sweep linearizes every step again; the model holds one linearization at a time.
    States,
    /// At most `states` states at a time, x₀ among them (and the two of the step being worked on). An
    /// adjoint sweep runs steps again from the nearest state kept, by the binomial schedule, which runs the
    /// fewest (Griewank and Walther 2000); a tangent sweep runs every step once.
    Checkpoints {
        /// s, at least 1.
        states: usize,
    },
}

impl Storage {
    /// Steps run by one forward run and one adjoint sweep: n where the states are kept, and with s of them at
    /// a time
    ///
    /// ```text
    /// n + r n − C(s + r, s + 1),   r the least with C(s + r, s) ≥ n
    /// ```
    ///
    /// # Panics
    /// If no state is to be kept.
    pub fn executed_steps(self, steps: usize) -> usize {
        match self {
            Storage::KeepAll | Storage::States => steps,
            Storage::Checkpoints { .. } if steps == 0 => 0,
            Storage::Checkpoints { states: s } => {
                let r = repeats(steps, s);
                // C(s + r, s + 1) = C(s + r, s) r / (s + 1)
                let beyond = binomial(s, r) * r as u128 / (s as u128 + 1);
                ((1 + r) as u128 * steps as u128 - beyond) as usize
            }
        }
    }

    /// How many linearizations the model keeps at a time.
    pub(crate) fn linearizations(self) -> usize {
        match self {
            Storage::KeepAll => usize::MAX,
            Storage::States | Storage::Checkpoints { .. } => 1,
        }
    }
}

/// What a window takes: sizes from which memory under any [`Storage`] follows.
///
/// ```
/// use varda_implicit::{Footprint, Storage};
///
/// let window = Footprint { steps: 1000, runs: 2, state: 8000, linearization: 32_000, always: 0 };
/// assert_eq!(window.bytes(Storage::KeepAll), 48_016_000);
/// assert_eq!(window.within(100_000_000)?, Storage::KeepAll);
/// let storage = window.within(1_000_000)?;
/// assert!(matches!(storage, Storage::Checkpoints { states: 58 }), "{storage:?}");
/// assert!(window.bytes(storage) <= 1_000_000);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footprint {
    /// n, the number of steps.
    pub steps: usize,
    /// How many runs of the window are held at a time (a cost function holds two: its base point and a
    /// trial).
    pub runs: usize,
    /// Bytes of a state.
    pub state: usize,
    /// Bytes the model keeps of the linearization of a step.
    pub linearization: usize,
    /// Bytes held under every policy.
    pub always: usize,
}

impl Footprint {
    /// Bytes held under a policy: states of all runs, linearizations, and what is always held.
    pub fn bytes(&self, storage: Storage) -> usize {
        let run = match storage {
            Storage::KeepAll | Storage::States => (self.steps + 1) * self.state,
            // with the index of each
            Storage::Checkpoints { states } => states * (self.state + size_of::<usize>()) + 2 * self.state,
        };
        self.always + self.runs * run + self.steps.min(storage.linearizations()) * self.linearization
    }

    /// The policy of least work within a budget of bytes: all, else the states, else as many checkpoints as
    /// fit.
    ///
    /// # Errors
    /// [`Error::Memory`] where not even one checkpoint fits.
    pub fn within(&self, budget: usize) -> Result<Storage, Error> {
        let fits = |storage: &Storage| self.bytes(*storage) <= budget;
        if let Some(storage) = [Storage::KeepAll, Storage::States].into_iter().find(fits) {
            return Ok(storage);
        }
        let least = self.bytes(Storage::Checkpoints { states: 1 });
        let spare = budget.checked_sub(least).ok_or(Error::Memory { budget, least })?;
        Ok(Storage::Checkpoints {
            states: 1 + spare / (self.runs * (self.state + size_of::<usize>())).max(1),
        })
    }
}

/// Where the next state is kept on the way from step `from`, whose state is kept, to the end of step `to` −
/// 1, with room for `free` states, that at `from` included; `None` where no other is.
///
/// Both parts left and right of it are then no longer than the same number of repetitions can serve.
pub(crate) fn next_checkpoint(from: usize, to: usize, free: usize) -> Option<usize> {
    let length = to - from;
    if free < 2 || length < 2 {
        return None;
    }
    // length ≥ 2 makes r ≥ 1
    let r = repeats(length, free);
    let (left, right) = (binomial(free, r - 1), binomial(free - 1, r - 1));
    Some(from + left.min(length as u128 - right) as usize)
}

/// The least r with C(s + r, s) ≥ n.
fn repeats(n: usize, s: usize) -> usize {
    assert!(s > 0, "at least one state must be kept");
    let (mut r, mut reach) = (0, 1_u128);
    while reach < n as u128 {
        r += 1;
        reach = reach * (s + r) as u128 / r as u128;
    }
    r
}

/// C(s + r, s).
fn binomial(s: usize, r: usize) -> u128 {
    (1..=r as u128).fold(1, |c, i| c * (s as u128 + i) / i)
}
