//! TRC: tables of Motion Analysis and OpenSim.
//!
//! Five lines of header (kind; names of numbers, numbers; names of markers, one above its three columns;
//! names of columns), perhaps an empty line, then frame, time and coordinates, parted by tabs.

use super::recording::{Options, Reader, Recording, Unit};
use super::text::Lines;
use crate::Error;

pub(super) fn read(file: &str, text: &str, options: &Options) -> Result<Recording, Error> {
    let lines = Lines::new(file, text, '\t');
    let (keys, values) = (lines.cells(1, "names of numbers")?, lines.cells(2, "numbers")?);
    let value = |key: &str| keys.iter().position(|k| *k == key).and_then(|i| values.get(i)).copied();
    let unit = match value("Units") {
        Some(name) if !name.is_empty() => match Unit::named(name) {
            None if options.unit.is_none() => {
                return Err(lines.bad(2, format!("Units = {name:?} is none of mm, cm, m: give --unit")));
            }
            unit => unit,
        },
        _ => None,
    };
    let header = lines.cells(3, "names of markers")?;
    if !header.first().is_some_and(|c| c.starts_with("Frame")) {
        return Err(lines.bad(3, "expected `Frame#`, `Time` and the names of markers"));
    }
    let markers: Vec<(usize, String)> = header
        .iter()
        .enumerate()
        .skip(2)
        .filter(|(_, name)| !name.is_empty())
        .map(|(column, name)| (column, name.to_string()))
        .collect();
    if let Some(pair) = markers.windows(2).find(|w| w[1].0 - w[0].0 != 3) {
        let message = format!("marker {:?} does not stand three columns after {:?}", pair[1].1, pair[0].1);
        return Err(lines.bad(3, message));
    }
    let told = |key: &str| value(key).and_then(|v| v.parse::<usize>().ok());
    if let Some(count) = told("NumMarkers").filter(|count| *count != markers.len()) {
        let message = format!("NumMarkers = {count}, and the header names {} markers", markers.len());
        return Err(lines.bad(3, message));
    }
    let names = markers.iter().map(|m| m.1.clone()).collect();
    let mut reader = Reader::new(file, "TRC", names, (unit, None), options)?;
    let (mut frames, mut last) = (0, f64::NEG_INFINITY);
    for index in 5..lines.len() {
        if lines.is_blank(index) {
            continue;
        }
        let cells = lines.cells(index, "a row")?;
        let time = lines.number(index, cells.get(1).copied().unwrap_or(""), "Time")?;
        let Some(time) = time else { return Err(lines.bad(index, "a row without a time")) };
        if !(time > last) {
            return Err(lines.bad(index, format!("Time = {time} is not after the row before")));
        }
        last = time;
        let most = markers.last().map_or(2, |m| m.0 + 3);
        if cells.iter().skip(most).any(|c| !c.is_empty()) {
            return Err(lines.bad(index, format!("a row with more than {most} columns")));
        }
        for (i, (column, name)) in markers.iter().enumerate() {
            if let Some(place) = lines.place(index, &cells, *column, name)? {
                reader.seen(i, frames, time, place);
            }
        }
        frames += 1;
    }
    if let Some(count) = told("NumFrames").filter(|count| *count != frames) {
        reader.remark(format!("NumFrames = {count}, and the file has {frames} frames"));
    }
    reader.finish()
}
