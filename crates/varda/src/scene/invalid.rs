//! A key of a scene that is wrong, and choices between two keys.

/// What is wrong with which key (dotted path).
#[derive(Debug)]
pub(crate) struct Invalid {
    pub(crate) path: String,
    pub(crate) message: String,
}

pub(super) type Check = Result<(), Invalid>;

pub(super) fn invalid<T>(path: impl Into<String>, message: impl Into<String>) -> Result<T, Invalid> {
    Err(Invalid { path: path.into(), message: message.into() })
}

/// One of two alternatives.
pub(crate) enum Either<A, B> {
    /// The first key was given.
    First(A),
    /// The second key was given.
    Second(B),
}

/// The one of two keys that is given; it is an error to give both or neither.
pub(super) fn one_of<A, B>(
    section: &str,
    (first, a): (&str, Option<A>),
    (second, b): (&str, Option<B>),
) -> Result<Either<A, B>, Invalid> {
    match (a, b) {
        (Some(a), None) => Ok(Either::First(a)),
        (None, Some(b)) => Ok(Either::Second(b)),
        (Some(_), Some(_)) => {
            invalid(format!("{section}.{second}"), format!("give `{first}` or `{second}`, not both"))
        }
        (None, None) => invalid(section, format!("[{section}] needs `{first}` or `{second}`")),
    }
}

/// An arc length must lie on the rod.
pub(super) fn on_rod(path: &str, s: f64, length: f64) -> Check {
    if s >= 0.0 && s <= length * (1.0 + 1e-9) {
        Ok(())
    } else {
        invalid(path, format!("arc length {s} m is off the rod (0 to {length} m)"))
    }
}
