//! A key of a scene that is wrong, and the refusal itself.

/// What is wrong with which key (dotted path).
#[derive(Debug)]
pub(super) struct Invalid {
    pub(super) path: String,
    pub(super) message: String,
}

pub(super) type Check = Result<(), Invalid>;

pub(super) fn invalid(path: impl Into<String>, message: impl Into<String>) -> Check {
    Err(Invalid { path: path.into(), message: message.into() })
}

/// Exactly one of two keys must be there.
pub(super) fn one_of(section: &str, a: (&str, bool), b: (&str, bool)) -> Check {
    match (a.1, b.1) {
        (true, true) => {
            invalid(format!("{section}.{}", b.0), format!("give `{}` or `{}`, not both", a.0, b.0))
        }
        (false, false) => invalid(section, format!("[{section}] needs `{}` or `{}`", a.0, b.0)),
        _ => Ok(()),
    }
}
