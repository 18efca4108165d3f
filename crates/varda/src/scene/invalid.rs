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
        let [s, length] = [s, length].map(rounded);
        invalid(path, format!("arc length {s} m is off the rod (0 to {length} m)"))
    }
}

/// A number in a message, with the ten digits that matter: a sum of lengths is 0.6, not 0.6000000000000001.
pub(crate) fn rounded(value: f64) -> f64 {
    format!("{value:.9e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn rounding_of_sums_is_not_rounded() {
        assert_eq!(rounded(0.1 + 0.2 + 0.3), 0.6);
        assert_eq!(rounded(1.0 - 0.9), 0.1);
        for kept in [0.0, 0.600_000_1, 1e-50, -9.81, 1e7 / 3.0, f64::INFINITY] {
            assert!((rounded(kept) - kept).abs() <= 1e-9 * kept.abs() || rounded(kept) == kept);
        }
        assert!(rounded(f64::NAN).is_nan());
    }
}
