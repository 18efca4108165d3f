//! Long calculations that end early when they are asked to.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use crate::Error;

/// Says whether to end; asked often, so it has to be quick.
pub type Ends = Arc<dyn Fn() -> bool + Send + Sync>;

thread_local! {
    /// Those of the scopes of [`within`] that this thread is in.
    static ASKED: RefCell<Vec<Ends>> = const { RefCell::new(Vec::new()) };
}

/// How often a decomposition is asked while it runs.
const EVERY: Duration = Duration::from_millis(20);

/// Matrices from this size on are decomposed on a thread of their own, which can be left; smaller ones take
/// some ten milliseconds.
const LARGE: usize = 250;

/// Does some work on this thread that ends early once `ends` says so: decompositions of large matrices fail
/// with [`Error::Interrupted`], and whoever asks [`requested`] may stop. Scopes may be nested; without one
/// nothing changes.
///
/// A decomposition that is left goes on in a thread of its own, and its result is dropped: this is for
/// programs that end soon after.
///
/// ```
/// use std::sync::Arc;
/// use varda_linalg::{Eigen, Error, interrupt};
///
/// let n = 300;
/// let matrix: Vec<f64> = (0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }).collect();
/// let ended = interrupt::within(Arc::new(|| true), || Eigen::new(n, &matrix));
/// assert_eq!(ended, Err(Error::Interrupted));
/// assert!(Eigen::new(n, &matrix).is_ok() && !interrupt::requested());
/// ```
pub fn within<T>(ends: Ends, work: impl FnOnce() -> T) -> T {
    struct Scope;
    impl Drop for Scope {
        fn drop(&mut self) {
            ASKED.with(|asked| asked.borrow_mut().pop());
        }
    }
    ASKED.with(|asked| asked.borrow_mut().push(ends));
    let _scope = Scope;
    work()
}

/// Whether the work of this thread is to end; false outside of [`within`].
pub fn requested() -> bool {
    ASKED.with(|asked| asked.borrow().iter().any(|ends| ends()))
}

/// A calculation on a matrix of size n by `work`, which owns all it needs: on this thread, or, where it is
/// large and may be asked to end, on one that can be left.
pub(crate) fn apart<T: Send + 'static>(
    n: usize,
    matrix: &[f64],
    work: impl FnOnce(&[f64]) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    if n < LARGE || ASKED.with(|asked| asked.borrow().is_empty()) {
        return work(matrix);
    }
    if requested() {
        return Err(Error::Interrupted);
    }
    let (done, result) = sync_channel(1);
    let copy = matrix.to_vec();
    std::thread::spawn(move || {
        // nobody waits for it where it was left
        let _ = done.send(work(&copy));
    });
    loop {
        match result.recv_timeout(EVERY) {
            Ok(result) => return result,
            Err(RecvTimeoutError::Timeout) if requested() => return Err(Error::Interrupted),
            Err(RecvTimeoutError::Timeout) => {}
            // a panic there
            Err(RecvTimeoutError::Disconnected) => return Err(Error::Eigen { dim: n }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Asked twice, it is left: what it does afterwards is not waited for.
    #[test]
    fn a_long_calculation_is_left() {
        let (asked, ended) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let (count, end) = (Arc::clone(&asked), Arc::clone(&ended));
        let (release, blocked) = sync_channel::<()>(1);
        let left = within(Arc::new(move || count.fetch_add(1, Ordering::SeqCst) >= 2), || {
            apart(LARGE, &[1.0], move |_| {
                let _ = blocked.recv();
                end.fetch_add(1, Ordering::SeqCst);
                Ok(())
            })
        });
        assert_eq!(left, Err(Error::Interrupted));
        assert_eq!((asked.load(Ordering::SeqCst), ended.load(Ordering::SeqCst)), (3, 0));
        drop(release);
        assert!(!requested());
    }

    #[test]
    fn one_that_is_not_asked_to_end_gives_the_same_bits() {
        let n = LARGE;
        let matrix: Vec<f64> = (0..n * n).map(|i| (1.0 + (i / n).abs_diff(i % n) as f64).recip()).collect();
        let alone = crate::Eigen::new(n, &matrix).unwrap();
        let asked = within(Arc::new(|| false), || crate::Eigen::new(n, &matrix)).unwrap();
        assert_eq!(alone, asked);
        let alone = crate::Svd::thin(n, n, &matrix).unwrap();
        let asked = within(Arc::new(|| false), || crate::Svd::thin(n, n, &matrix)).unwrap();
        assert_eq!(alone.values, asked.values);
        let work = |_: &[f64]| -> Result<(), Error> { panic!("a decomposition that panics") };
        let failed = within(Arc::new(|| false), || apart(n, &matrix, work));
        assert_eq!(failed, Err(Error::Eigen { dim: n }));
    }
}
