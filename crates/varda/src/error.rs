//! Errors: one clear message each, naming the file and line, the field or the step.
//!
//! As in the other crates, the cause of an error is part of its message and therefore not in its chain of
//! sources: a program that prints the chain prints nothing twice.

use std::path::PathBuf;

/// Anything that can stop a scene from being read, run or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene says something impossible. `place` is `file:line:column`, or the `--set` at fault.
    #[error("{place}: {message}")]
    Scene {
        /// Where.
        place: String,
        /// What is wrong and what would be right.
        message: String,
        /// The line of the scene and a mark below the place; empty where there is none.
        excerpt: String,
    },
    /// A data file (CSV) cannot be used. `place` is `file:line`.
    #[error("{place}: {message}")]
    Data {
        /// Where.
        place: String,
        /// What is wrong and what would be right.
        message: String,
    },
    /// A file cannot be read.
    #[error("{place}: cannot read {path}: {reason}")]
    Read {
        /// The key that names the file.
        place: String,
        /// The file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// No shipped scene and no file of that name.
    #[error(
        "no scene {name:?}: it is neither a file nor a shipped scene{suggestion} (`varda scenes` lists them)"
    )]
    NoScene {
        /// What was asked for.
        name: String,
        /// ", did you mean …?", or nothing.
        suggestion: String,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {path}: {reason}")]
    Write {
        /// What was being written.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// The output folder holds something that Varda did not write.
    #[error(
        "{path} exists and is not a result of Varda ({reason}); choose another folder with --out, or move it \
         away"
    )]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// How one can tell.
        reason: &'static str,
    },
    /// There is an unfinished run of the same result.
    #[error(
        "{path} holds an unfinished run; continue it with --resume, remove it, or choose another folder with \
         --out"
    )]
    Unfinished {
        /// The folder of the unfinished run.
        path: PathBuf,
    },
    /// An unfinished run cannot be resumed.
    #[error("{path} cannot be resumed: {reason}")]
    Resume {
        /// The folder of the unfinished run.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A folder of a study cannot be used.
    #[error("{path}: {reason}")]
    Sweep {
        /// The folder, or the file in it.
        path: PathBuf,
        /// Why, and what to do.
        reason: String,
    },
    /// The page of a result cannot be drawn again.
    #[error("{path}: its page cannot be drawn: {reason}")]
    Page {
        /// The folder of the result.
        path: PathBuf,
        /// What is missing, or which version wrote it.
        reason: String,
    },
    /// A plot could not be drawn.
    #[error("cannot draw {figure}: {reason}")]
    Plot {
        /// Which one.
        figure: String,
        /// Why.
        reason: String,
    },
    /// The rod refuses its description or state.
    #[error("rod: {0}")]
    Rod(varda_rod::Error),
    /// The model stopped before the window began.
    #[error("{stage}: {reason}")]
    Preparation {
        /// The static equilibrium, or the spin-up of the truth; its steps count from rest.
        stage: &'static str,
        /// Where and why.
        reason: varda_implicit::Error,
    },
    /// The model stopped.
    #[error("model: {0}")]
    Model(varda_implicit::Error),
    /// A covariance cannot be built.
    #[error("background covariance: {0}")]
    Covariance(varda_covariance::Error),
    /// The assimilation stopped.
    #[error("assimilation: {0}")]
    Assimilation(varda_assimilation::Error),
}

impl Error {
    /// The line of the scene that is at fault and a mark below the place, two lines of text; `None` where the
    /// error is of no such line.
    ///
    /// ```
    /// let scene = "[model]\nkind = \"lorenz63\"\nsigmas = 10.0\n";
    /// let error = varda::scene::SceneFile::parse("odd", "odd.toml", scene, None, &[]).unwrap_err();
    /// assert!(error.to_string().starts_with("odd.toml:3:1: unknown key"));
    /// assert_eq!(error.excerpt(), Some("    3 | sigmas = 10.0\n      | ^\n"));
    /// ```
    pub fn excerpt(&self) -> Option<&str> {
        match self {
            Error::Scene { excerpt, .. } if !excerpt.is_empty() => Some(excerpt),
            _ => None,
        }
    }

    /// The same of one of several recordings: its keys and rows are also those of others.
    pub(crate) fn of_recording(self, name: &str) -> Error {
        match self {
            Error::Scene { place, message, excerpt } => {
                Error::Scene { place, message: format!("recording {name:?}: {message}"), excerpt }
            }
            Error::Data { place, message } => {
                Error::Data { place, message: format!("recording {name:?}: {message}") }
            }
            other => other,
        }
    }
}

impl From<varda_rod::Error> for Error {
    fn from(reason: varda_rod::Error) -> Self {
        Error::Rod(reason)
    }
}

impl From<varda_implicit::Error> for Error {
    fn from(reason: varda_implicit::Error) -> Self {
        Error::Model(reason)
    }
}

impl From<varda_covariance::Error> for Error {
    fn from(reason: varda_covariance::Error) -> Self {
        Error::Covariance(reason)
    }
}

impl From<varda_assimilation::Error> for Error {
    fn from(reason: varda_assimilation::Error) -> Self {
        Error::Assimilation(reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error as _;

    #[test]
    fn a_chain_of_causes_says_nothing_twice() {
        let step = || varda_implicit::Error::SingularJacobian { step: 3, row: 1 };
        let io = || std::io::Error::other("no room");
        let all = [
            Error::from(step()),
            Error::from(varda_assimilation::Error::from(step())),
            Error::from(varda_assimilation::Error::from(varda_covariance::Error::Zero)),
            Error::from(varda_covariance::Error::Zero),
            Error::Preparation { stage: "spin-up of the truth", reason: step() },
            Error::Write { path: "r".into(), reason: io() },
            Error::Read { place: "s.toml:1:2".into(), path: "r".into(), reason: io() },
        ];
        for error in all {
            let message = error.to_string();
            let mut cause = error.source();
            while let Some(e) = cause {
                assert!(!message.contains(&e.to_string()), "{message}: {e}");
                cause = e.source();
            }
        }
    }
}
