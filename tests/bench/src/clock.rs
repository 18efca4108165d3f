//! Times of a piece of code: seconds that its thread has a core, so that other programs on the machine count
//! for little.

/// Seconds of one call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// The middle one of the samples.
    pub median: f64,
    /// The smallest: what other programs on the machine disturb least.
    pub least: f64,
}

impl Timing {
    /// Of some samples.
    ///
    /// # Panics
    /// If there are none.
    pub fn of(mut seconds: Vec<f64>) -> Timing {
        seconds.sort_by(f64::total_cmp);
        Timing { median: seconds[seconds.len() / 2], least: seconds[0] }
    }
}

/// A sample lasts at least this long \[s\]; shorter calls are repeated within it.
const SAMPLE: f64 = 2e-3;

/// Calls `code` once to warm up, then takes `samples` samples.
///
/// # Errors
/// What `code` returns.
pub fn timed<E>(samples: usize, mut code: impl FnMut() -> Result<(), E>) -> Result<Timing, E> {
    let mut sample = |repeats: usize| {
        let start = seconds();
        (0..repeats).try_for_each(|_| code())?;
        Ok((seconds() - start) / repeats as f64)
    };
    let first = sample(1)?;
    let repeats = (SAMPLE / first.max(1e-9)).ceil().max(1.0) as usize;
    Ok(Timing::of((0..samples).map(|_| sample(repeats)).collect::<Result<_, E>>()?))
}

/// Seconds of one call.
///
/// # Errors
/// What `code` returns.
pub fn seconds_of<E>(code: impl FnOnce() -> Result<(), E>) -> Result<f64, E> {
    let start = seconds();
    code()?;
    Ok(seconds() - start)
}

/// CPU time of this thread \[s\].
#[cfg(unix)]
fn seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// CPU time of all threads of this process \[s\].
#[cfg(unix)]
pub fn process_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// The wall's clock, where there is none of a process \[s\].
#[cfg(not(unix))]
pub fn process_seconds() -> f64 {
    seconds()
}

/// The wall's clock, where there is none of a thread \[s\].
#[cfg(not(unix))]
fn seconds() -> f64 {
    use std::sync::LazyLock;
    use std::time::Instant;
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    START.elapsed().as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_least() {
        assert_eq!(Timing::of(vec![5.0, 1.0, 3.0]), Timing { median: 3.0, least: 1.0 });
    }

    #[test]
    fn warms_up_and_repeats_what_is_short() {
        let mut calls = 0;
        let slow = || {
            calls += 1;
            let start = seconds();
            while seconds() - start < 3e-3 {}
            Ok::<(), ()>(())
        };
        let timing = timed(4, slow).unwrap();
        assert_eq!(calls, 5);
        assert!(timing.least >= 3e-3 && timing.median >= timing.least);
        let mut calls = 0;
        timed(2, || {
            calls += 1;
            Ok::<(), ()>(())
        })
        .unwrap();
        assert!(calls > 3, "{calls}");
        assert_eq!(timed(2, || Err(7)), Err(7));
    }
}
