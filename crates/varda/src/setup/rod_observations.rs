//! Observations of a rod: points on it at times, in the axes of a recording.

use std::collections::HashMap;
use std::rc::Rc;

use varda_rod::{Marker, Markers, Matrix3, Vector3};

use super::csv::{self, ObservedRow, Subject};
use super::files::Files;
use super::observations::{Draws, MakeOperator, Observed, ObservedSpace, Seen, Site};
use super::rod::RodSystem;
use crate::Error;
use crate::scene::{Frame, OutsideWindow, Recording, Synthetic, TimeGrid, Use};

/// A site and its place on the rod.
#[derive(Debug, Clone)]
struct Placed {
    label: String,
    marker: Marker,
    withheld: bool,
}

impl Placed {
    fn at_arc_length(s: f64) -> Self {
        Placed { label: format!("s = {s} m"), marker: Marker { s, offset: [0.0; 3].into() }, withheld: false }
    }
}

/// Points at the arc lengths that a twin experiment observes; their values are not yet drawn.
pub(crate) fn synthetic(
    files: &Files,
    keys: &Synthetic,
    rod: &RodSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let sites = keys.places.iter().map(|s| Placed::at_arc_length(*s)).collect();
    let steps = files.scene.checked(keys.observed_steps(grid.steps))?;
    let sigma = files.scene.checked(keys.sigma())?.of(rod.length());
    let draws = Draws { steps, sigma };
    Ok(observed(rod, sites, Frame::default().rotation_rows(), Vec::new(), Some(draws), Vec::new()))
}

/// What a recording saw, in the model's time.
///
/// # Errors
/// [`Error::Data`] or [`Error::Scene`] naming the line or the key.
pub(crate) fn recorded(
    files: &Files,
    recording: &Recording,
    rod: &RodSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let Some(name) = &recording.file else {
        let message = "no file is named: give one with --set observations.file=…";
        return Err(files.scene.invalid("observations", message));
    };
    let (label, text) = files.text("observations.file", name)?;
    let rows = csv::observations(&label, &text)?;
    let bad =
        |row: &ObservedRow, message: String| Error::Data { place: format!("{label}:{}", row.line), message };
    let length = rod.length();
    let mut sites: Vec<Placed> = recording
        .markers
        .iter()
        .map(|m| Placed {
            label: format!("marker {}", m.name),
            marker: Marker { s: m.arc_length, offset: m.offset.into() },
            withheld: m.used == Use::Withhold,
        })
        .collect();
    // −0 is 0.
    let bits = |s: f64| (s + 0.0).to_bits();
    let mut site_of = HashMap::new();
    for (i, site) in sites.iter().enumerate() {
        site_of.entry(bits(site.marker.s)).or_insert(i);
    }
    let rotation = recording.frame.rotation_rows();
    let shift: [f64; 3] =
        std::array::from_fn(|c| (0..3).map(|j| rotation[j][c] * recording.frame.translation[j]).sum());
    let (mut before, mut after, mut ignored) = (0, 0, 0);
    let mut seen = Vec::new();
    for row in &rows {
        let site = match &row.subject {
            Subject::Marker(name) if recording.ignore.contains(name) => {
                ignored += 1;
                continue;
            }
            Subject::Marker(name) => {
                recording.markers.iter().position(|m| m.name == *name).ok_or_else(|| {
                    let remedy = "add it to [[observations.markers]] or to observations.ignore";
                    bad(row, format!("marker {name:?} has no place: {remedy}"))
                })?
            }
            Subject::ArcLength(s) => {
                if !(*s >= 0.0 && *s <= length * (1.0 + 1e-9)) {
                    return Err(bad(row, format!("s_m = {s} is off the rod (0 to {length} m)")));
                }
                *site_of.entry(bits(*s)).or_insert_with(|| {
                    sites.push(Placed::at_arc_length(*s));
                    sites.len() - 1
                })
            }
        };
        let time = row.time - recording.time_zero;
        // A time within a thousandth of a step of an end of the window was meant to be that end.
        let slack = 1e-3;
        let at = (time - grid.start) / grid.step;
        let beyond = at > grid.steps as f64 + slack;
        if at < -slack || beyond {
            if recording.outside_window == OutsideWindow::Error {
                let (from, to) =
                    (grid.start + recording.time_zero, grid.time(grid.steps) + recording.time_zero);
                let message = format!("time_s = {} is outside the window ({from} to {to} s)", row.time);
                return Err(bad(row, message));
            }
            if !beyond || at > grid.last_step() as f64 + slack {
                *(if beyond { &mut after } else { &mut before }) += 1;
                continue;
            }
        }
        let at = at.clamp(0.0, if beyond { f64::INFINITY } else { grid.steps as f64 });
        // Closer to a step than rounding of the file's times can tell.
        let at = if (at - at.round()).abs() < 1e-6 { at.round() } else { at };
        let sigma = row.sigma.or(recording.sigma).ok_or_else(|| {
            bad(row, "no standard deviation: fill `sigma_m`, or give observations.sigma".to_string())
        })?;
        let values = (0..3).map(|c| row.position[c].map(|v| v + shift[c])).collect();
        seen.push(Seen { site, step: at.floor() as usize, weight: at.fract(), values, sigma });
    }
    let mut left_out = Vec::new();
    for (count, what) in [
        (ignored, "rows of ignored markers"),
        (before, "rows before the window"),
        (after, "rows after the window and its forecast"),
    ] {
        if count > 0 {
            left_out.push(format!("{count} {what}"));
        }
    }
    Ok(observed(rod, sites, rotation, seen, None, left_out))
}

fn observed(
    rod: &RodSystem,
    sites: Vec<Placed>,
    rotation: [[f64; 3]; 3],
    seen: Vec<Seen>,
    draws: Option<Draws>,
    left_out: Vec<String>,
) -> Observed {
    let markers: Rc<[Marker]> = sites.iter().map(|s| s.marker).collect();
    let operator = |rotation: [[f64; 3]; 3]| -> MakeOperator {
        let (markers, parts) = (Rc::clone(&markers), rod.parts.clone());
        // values are those of the recording turned into its axes but not displaced: the origin is the model's
        let axes = Matrix3::from(rotation).transpose();
        let seen = move || Markers::new(&parts.dynamics()?, &markers)?.in_axes(axes, Vector3::zeros());
        Box::new(move || Ok(Box::new(seen()?)))
    };
    let site = |(i, site): (usize, Placed)| Site {
        label: site.label,
        rows: 3 * i..3 * i + 3,
        anchors: [0, 1, 2].map(|c| rod.nearest_position(site.marker.s) + c).to_vec(),
        withheld: site.withheld,
    };
    Observed {
        space: Some(ObservedSpace {
            arc_lengths: markers.iter().map(|m| m.s).collect(),
            rotation,
            make_places: operator(Frame::default().rotation_rows()),
        }),
        make_operator: operator(rotation),
        sites: sites.into_iter().enumerate().map(site).collect(),
        seen,
        left_out,
        draws,
    }
}

impl Frame {
    /// The rows of R: as given, or Rodrigues' rotation about `axis`; the identity without either.
    pub fn rotation_rows(&self) -> [[f64; 3]; 3] {
        if let Some(rows) = self.rotation {
            return rows;
        }
        let (Some(axis), Some(angle)) = (self.axis, self.angle) else {
            return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        };
        let norm = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
        let [x, y, z] = axis.map(|a| a / norm);
        let (s, c) = angle.sin_cos();
        let v = 1.0 - c;
        [
            [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
            [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
            [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
        ]
    }
}
