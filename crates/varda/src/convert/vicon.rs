//! CSV of Nexus (Vicon).
//!
//! Sections with a title; that of markers is `Trajectories`: the title, the rate \[Hz\], names of markers,
//! each
//! above its first column, `Frame,Sub Frame,X,Y,Z,…`, units, and rows until an empty line. Frames count
//! from 1: the time of a row is (frame − 1)/rate.

use super::recording::{Options, Reader, Recording, Unit};
use super::text::Lines;
use crate::Error;

pub(super) fn is_vicon(text: &str) -> bool {
    text.lines().any(is_title)
}

fn is_title(line: &str) -> bool {
    line.trim_end_matches([',', ';', '\t', ' ', '"']).trim_start_matches('"') == "Trajectories"
}

pub(super) fn read(file: &str, text: &str, options: &Options) -> Result<Recording, Error> {
    let title = text.lines().position(is_title).unwrap_or(0);
    let columns = text.lines().nth(title + 3).unwrap_or("");
    let separator = if columns.contains('\t') { '\t' } else { ',' };
    let lines = Lines::new(file, text, separator);
    let rate = lines.cells(title + 1, "the rate")?;
    let rate = match lines.number(title + 1, rate.first().copied().unwrap_or(""), "rate")? {
        Some(rate) if rate > 0.0 => rate,
        _ => return Err(lines.bad(title + 1, "the rate below `Trajectories` is missing")),
    };
    let names = lines.cells(title + 2, "names of markers")?;
    let axes = lines.cells(title + 3, "`Frame,Sub Frame,X,Y,Z`")?;
    if axes.first() != Some(&"Frame") {
        return Err(lines.bad(title + 3, "expected `Frame,Sub Frame,X,Y,Z,…`"));
    }
    let units = lines.cells(title + 4, "units")?;
    let is_place =
        |i: usize| ["X", "Y", "Z"].iter().enumerate().all(|(c, axis)| axes.get(i + c) == Some(axis));
    let markers: Vec<(usize, String)> = names
        .iter()
        .enumerate()
        .filter(|(column, name)| !name.is_empty() && is_place(*column))
        .map(|(column, name)| (column, name.to_string()))
        .collect();
    let written: Vec<&str> = markers.iter().filter_map(|m| units.get(m.0)).copied().collect();
    let unit = match written.first() {
        Some(name) if written.iter().all(|unit| unit == name) && !name.is_empty() => {
            match Unit::named(name) {
                None if options.unit.is_none() => {
                    return Err(lines.bad(title + 4, format!("{name:?} is none of mm, cm, m: give --unit")));
                }
                unit => unit,
            }
        }
        Some(_) if options.unit.is_none() && written.iter().any(|unit| !unit.is_empty()) => {
            return Err(lines.bad(title + 4, "markers in different units"));
        }
        _ => None,
    };
    let named = markers.iter().map(|m| m.1.clone()).collect();
    let mut reader = Reader::new(file, "Vicon CSV", named, (unit, None), options)?;
    let mut last = None;
    for index in title + 5..lines.len() {
        if lines.is_blank(index) {
            break;
        }
        let cells = lines.cells(index, "a row")?;
        let Some(frame) = cells[0].parse::<usize>().ok().filter(|frame| *frame > 0) else {
            return Err(lines.bad(index, format!("Frame = {:?} is not a number of a frame", cells[0])));
        };
        if last.is_some_and(|last| frame <= last) {
            return Err(lines.bad(index, format!("Frame = {frame} is not after the row before")));
        }
        last = Some(frame);
        if cells.iter().skip(axes.len()).any(|c| !c.is_empty()) {
            return Err(lines.bad(index, format!("a row with more than {} columns", axes.len())));
        }
        for (i, (column, name)) in markers.iter().enumerate() {
            if let Some(place) = lines.place(index, &cells, *column, name)? {
                reader.seen(i, frame, (frame - 1) as f64 / rate, place);
            }
        }
    }
    reader.finish()
}
