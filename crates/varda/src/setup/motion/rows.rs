//! Rows of recorded motions: their clock, order, coverage and gaps.

use varda_rod::{Matrix3, UnitQuaternion, Vector3};

use crate::Error;
use crate::scene::{Frame, SceneFile, rounded};

/// What the rows of a recording are about, for messages.
pub(super) struct Source<'a> {
    pub(super) scene: &'a SceneFile,
    /// The key that names the recording.
    pub(super) key: &'a str,
    /// The file.
    pub(super) label: String,
    /// The key that says its clock, and what it says.
    pub(super) time_zero: (&'a str, f64),
    /// First and last model time of the run \[s\].
    pub(super) run: [f64; 2],
}

impl Source<'_> {
    pub(super) fn invalid(&self, message: String) -> Error {
        self.scene.invalid(self.key, message)
    }

    pub(super) fn bad(&self, line: usize, message: impl Into<String>) -> Error {
        Error::Data { place: format!("{}:{line}", self.label), message: message.into() }
    }

    pub(super) fn refused(&self, error: varda_rod::Error) -> Error {
        Error::Data { place: self.label.to_string(), message: error.to_string() }
    }

    /// Model times of rows, each with its line: ascending, and from before the run to after it. What there is
    /// to say of gaps goes to `remarks`.
    pub(super) fn checked(
        &self,
        written: &[(usize, f64)],
        remarks: &mut Vec<String>,
    ) -> Result<Vec<f64>, Error> {
        let (time_zero_key, time_zero) = self.time_zero;
        let times: Vec<f64> = written.iter().map(|(_, time)| time - time_zero).collect();
        let (Some(first), Some(last)) = (times.first(), times.last()) else {
            return Err(self.invalid(format!("{} has no rows", self.label)));
        };
        if let Some(at) = times.windows(2).position(|w| !(w[0] < w[1])) {
            let (line, time) = written[at + 1];
            return Err(self.bad(line, format!("time_s = {time} is not after the row before")));
        }
        let [from, to] = self.run;
        // Times may be written to few digits: a tenth of the usual interval at an end is not missing.
        let interval = (last - first) / (times.len() - 1).max(1) as f64;
        let slack = (1e-6 * (last - first).max(to - from)).max(0.1 * interval);
        if *first > from + slack || *last < to - slack {
            let [first, last, from, to] = [*first, *last, from, to].map(rounded);
            return Err(self.invalid(format!(
                "{} has rows from {first} to {last} s of the model's clock, and the run needs {from} to \
                 {to} s: set {time_zero_key} (now {time_zero}), the window or report.forecast",
                self.label
            )));
        }
        remarks.extend(self.gap(&times));
        Ok(times)
    }

    /// The longest time within the run without rows, where it is long for this recording.
    fn gap(&self, times: &[f64]) -> Option<String> {
        let mut all: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
        all.sort_by(f64::total_cmp);
        let usual = *all.get(all.len() / 2)?;
        let within = times.windows(2).filter(|w| w[1] > self.run[0] && w[0] < self.run[1]);
        let longest = within.max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])))?;
        (longest[1] - longest[0] > 5.0 * usual).then(|| {
            format!(
                "{} has no rows from {} to {} s of the model's clock, elsewhere every {usual:.4} s: the \
                 motion is drawn across",
                self.label,
                rounded(longest[0]),
                rounded(longest[1])
            )
        })
    }
}

/// x_model = R x + t.
pub(super) struct Axes {
    turn: Matrix3<f64>,
    rotation: UnitQuaternion<f64>,
    origin: Vector3<f64>,
}

impl Axes {
    pub(super) fn of(frame: &Frame, origin: Vector3<f64>) -> Axes {
        // nalgebra takes the rows for columns.
        let turn = Matrix3::from(frame.rotation_rows()).transpose();
        Axes { turn, rotation: UnitQuaternion::from_matrix(&turn), origin }
    }

    pub(super) fn place(&self, written: [f64; 3]) -> Vector3<f64> {
        self.origin + self.turn * Vector3::from(written)
    }

    pub(super) fn rotation(&self, written: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        self.rotation * written
    }
}
