//! CSV of Motive (OptiTrack).
//!
//! A line of names and values (`Format Version,…,Length Units,Meters,…`), then lines above the columns:
//! kinds (`Marker`, `Rigid Body`, …), names, numbers of identity, `Position` or `Rotation`, and `Frame`,
//! `Time (Seconds)`, `X`, …; then rows, blank where nothing was seen.

use super::recording::{Options, Reader, Recording, Unit};
use super::text::Lines;
use crate::Error;

pub(super) fn read(file: &str, text: &str, options: &Options) -> Result<Recording, Error> {
    let lines = Lines::new(file, text, ',');
    let first = lines.cells(0, "names and values")?;
    let value = |key: &str| first.chunks(2).find(|pair| pair[0] == key).and_then(|pair| pair.get(1)).copied();
    let unit = match value("Length Units") {
        Some(name) => match Unit::named(name) {
            None if options.unit.is_none() => {
                let message = format!("Length Units = {name:?} is none of Meters, Centimeters, Millimeters");
                return Err(lines.bad(0, message));
            }
            unit => unit,
        },
        None => None,
    };
    if let Some(space) = value("Coordinate Space").filter(|s| !s.eq_ignore_ascii_case("Global")) {
        let message = format!("Coordinate Space = {space:?}: export in the global space");
        return Err(lines.bad(0, message));
    }
    let is_columns = |i: usize| lines.line(i).is_some_and(|l| l.trim_start().starts_with("Frame"));
    let Some(columns) = (1..lines.len().min(12)).find(|i| is_columns(*i)) else {
        return Err(lines.bad(1, "no line `Frame,Time (Seconds),X,Y,Z,…` among the first twelve"));
    };
    let above: Vec<usize> = (1..columns).filter(|i| !lines.is_blank(*i)).collect();
    let find = |what: &str, is: &dyn Fn(&[&str]) -> bool| {
        let rows = above.iter().map(|i| (*i, lines.cells(*i, what)));
        let mut rows = rows.filter_map(|(i, cells)| Some((i, cells.ok()?)));
        rows.find(|(_, cells)| is(cells))
            .ok_or_else(|| lines.bad(columns, format!("no line of {what} above")))
    };
    let known = ["Marker", "Rigid Body", "Rigid Body Marker", "Bone", "Bone Marker"];
    let (at, kinds) =
        find("kinds (Marker, Rigid Body, …)", &|cells| cells.iter().skip(2).any(|c| known.contains(c)))?;
    let (_, what) = find("`Position`", &|cells| cells.contains(&"Position"))?;
    let names = match above.iter().find(|i| **i > at) {
        Some(line) => lines.cells(*line, "names")?,
        None => return Err(lines.bad(columns, "no line of names above")),
    };
    let axes = lines.cells(columns, "columns")?;
    let time_column = axes
        .iter()
        .position(|c| c.starts_with("Time"))
        .ok_or_else(|| lines.bad(columns, "no column `Time (Seconds)`"))?;
    let of_kind = |kind: &str| -> Vec<(usize, String)> {
        let starts = (2..axes.len()).filter(|i| {
            kinds.get(*i) == Some(&kind)
                && what.get(*i) == Some(&"Position")
                && axes[*i].eq_ignore_ascii_case("x")
        });
        starts.map(|i| (i, names.get(i).copied().unwrap_or("").to_string())).collect()
    };
    let mut markers = of_kind("Marker");
    let expected = markers.is_empty();
    if expected {
        markers = of_kind("Rigid Body Marker");
    }
    let named = markers.iter().map(|m| m.1.clone()).collect();
    let mut reader = Reader::new(file, "Motive CSV", named, (unit, None), options)?;
    if expected {
        let text = "there are no columns of kind Marker: those of Rigid Body Marker are taken, which Motive \
                    computes from the body's pose";
        reader.remark(text.into());
    }
    let mut last = f64::NEG_INFINITY;
    for (frame, index) in (columns + 1..lines.len()).filter(|i| !lines.is_blank(*i)).enumerate() {
        let cells = lines.cells(index, "a row")?;
        let time = lines.number(index, cells.get(time_column).copied().unwrap_or(""), "Time (Seconds)")?;
        let Some(time) = time else { return Err(lines.bad(index, "a row without a time")) };
        if !(time > last) {
            return Err(lines.bad(index, format!("Time (Seconds) = {time} is not after the row before")));
        }
        last = time;
        if cells.iter().skip(axes.len()).any(|c| !c.is_empty()) {
            return Err(lines.bad(index, format!("a row with more than {} columns", axes.len())));
        }
        for (i, (column, name)) in markers.iter().enumerate() {
            if let Some(place) = lines.place(index, &cells, *column, name)? {
                reader.seen(i, frame, time, place);
            }
        }
    }
    reader.finish()
}
