//! What cameras saw of the markers of a rod: rows of pixels.

use std::collections::{HashMap, HashSet};

use super::csv::{Subject, Table};
use super::observations::{Seen, is_within};
use super::points::{About, Points};
use super::recorded_rows::{Clock, LeftOut};
use super::recording::Recorded;
use crate::Error;
use crate::scene::{Camera, Recording, UnreachableRows};

/// One row, in the recording's own time.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    /// Line of the file, from 1.
    line: usize,
    /// Time \[s\].
    time: f64,
    camera: String,
    subject: Subject,
    /// Arc length of a named marker, where the file has that too \[m\].
    arc_length: Option<f64>,
    /// u and v \[px\]; `None` was not observed.
    pixel: [Option<f64>; 2],
    /// Their standard deviation \[px\], if the file has it.
    sigma: Option<f64>,
}

/// Rows of a file, and half a unit of the last digit that its times are written with \[s\].
struct Rows {
    rows: Vec<Row>,
    time_rounding: f64,
}

/// What a file of pixels holds.
#[derive(Default)]
pub(super) struct Pixels {
    /// Camera and point of each site.
    pub(super) sites: Vec<(usize, usize)>,
    /// What was seen of them, their sites counted from 0.
    pub(super) seen: Vec<Seen>,
    /// Every row of a site.
    pub(super) recorded: Vec<Recorded>,
    /// The times of all rows \[s\].
    pub(super) times: Vec<f64>,
}

/// Reads rows with the header `time_s,camera,marker,u_px,v_px` or `time_s,camera,s_m,u_px,v_px`, optionally
/// `sigma_px`, and with names `s_m` too; columns in any order; of a shape at rest without `time_s`.
///
/// # Errors
/// [`Error::Data`] naming file and line.
fn rows(file: &str, text: &str, timed: bool) -> Result<Rows, Error> {
    let known = ["time_s", "camera", "marker", "s_m", "u_px", "v_px", "sigma_px"];
    let (known, expected) = match timed {
        true => (&known[..], "time_s,camera,marker,u_px,v_px or time_s,camera,s_m,u_px,v_px"),
        false => (&known[1..], "camera,marker,u_px,v_px or camera,s_m,u_px,v_px"),
    };
    let expected = format!("{expected}, optionally sigma_px");
    let mut table = Table::open(file, text, known, &expected)?;
    for name in known.iter().filter(|name| !["marker", "s_m", "sigma_px"].contains(name)) {
        table.require(name, &expected)?;
    }
    let by_marker = table.has("marker");
    if !(by_marker || table.has("s_m")) {
        return Err(table.bad(1, format!("the header has neither `s_m` nor `marker`; expected {expected}")));
    }
    let (mut rows, mut finest) = (Vec::new(), f64::INFINITY);
    while table.next()? {
        if timed {
            finest = finest.min(table.last_digit("time_s"));
        }
        let name = |column: &str| match table.cell(column) {
            "" => Err(table.bad(table.line(), format!("`{column}` is empty"))),
            name => Ok(name.to_string()),
        };
        let sigma = table.number("sigma_px")?;
        if let Some(sigma) = sigma.filter(|s| !(*s > 0.0)) {
            return Err(table.bad(table.line(), format!("`sigma_px` = {sigma} must be greater than 0")));
        }
        rows.push(Row {
            line: table.line(),
            time: if timed { table.needed("time_s")? } else { 0.0 },
            camera: name("camera")?,
            subject: match by_marker {
                true => Subject::Marker(name("marker")?),
                false => Subject::ArcLength(table.needed("s_m")?),
            },
            arc_length: if by_marker { table.number("s_m")? } else { None },
            pixel: [table.number("u_px")?, table.number("v_px")?],
            sigma,
        });
    }
    if rows.is_empty() {
        return Err(table.bad(1, "holds no observations"));
    }
    Ok(Rows { rows, time_rounding: if timed { 0.5 * finest } else { 0.0 } })
}

