//! A recording of markers, whatever file it came from.

use crate::Error;

/// What a file does not say, or says otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Options {
    /// The axis that points upwards; it becomes z. `None`: as the file says, else z.
    pub up: Option<Up>,
    /// The unit of its coordinates. `None`: as the file says.
    pub unit: Option<Unit>,
}

/// The axis of a file that points upwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Up {
    /// x.
    X,
    /// y.
    Y,
    /// z.
    Z,
}

impl Up {
    /// (x, y, z) with that axis turned to z.
    pub fn turned(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Up::X => [y, z, x],
            // A quarter turn about x, which stays.
            Up::Y => [x, -z, y],
            Up::Z => [x, y, z],
        }
    }
}

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// m.
    Metre,
    /// cm.
    Centimetre,
    /// mm.
    Millimetre,
}

impl Unit {
    /// The unit that a file names.
    pub fn named(name: &str) -> Option<Unit> {
        Some(match name.trim().to_ascii_lowercase().as_str() {
            "m" | "meters" | "metres" | "meter" => Unit::Metre,
            "cm" | "centimeters" | "centimetres" => Unit::Centimetre,
            "mm" | "millimeters" | "millimetres" => Unit::Millimetre,
            _ => return None,
        })
    }

    fn per_metre(self) -> f64 {
        match self {
            Unit::Metre => 1.0,
            Unit::Centimetre => 100.0,
            Unit::Millimetre => 1000.0,
        }
    }
}

/// Markers as they were seen, in metres, z upwards.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// What kind of file it was.
    pub kind: &'static str,
    /// Its markers, in the order of the file.
    pub tracks: Vec<Track>,
    /// What there is to say of it.
    pub remarks: Vec<String>,
}

/// What was seen of one marker.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Its name.
    pub name: String,
    /// Frame, time \[s\] and place \[m\] where it was seen, in the order of time.
    pub rows: Vec<(usize, f64, [f64; 3])>,
}

impl Track {
    /// Frames between its first and last row in which it was not seen: how often, and how many at most.
    pub fn gaps(&self) -> (usize, usize) {
        let lost = self.rows.windows(2).map(|w| w[1].0 - w[0].0 - 1).filter(|lost| *lost > 0);
        lost.fold((0, 0), |(count, most), lost| (count + 1, most.max(lost)))
    }
}

impl Recording {
    /// The table `time_s,marker,x_m,y_m,z_m`, in the order of time, to a nanometre.
    pub fn to_csv(&self) -> String {
        let mut rows: Vec<(usize, usize, f64, [f64; 3])> = Vec::new();
        for (i, track) in self.tracks.iter().enumerate() {
            rows.extend(track.rows.iter().map(|&(frame, time, place)| (frame, i, time, place)));
        }
        rows.sort_by_key(|row| (row.0, row.1));
        let mut text = String::from("time_s,marker,x_m,y_m,z_m\n");
        for (_, marker, time, [x, y, z]) in rows {
            let name = quoted(&self.tracks[marker].name);
            let [time, x, y, z] = [time, x, y, z].map(rounded);
            text.push_str(&format!("{time},{name},{x},{y},{z}\n"));
        }
        text
    }
}

/// To 1e-9; −0 is 0.
fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9 + 0.0
}

fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r', '#', ';']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_string()
    }
}

/// A recording in the making: frames of a file, its units and axes as they are there.
pub(super) struct Reader<'a> {
    file: &'a str,
    unit: Unit,
    up: Up,
    zeros: usize,
    recording: Recording,
}

impl<'a> Reader<'a> {
    /// With the unit and the axis that the file says, as far as it does.
    pub(super) fn new(
        file: &'a str,
        kind: &'static str,
        names: Vec<String>,
        (unit, up): (Option<Unit>, Option<Up>),
        options: &Options,
    ) -> Result<Self, Error> {
        let mut remarks = Vec::new();
        let Some(unit) = options.unit.or(unit) else {
            return Err(data(file, "it does not say the unit of its coordinates: give --unit mm, cm or m"));
        };
        if names.is_empty() {
            return Err(data(file, "it has no markers"));
        }
        let tracks: Vec<Track> =
            distinct(names, &mut remarks).into_iter().map(|name| Track { name, rows: Vec::new() }).collect();
        if options.up.is_none() && up.is_none() {
            let said = "the file does not say which axis points upwards: z is taken (--up y turns y to z)";
            remarks.push(said.into());
        }
        let up = options.up.or(up).unwrap_or(Up::Z);
        if up != Up::Z {
            let axes = if up == Up::Y { "(x, −z, y)" } else { "(y, z, x)" };
            remarks.push(format!("z upwards: (x, y, z) of the table are {axes} of the file"));
        }
        Ok(Reader { file, unit, up, zeros: 0, recording: Recording { kind, tracks, remarks } })
    }

    /// A marker that was seen; exactly (0, 0, 0) is one that was not.
    pub(super) fn seen(&mut self, marker: usize, frame: usize, time: f64, written: [f64; 3]) {
        if written == [0.0; 3] {
            self.zeros += 1;
            return;
        }
        let place = self.up.turned(written.map(|v| v / self.unit.per_metre()));
        self.recording.tracks[marker].rows.push((frame, time, place));
    }

    pub(super) fn remark(&mut self, text: String) {
        self.recording.remarks.push(text);
    }

    /// # Errors
    /// [`Error::Data`] where nothing was seen.
    pub(super) fn finish(mut self) -> Result<Recording, Error> {
        if self.zeros > 0 {
            let text = format!("{} places of exactly 0,0,0 are taken for lost markers", self.zeros);
            self.recording.remarks.push(text);
        }
        if self.recording.tracks.iter().all(|t| t.rows.is_empty()) {
            return Err(data(self.file, "no marker was seen in any frame"));
        }
        Ok(self.recording)
    }
}

/// Names that differ: later ones of the same name are numbered.
fn distinct(names: Vec<String>, remarks: &mut Vec<String>) -> Vec<String> {
    let mut all: Vec<String> = Vec::with_capacity(names.len());
    for name in names {
        let mut new = name.clone();
        let mut number = 2;
        while all.contains(&new) {
            new = format!("{name}-{number}");
            number += 1;
        }
        if new != name {
            remarks.push(format!("a further marker {name:?} is named {new:?}"));
        }
        all.push(new);
    }
    all
}

pub(super) fn data(file: &str, message: impl Into<String>) -> Error {
    Error::Data { place: file.to_string(), message: message.into() }
}

pub(super) fn at(file: &str, line: usize, message: impl Into<String>) -> Error {
    Error::Data { place: format!("{file}:{line}"), message: message.into() }
}
