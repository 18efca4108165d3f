//! Numbers that belong to states, kept for products that come back to the same ones.

use crate::At;

/// Numbers that were computed at states, one set for each of as many steps as there is room for: the rows of
/// an observation operator's H', which every product of a minimization asks for again.
///
/// ```
/// use varda_implicit::{At, Remembered};
///
/// let mut squares = Remembered::new(2, 2);
/// let (at, mut computed) = (At { step: 3, time: 0.3 }, 0);
/// for _ in 0..5 {
///     let x = [2.0, 3.0];
///     let known = squares.at(at, &x, |into| {
///         computed += 1;
///         into.iter_mut().zip(&x).for_each(|(y, x)| *y = x * x);
///     });
///     assert_eq!(known, [4.0, 9.0]);
/// }
/// assert_eq!(computed, 1);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Remembered {
    known: Vec<Known>,
    room: usize,
    numbers: usize,
}

#[derive(Debug, Clone, Default)]
struct Known {
    time: f64,
    x: Vec<f64>,
    numbers: Vec<f64>,
}

impl Remembered {
    /// Bytes of all that is kept, about; one set there is always.
    pub const BYTES: usize = 8_000_000;

    /// So many numbers at each state, which has so many itself.
    pub fn new(state: usize, numbers: usize) -> Remembered {
        let one = size_of::<f64>() * (state + numbers);
        Remembered { known: Vec::new(), room: Self::BYTES / one.max(1), numbers }
    }

    /// The numbers at a state; `find` fills zeros with them where they are not known.
    pub fn at(&mut self, at: At, x: &[f64], find: impl FnOnce(&mut [f64])) -> &[f64] {
        let slot = at.step % self.room.max(1);
        if self.known.len() <= slot {
            self.known.resize(slot + 1, Known::default());
        }
        let known = &mut self.known[slot];
        if !(known.time == at.time && known.x == x) {
            known.x.clear();
            known.numbers.clear();
            known.numbers.resize(self.numbers, 0.0);
            find(&mut known.numbers);
            known.x.extend_from_slice(x);
            known.time = at.time;
        }
        &known.numbers
    }

    /// Forgets all: what they follow from beside the state has changed.
    pub fn forget(&mut self) {
        self.known.clear();
    }
}
