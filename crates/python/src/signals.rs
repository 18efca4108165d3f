//! Long work beside an interpreter that goes on listening.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use pyo3::prelude::*;
use varda::Error;
use varda_linalg::interrupt::Ends;

use crate::error::raised;

/// How often Python is asked for signals: soon enough for a hand at the keyboard.
const EVERY: Duration = Duration::from_millis(50);

/// The stack of the thread that works: that of a program's main thread.
const STACK: usize = 8 << 20;

/// Does some work on a thread of its own, without the interpreter's lock, so that other threads of Python go
/// on. Where a signal of Python raises an exception (Ctrl-C: `KeyboardInterrupt`) the work is told to end,
/// and the exception is the result.
pub(crate) fn listening<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(Ends) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let ends: Ends = Arc::new(move || flag.load(Ordering::SeqCst));
    py.detach(|| {
        std::thread::scope(|scope| {
            // the sender is dropped at the end of the work, also where it panics
            let (done, ended) = sync_channel::<()>(0);
            let worker = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, move || {
                let _done = done;
                work(ends)
            })?;
            let mut signal = None;
            while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                if signal.is_none()
                    && let Err(raised) = Python::attach(|py| py.check_signals())
                {
                    stop.store(true, Ordering::SeqCst);
                    signal = Some(raised);
                }
            }
            let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            match signal {
                Some(signal) => Err(signal),
                None => result.map_err(raised),
            }
        })
    })
}
