//! C3D: a binary file of blocks of 512 bytes (header, parameters, frames), as <https://www.c3d.org>
//! describes.
//!
//! Read are markers in files of Intel processors, in either format of numbers. The time of a frame is
//! (frame − 1)/rate. A marker whose residual is negative was not seen.

use std::collections::HashMap;

use super::recording::{Options, Reader, Recording, Unit, Up, data};
use crate::Error;

const BLOCK: usize = 512;

pub(super) fn is_c3d(bytes: &[u8]) -> bool {
    // The second byte is the key; text has no such beginning but by chance ("?P"), and no zero bytes.
    bytes.len() >= BLOCK && bytes[1] == 0x50 && bytes[..BLOCK].contains(&0)
}

/// Numbers of the file, in Intel's order; nothing beyond its end.
struct Bytes<'a> {
    file: &'a str,
    all: &'a [u8],
}

impl Bytes<'_> {
    fn array<const N: usize>(&self, at: usize) -> Result<[u8; N], Error> {
        let slice = at.checked_add(N).and_then(|end| self.all.get(at..end));
        slice.and_then(|s| s.try_into().ok()).ok_or_else(|| {
            let message = format!("it ends at byte {} where byte {at} should be read", self.all.len());
            data(self.file, message)
        })
    }

    fn byte(&self, at: usize) -> Result<u8, Error> {
        Ok(self.array::<1>(at)?[0])
    }

    fn word(&self, at: usize) -> Result<u16, Error> {
        Ok(u16::from_le_bytes(self.array(at)?))
    }

    fn real(&self, at: usize) -> Result<f64, Error> {
        Ok(f32::from_le_bytes(self.array(at)?).into())
    }

    fn text(&self, at: usize, length: usize) -> Result<String, Error> {
        let text: Result<String, Error> = (at..at + length).map(|i| Ok(self.byte(i)? as char)).collect();
        Ok(text?.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_string())
    }
}

/// A parameter: where its values are.
#[derive(Clone)]
struct Parameter {
    /// Bytes of a value; −1 for characters.
    size: i8,
    dimensions: Vec<usize>,
    at: usize,
}

struct Parameters<'a> {
    bytes: &'a Bytes<'a>,
    all: HashMap<(i8, String), Parameter>,
    groups: HashMap<String, i8>,
}

impl<'a> Parameters<'a> {
    fn read(bytes: &'a Bytes<'a>, start: usize) -> Result<Self, Error> {
        match bytes.byte(start + 3)? {
            84 => {}
            85 => return Err(data(bytes.file, "numbers of a DEC computer: save it in Intel format")),
            86 => return Err(data(bytes.file, "numbers of a MIPS computer: save it in Intel format")),
            other => return Err(data(bytes.file, format!("processor {other} in its parameters is none"))),
        }
        let mut all = HashMap::new();
        let mut groups = HashMap::new();
        let mut at = start + 4;
        loop {
            let length = (bytes.byte(at)? as i8).unsigned_abs() as usize;
            if length == 0 {
                break;
            }
            let id = bytes.byte(at + 1)? as i8;
            let name = bytes.text(at + 2, length)?.to_ascii_uppercase();
            let next_at = at + 2 + length;
            let next = bytes.word(next_at)? as usize;
            if id < 0 {
                groups.insert(name, id);
            } else {
                let size = bytes.byte(next_at + 2)? as i8;
                let count = bytes.byte(next_at + 3)? as usize;
                let dimensions: Result<Vec<usize>, Error> =
                    (0..count).map(|i| Ok(bytes.byte(next_at + 4 + i)? as usize)).collect();
                let parameter = Parameter { size, dimensions: dimensions?, at: next_at + 4 + count };
                all.insert((id, name), parameter);
            }
            if next == 0 {
                break;
            }
            at = next_at + next;
        }
        Ok(Parameters { bytes, all, groups })
    }

    fn find(&self, group: &str, name: &str) -> Option<&Parameter> {
        let id = self.groups.get(group)?.checked_neg()?;
        self.all.get(&(id, name.to_string()))
    }

    fn integers(&self, group: &str, name: &str) -> Result<Vec<usize>, Error> {
        let Some(p) = self.find(group, name) else { return Ok(Vec::new()) };
        let count: usize = p.dimensions.iter().product();
        match p.size {
            1 => (0..count).map(|i| Ok(self.bytes.byte(p.at + i)? as usize)).collect(),
            2 => (0..count).map(|i| Ok(self.bytes.word(p.at + 2 * i)? as usize)).collect(),
            4 => (0..count).map(|i| Ok(self.bytes.real(p.at + 4 * i)?.max(0.0) as usize)).collect(),
            _ => Ok(Vec::new()),
        }
    }

    fn real(&self, group: &str, name: &str) -> Result<Option<f64>, Error> {
        match self.find(group, name).filter(|p| p.size == 4) {
            Some(p) => Ok(Some(self.bytes.real(p.at)?)),
            None => Ok(None),
        }
    }

