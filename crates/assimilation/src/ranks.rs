//! Work that several processes share: which items are whose, and how all come to have all of them.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

/// The processes of one job, as MPI calls them. Every process makes the same calls in the same order, and so
/// comes to the same results: what takes long is divided among them and gathered, all else each does itself.
///
/// A gather has no error: where another process has failed, or is about to gather something else, no process
/// can go on, and the implementation ends the job.
pub trait Ranks {
    /// Which of the processes this is, from 0.
    fn rank(&self) -> usize;

    /// How many there are.
    fn count(&self) -> usize;

    /// The numbers of all processes, those of rank 0 first, the bits as they were. `inputs` are what the
    /// gathered numbers follow from: they have to be the same everywhere, and an implementation may see to
    /// that.
    fn all_gather(&self, inputs: &[f64], mine: &[f64]) -> Vec<f64>;
}

thread_local! {
    /// Those of the scope of [`within`] that this thread is in.
    static CURRENT: RefCell<Option<Rc<dyn Ranks>>> = const { RefCell::new(None) };
}

/// Does some work on this thread that is shared with other processes: the runs of members of ensembles
/// ([`EnVar`](crate::EnVar), [`cycle`](crate::cycle())), and the columns or rows of dense Hessians of
/// [`StrongConstraint`](crate::StrongConstraint) and the costs made of it, where they are large enough
/// ([`LEAST_NUMBERS`]). The same bits and counts for any number of processes, and without a scope.
///
/// ```
/// use std::rc::Rc;
/// use varda_assimilation::ranks::{self, Ranks};
///
/// /// One process alone.
/// struct Alone;
///
/// impl Ranks for Alone {
///     fn rank(&self) -> usize {
///         0
///     }
///     fn count(&self) -> usize {
///         1
///     }
///     fn all_gather(&self, _inputs: &[f64], mine: &[f64]) -> Vec<f64> {
///         mine.to_vec()
///     }
/// }
///
/// assert_eq!(ranks::within(Rc::new(Alone), || ranks::current().map(|r| r.count())), Some(1));
/// assert!(ranks::current().is_none() && ranks::is_first());
/// ```
pub fn within<T>(ranks: Rc<dyn Ranks>, work: impl FnOnce() -> T) -> T {
    struct Scope(Option<Rc<dyn Ranks>>);
    impl Drop for Scope {
        fn drop(&mut self) {
            CURRENT.set(self.0.take());
        }
    }
    let _scope = Scope(CURRENT.replace(Some(ranks)));
    work()
}

/// The processes that share the work of this thread; `None` outside of [`within`].
pub fn current() -> Option<Rc<dyn Ranks>> {
    CURRENT.with_borrow(Clone::clone)
}

/// Whether this process is the one that writes and prints: rank 0, and any outside of [`within`].
pub fn is_first() -> bool {
    current().is_none_or(|ranks| ranks.rank() == 0)
}

/// The items of a rank: blocks in the order of ranks, whose sizes differ by one at most.
///
/// ```
/// use varda_assimilation::ranks::share;
///
/// assert_eq!([0, 1, 2].map(|rank| share(8, rank, 3)), [0..3, 3..6, 6..8]);
/// assert_eq!([0, 1, 2].map(|rank| share(1, rank, 3).len()), [1, 0, 0]);
/// ```
///
/// # Panics
/// If there is no such rank.
pub fn share(items: usize, rank: usize, count: usize) -> Range<usize> {
    assert!(rank < count, "rank {rank} of {count}");
    let first = |rank: usize| rank * (items / count) + rank.min(items % count);
    first(rank)..first(rank + 1)
}

/// The items of a rank where they take unlike work: blocks in the order of ranks. An item belongs to the rank
/// in whose part of the whole work its middle lies.
///
/// ```
/// use varda_assimilation::ranks::share_of_work;
///
/// assert_eq!([0, 1].map(|rank| share_of_work(&[1, 1, 2, 1, 5], rank, 2)), [0..4, 4..5]);
/// assert_eq!([0, 1].map(|rank| share_of_work(&[3; 5], rank, 2)), [0..2, 2..5]);
/// assert_eq!([0, 1].map(|rank| share_of_work(&[0, 0], rank, 2)), [0..2, 2..2]);
/// ```
///
/// # Panics
/// If there is no such rank.
pub fn share_of_work(work: &[usize], rank: usize, count: usize) -> Range<usize> {
    assert!(rank < count, "rank {rank} of {count}");
    let all: u128 = work.iter().map(|w| *w as u128).sum();
    let mut before = 0;
    let ranks = work.iter().map(|work| {
        let twice_the_middle = 2 * before + *work as u128;
        before += *work as u128;
        (twice_the_middle * count as u128).checked_div(2 * all).map_or(0, |rank| rank as usize)
    });
    let ranks: Vec<usize> = ranks.map(|of_item| of_item.min(count - 1)).collect();
    let first = |rank: usize| ranks.partition_point(|of_item| *of_item < rank);
    first(rank)..first(rank + 1)
}

/// The fewest numbers of columns, counted at every step of a window that they go through, that are worth a
/// gather. They take some 0.3 ms (9 ns a number of a rod); a gather is a few messages.
pub const LEAST_NUMBERS: usize = 30_000;

/// The processes that share products with linearized steps, of columns of so many numbers in all; `None`
/// where each does all of them.
pub(crate) fn for_numbers(numbers: usize) -> Option<Rc<dyn Ranks>> {
    current().filter(|_| numbers >= LEAST_NUMBERS)
}

/// What rank 0 says, for all: `text` of the others is not looked at. Outside of [`within`] it is `text`.
pub fn said_by_first(text: String) -> String {
    let Some(ranks) = current() else { return text };
    let mine: Vec<f64> = if ranks.rank() == 0 { text.bytes().map(f64::from).collect() } else { Vec::new() };
    let bytes = ranks.all_gather(&[], &mine).into_iter().map(|byte| byte as u8).collect();
    String::from_utf8(bytes).unwrap_or_default()
}
