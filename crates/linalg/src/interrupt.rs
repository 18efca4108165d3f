//! Long calculations that end early when they are asked to.

use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use crate::Error;

/// Says whether to end; asked often, so it has to be quick.
pub type Ends = Arc<dyn Fn() -> bool + Send + Sync>;

thread_local! {
    /// Those of the scopes of [`within`] that this thread is in.
    static ASKED: RefCell<Vec<Ends>> = const { RefCell::new(Vec::new()) };
    /// Whether something of this thread was told to end since it came into the outermost scope.
    static TOLD: Cell<bool> = const { Cell::new(false) };
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
    ASKED.with(|asked| {
        if asked.borrow().is_empty() {
            TOLD.set(false);
        }
        asked.borrow_mut().push(ends);
    });
    let _scope = Scope;
    work()
}

/// Whether the work of this thread is to end; false outside of [`within`].
pub fn requested() -> bool {
    let now = ASKED.with(|asked| asked.borrow().iter().any(|ends| ends()));
    if now {
        TOLD.set(true);
    }
    now
}

/// Whether something that this thread computed in its present scope was told to end, and may be left half
/// done.
pub fn was_told() -> bool {
    ASKED.with(|asked| !asked.borrow().is_empty()) && TOLD.get()
}

/// The question of this thread, for others that work for it; `None` outside of [`within`].
///
/// ```
/// use std::sync::Arc;
/// use varda_linalg::interrupt;
///
/// let told = interrupt::within(Arc::new(|| true), || {
///     let ends = interrupt::asked().expect("it is asked here");
///     std::thread::spawn(move || interrupt::within(ends, interrupt::requested)).join().unwrap()
/// });
/// assert!(told && interrupt::asked().is_none());
/// ```
pub fn asked() -> Option<Ends> {
    let all = ASKED.with(|asked| asked.borrow().clone());
    (!all.is_empty()).then(|| -> Ends { Arc::new(move || all.iter().any(|ends| ends())) })
}

/// Multiplications between two questions: some hundredths of a second.
const PART: usize = 500_000_000;

/// Columns of a result, `each` multiplications a column, in parts of which none takes long: the first of a
/// part and how many. Ends early where the work is to end; what is left out is then not looked at.
pub(crate) fn parts(each: usize, columns: usize) -> impl Iterator<Item = (usize, usize)> {
    // whole panels of the kernels
    let width = (PART / each.max(1)).max(16).next_multiple_of(16);
    let from = (0..columns).step_by(width).take_while(|from| *from == 0 || !requested());
    from.map(move |from| (from, width.min(columns - from)))
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

    /// A product asks before each part but the first, and leaves out what follows a yes.
    #[test]
    fn a_large_product_is_left_between_its_parts() {
        use crate::dense::{View, gram, product};
        let n = 1200;
        let a: Vec<f64> = (0..n * n).map(|i| (1.7 * i as f64).sin()).collect();
        let width = PART / (n * n) / 16 * 16 + 16;
        let parts = n.div_ceil(width);
        assert!(parts >= 4, "{parts}");
        let run = |question: usize, whole: &dyn Fn(&mut [f64])| {
            let asked = Arc::new(AtomicUsize::new(0));
            let count = Arc::clone(&asked);
            let mut c = vec![0.0; n * n];
            within(Arc::new(move || count.fetch_add(1, Ordering::SeqCst) >= question), || whole(&mut c));
            (asked.load(Ordering::SeqCst), c)
        };
        let view = || View::new(&a, n, n);
        let by_product = |c: &mut [f64]| product(view(), view().transpose(), c);
        let by_gram = |c: &mut [f64]| gram(view(), c);
        let both: [&dyn Fn(&mut [f64]); 2] = [&by_product, &by_gram];
        for whole in both {
            let (asked, all) = run(usize::MAX, whole);
            assert_eq!(asked, parts - 1);
            let (asked, some) = run(1, whole);
            assert_eq!(asked, 2);
            // two parts are done, in the columns from the first on
            assert_eq!(some[..n], all[..n]);
            assert_eq!(some[n * n - 1], 0.0);
            // sums of n terms of size one
            let entry: f64 = (0..n).map(|k| a[7 + k * n] * a[n - 1 + k * n]).sum();
            assert!((all[7 + (n - 1) * n] - entry).abs() <= 1e-11, "{} {entry}", all[7 + (n - 1) * n]);
        }
    }

    #[test]
    fn a_large_factorization_is_left() {
        let n = LARGE;
        let matrix: Vec<f64> = (0..n * n).map(|i| f64::from(u8::from(i % (n + 1) == 0))).collect();
        let ended = within(Arc::new(|| true), || crate::dense::Cholesky::new(n, &matrix));
        assert!(matches!(ended, Err(Error::Interrupted)));
        assert!(within(Arc::new(|| false), || crate::dense::Cholesky::new(n, &matrix)).is_ok());
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
