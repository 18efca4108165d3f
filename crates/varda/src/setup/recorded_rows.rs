//! Where the rows of a recording go, whatever they observe.

use std::rc::Rc;

use super::files::Files;
use super::observations::{Seen, Site};
use super::recording::{Recorded, track};
use crate::Error;
use crate::outcome::{RecordingSummary, RowCount, SitesAre};
use crate::scene::{OutsideWindow, Recording, TimeGrid, rounded};

/// Name and text of a recording's file, which a key names.
///
/// # Errors
/// [`Error::Scene`] where none is named, or it cannot be read.
pub(super) fn text_of(files: &Files, key: &str, name: &Option<String>) -> Result<(String, Rc<str>), Error> {
    match name {
        Some(name) => files.text(key, name),
        None => {
            let message = "no file is named: give one with --set observations.file=…";
            Err(files.scene.invalid("observations", message))
        }
    }
}

/// What a recording holds: of which sites, where its rows went, its times \[s\], and every site's rows.
pub(super) fn summary(
    sites_are: SitesAre,
    rows: RowCount,
    (times, clock): (&[f64], &Clock),
    sites: &[Site],
    recorded: &[Recorded],
) -> RecordingSummary {
    let Clock { recording, grid, .. } = clock;
    RecordingSummary {
        sites_are,
        rows,
        span: [
            times.iter().copied().fold(f64::INFINITY, f64::min),
            times.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        ],
        window: [grid.start, grid.time(grid.steps)].map(|t| t + recording.time_zero),
        tracks: sites.iter().enumerate().map(|(i, s)| track((&s.label, s.quantity), i, recorded)).collect(),
        neighbours: Vec::new(),
    }
}

/// What of a recording is not used.
#[derive(Default)]
pub(super) struct LeftOut {
    pub(super) followed: usize,
    pub(super) ignored: usize,
    pub(super) before: usize,
    pub(super) after: usize,
    pub(super) repeated: usize,
    pub(super) refused: usize,
    pub(super) impossible: Vec<String>,
}

impl LeftOut {
    /// Where all rows went, with what is left of them.
    pub(super) fn count(
        &self,
        all: usize,
        seen: &[Seen],
        withheld: impl Fn(usize) -> bool,
        grid: TimeGrid,
    ) -> RowCount {
        let mut rows = RowCount {
            all,
            outside: self.before + self.after,
            refused: self.refused,
            repeated: self.repeated,
            ignored: self.followed + self.ignored,
            ..RowCount::default()
        };
        for s in seen {
            let part = if s.values.iter().all(Option::is_none) {
                &mut rows.empty
            } else if s.at() > grid.steps as f64 {
                &mut rows.forecast
            } else if withheld(s.site) {
                &mut rows.withheld
            } else {
                &mut rows.used
            };
            *part += 1;
        }
        rows
    }

    pub(super) fn into_texts(self) -> Vec<String> {
        let counted = [
            (self.followed, "rows of markers that move a support"),
            (self.ignored, "rows of ignored markers"),
            (self.before, "rows before the window"),
            (self.after, "rows after the window and its forecast"),
            (
                self.repeated,
                "rows that repeat time, place and values of another: one sighting is counted once",
            ),
        ];
        let texts = counted.into_iter().filter(|(count, _)| *count > 0);
        texts.map(|(count, what)| format!("{count} {what}")).chain(self.impossible).collect()
    }
}

/// The clock of a recording beside that of a window.
#[derive(Clone, Copy)]
pub(super) struct Clock<'a> {
    pub(super) recording: &'a Recording,
    pub(super) grid: TimeGrid,
    /// What is known of the recording's offset against the model \[s\]: added to the times of its rows. A row
    /// of the window that it takes out of there is left out.
    pub(super) shift: f64,
}

impl Clock<'_> {
    /// Where a row is in the window, in steps, by the time that is written and half a unit of its last digit;
    /// `None` where it is left out.
    ///
    /// Times are known to the digits they are written with. One that is a step's to within them is that step:
    /// a recording at 240 Hz written to milliseconds would else fall between two windows of a sequence. Where
    /// the digits are coarser than a quarter of a step, they are taken as they stand.
    ///
    /// # Errors
    /// What is wrong with a time that is outside, where that is an error.
    pub(super) fn place(
        &self,
        written: f64,
        rounding: f64,
        left: &mut LeftOut,
    ) -> Result<Option<f64>, String> {
        let Clock { recording, grid, shift } = *self;
        // Rounding of the arithmetic on top of that of the file.
        let digits = Some(rounding / grid.step).filter(|d| *d <= 0.25).unwrap_or(0.0) + 1e-6;
        // A time within a thousandth of a step of an end of the window was meant to be that end.
        let slack = digits.max(1e-3);
        let at = (written - recording.time_zero - grid.start) / grid.step;
        let beyond = at > grid.steps as f64 + slack;
        if at < -slack || beyond {
            if recording.outside_window == OutsideWindow::Error {
                let (from, to) =
                    (grid.start + recording.time_zero, grid.time(grid.steps) + recording.time_zero);
                let in_milliseconds = written > 20.0 * to && (from..=to).contains(&(1e-3 * written));
                let unit = if in_milliseconds { " Milliseconds? Name the column time_ms." } else { "" };
                let [written, from, to] = [written, from, to].map(rounded);
                return Err(format!(
                    "time_s = {written} is outside the window ({from} to {to} s): outside_window = \"skip\" \
                     leaves such rows out, or to the forecast.{unit}"
                ));
            }
            if !beyond || at > grid.last_step() as f64 + slack {
                *(if beyond { &mut left.after } else { &mut left.before }) += 1;
                return Ok(None);
            }
        }
        let at = at.clamp(0.0, if beyond { f64::INFINITY } else { grid.steps as f64 });
        let at = if (at - at.round()).abs() <= digits { at.round() } else { at };
        if shift == 0.0 {
            return Ok(Some(at));
        }
        let (at, last) = (at + shift / grid.step, if beyond { grid.last_step() } else { grid.steps });
        let outside = if at < 0.0 { Some(&mut left.before) } else { None };
        let outside = if at > last as f64 { Some(&mut left.after) } else { outside };
        Ok(match outside {
            Some(count) => {
                *count += 1;
                None
            }
            None => Some(at),
        })
    }
}