/// What a file of pixels saw, in the model's time.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub(super) fn recorded(
    (file, text): (&str, &str),
    timed: bool,
    clock: &Clock,
    points: &mut Points,
    left: &mut LeftOut,
) -> Result<Pixels, Error> {
    let recording = clock.recording;
    let bad = |line: usize, message: String| Error::Data { place: format!("{file}:{line}"), message };
    let Rows { rows, time_rounding } = rows(file, text, timed)?;
    let mut pixels = Pixels::default();
    let (mut site_of, mut known, mut outside) = (HashMap::new(), HashSet::new(), Vec::new());
    for row in &rows {
        pixels.times.push(row.time);
        let (index, camera) = camera_of(row, recording).map_err(|e| bad(row.line, e))?;
        let point = match points.about(&row.subject, row.arc_length).map_err(|e| bad(row.line, e))? {
            About::Point(point) => point,
            // a marker that moves a support is no unknown of the rod
            About::Followed | About::Ignored => {
                left.ignored += 1;
                continue;
            }
        };
        let sigma = row.sigma.or(camera.sigma).ok_or_else(|| {
            let remedy = "fill `sigma_px`, or give the camera's `sigma`";
            bad(row.line, format!("no standard deviation: {remedy}"))
        })?;
        let site = *site_of.entry((index, point)).or_insert_with(|| {
            pixels.sites.push((index, point));
            pixels.sites.len() - 1
        });
        let [u, v] = row.pixel;
        pixels.recorded.push(Recorded { time: row.time, site, position: [u, v, None], sigma });
        let at = clock.place(row.time, time_rounding, left).map_err(|e| bad(row.line, e))?;
        let Some(at) = at else { continue };
        if !known.insert((site, row.time.to_bits(), row.pixel.map(|v| v.map(f64::to_bits)))) {
            left.repeated += 1;
            continue;
        }
        if let Some(reason) = outside_of(row, camera, &points.all[point].label) {
            if recording.unreachable == UnreachableRows::Error {
                let remedy = "observations.unreachable = \"skip\" leaves such rows out";
                return Err(bad(row.line, format!("{reason} ({remedy})")));
            }
            outside.push((row.line, reason));
            continue;
        }
        let values = row.pixel.to_vec();
        pixels.seen.push(Seen { site, step: at.floor() as usize, weight: at.fract(), values, sigma });
    }
    if let Some((_, reason)) = outside.first() {
        let lines: Vec<String> = outside.iter().map(|(line, _)| line.to_string()).collect();
        left.refused += outside.len();
        left.impossible.push(format!("rows outside the image, in lines {}: {reason}", lines.join(", ")));
    }
    Ok(pixels)
}

fn camera_of<'a>(row: &Row, recording: &'a Recording) -> Result<(usize, &'a Camera), String> {
    let found = recording.cameras.iter().enumerate().find(|(_, camera)| camera.name == row.camera);
    found.ok_or_else(|| {
        let names: Vec<&str> = recording.cameras.iter().map(|camera| camera.name.as_str()).collect();
        format!("camera {:?} is none of [[observations.cameras]]: {}", row.camera, names.join(", "))
    })
}

/// What is wrong with a pixel outside its image.
fn outside_of(row: &Row, camera: &Camera, label: &str) -> Option<String> {
    let size = camera.image?;
    let beyond = |i: usize| row.pixel[i].is_some_and(|p| !is_within(p, size[i]));
    (beyond(0) || beyond(1)).then(|| {
        let [u, v] = row.pixel.map(|p| p.map_or("?".into(), |p| p.to_string()));
        let fits = |u: Option<f64>, size: f64| u.is_none_or(|u| is_within(u, size));
        let exchanged = match fits(row.pixel[0], size[1]) && fits(row.pixel[1], size[0]) {
            true => "; are u and v, or width and height, exchanged?",
            false => "; another camera, or another origin of pixels?",
        };
        format!(
            "{label} is at ({u}, {v}) px, outside the image of camera {}, {} × {} px{exchanged}",
            row.camera, size[0], size[1]
        )
    })
}
