//! Long work beside an interpreter that goes on listening.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use varda::Error;
use varda_linalg::interrupt::Ends;

use crate::error::raised;

/// How often Python is asked for signals: soon enough for a hand at the keyboard.
const EVERY: Duration = Duration::from_millis(50);

/// How long work that was told to end is waited for, where it may be left.
const PATIENCE: Duration = Duration::from_millis(250);

/// The stack of the thread that works: that of a program's main thread.
const STACK: usize = 8 << 20;

/// Whether work that was told to end may be left to itself. It ends at its next question.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Leave {
    /// It does not call Python, and nothing waits for it.
    Yes,
    /// It calls Python.
    No,
}

/// Does some work on a thread of its own, without the interpreter's lock, so that other threads of Python go
/// on. Where a signal of Python raises an exception (Ctrl-C: `KeyboardInterrupt`) the work is told to end,
/// and the exception is the result.
pub(crate) fn listening<T: Send + 'static>(
    py: Python<'_>,
    leave: Leave,
    work: impl FnOnce(Ends) -> Result<T, Error> + Send + 'static,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let ends: Ends = Arc::new(move || flag.load(Ordering::SeqCst));
    py.detach(|| {
        // the sender is dropped at the end of the work, also where it panics
        let (done, ended) = sync_channel::<()>(0);
        let worker = std::thread::Builder::new().stack_size(STACK).spawn(move || {
            let _done = done;
            work(ends)
        })?;
        let mut signal: Option<(PyErr, Instant)> = None;
        while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
            match signal.take() {
                Some((raised, since)) if leave == Leave::Yes && since.elapsed() >= PATIENCE => {
                    return Err(raised);
                }
                Some(told) => signal = Some(told),
                None => {
                    signal = Python::attach(|py| py.check_signals()).err().map(|e| (e, Instant::now()));
                    stop.store(signal.is_some(), Ordering::SeqCst);
                }
            }
        }
        let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match signal {
            Some((raised, _)) => Err(raised),
            None => result.map_err(raised),
        }
    })
}