    fn texts(&self, group: &str, name: &str) -> Result<Vec<String>, Error> {
        let Some(p) = self.find(group, name).filter(|p| p.size == -1) else { return Ok(Vec::new()) };
        let (length, count) = match p.dimensions[..] {
            [] => (1, 1),
            [length] => (length, 1),
            [length, ref others @ ..] => (length, others.iter().product()),
        };
        (0..count).map(|i| self.bytes.text(p.at + i * length, length)).collect()
    }
}

pub(super) fn read(file: &str, all: &[u8], options: &Options) -> Result<Recording, Error> {
    let bytes = Bytes { file, all };
    let bad = |message: String| data(file, message);
    let block = |number: usize| BLOCK * number.saturating_sub(1);
    let parameters = Parameters::read(&bytes, block(bytes.byte(0)? as usize))?;
    let used = parameters.integers("POINT", "USED")?.first().copied();
    let points = used.map_or_else(|| bytes.word(2).map(usize::from), Ok)?;
    let scale = parameters.real("POINT", "SCALE")?.map_or_else(|| bytes.real(12), Ok)?;
    let rate = parameters.real("POINT", "RATE")?.map_or_else(|| bytes.real(20), Ok)?;
    if !(rate > 0.0 && rate.is_finite()) {
        return Err(bad(format!("POINT:RATE = {rate} Hz: a rate is greater than 0")));
    }
    if !(scale != 0.0 && scale.is_finite()) {
        return Err(bad(format!("POINT:SCALE = {scale} is impossible")));
    }
    let unit = match parameters.texts("POINT", "UNITS")?.into_iter().next().filter(|u| !u.is_empty()) {
        Some(name) => match Unit::named(&name) {
            None if options.unit.is_none() => {
                return Err(bad(format!("POINT:UNITS = {name:?} is none of mm, cm, m: give --unit")));
            }
            unit => unit,
        },
        None => None,
    };
    let up = match parameters.texts("POINT", "Y_SCREEN")?.first().map(String::as_str) {
        Some("+X") => Some(Up::X),
        Some("+Y") => Some(Up::Y),
        Some("+Z") => Some(Up::Z),
        _ => None,
    };
    let long = |name: &str| {
        let words = parameters.integers("TRIAL", name)?;
        Ok::<_, Error>(match words[..] {
            [low, high, ..] => Some(low + (high << 16)),
            _ => None,
        })
    };
    let first = long("ACTUAL_START_FIELD")?.map_or_else(|| bytes.word(6).map(usize::from), Ok)?;
    let last = long("ACTUAL_END_FIELD")?.map_or_else(|| bytes.word(8).map(usize::from), Ok)?;
    if last < first || first == 0 {
        return Err(bad(format!("its frames are {first} to {last}: that is none")));
    }
    let is_real = scale < 0.0;
    let size = if is_real { 4 } else { 2 };
    let analog = bytes.word(4)? as usize;
    let frame_bytes = size * (4 * points + analog);
    let data_start = parameters.integers("POINT", "DATA_START")?.first().copied();
    let start = block(data_start.map_or_else(|| bytes.word(16).map(usize::from), Ok)?);
    let frames = last - first + 1;
    let there = all.len().saturating_sub(start) / frame_bytes.max(1);
    if there < frames {
        return Err(bad(format!(
            "its header has frames {first} to {last}, and the file ends after {there} of these {frames}"
        )));
    }
    let mut reader = Reader::new(file, "C3D", names(&parameters, points)?, (unit, up), options)?;
    for k in 0..frames {
        for marker in 0..points {
            let at = start + k * frame_bytes + 4 * size * marker;
            let seen = if is_real {
                let place = [bytes.real(at)?, bytes.real(at + 4)?, bytes.real(at + 8)?];
                let residual = bytes.real(at + 12)?;
                (residual >= 0.0 && place.iter().all(|v| v.is_finite())).then_some(place)
            } else {
                let integer = |i: usize| Ok::<f64, Error>(f64::from(bytes.word(at + 2 * i)? as i16) * scale);
                let place = [integer(0)?, integer(1)?, integer(2)?];
                (bytes.word(at + 6)? as i16 >= 0).then_some(place)
            };
            if let Some(place) = seen {
                let frame = first + k;
                reader.seen(marker, frame, (frame - 1) as f64 / rate, place);
            }
        }
    }
    reader.finish()
}

/// Names of the markers: those of POINT:LABELS, LABELS2, …; a number where there is none.
fn names(parameters: &Parameters, points: usize) -> Result<Vec<String>, Error> {
    let mut labels = parameters.texts("POINT", "LABELS")?;
    for further in 2..=99 {
        if labels.len() >= points {
            break;
        }
        labels.extend(parameters.texts("POINT", &format!("LABELS{further}"))?);
    }
    labels.resize(points, String::new());
    let name = |(i, label): (usize, String)| if label.is_empty() { format!("{i}") } else { label };
    Ok(labels.into_iter().enumerate().map(name).collect())
}
