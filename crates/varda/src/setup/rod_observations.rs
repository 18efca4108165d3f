//! Observations of a rod: points on it at times, in the axes of a recording.

use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use varda_rod::{Marker, Markers, Matrix3, Vector3};

use super::continuity::{self, Fastest, speed_of_supports};
use super::csv::{self, Subject};
use super::files::Files;
use super::observations::{Draws, MakeOperator, Observed, ObservedSpace, Seen, Site};
use super::reachable::{Held, Reach, Sighting};
use super::recorded_rows::{Clock, LeftOut, summary, text_of};
use super::recording::Recorded;
use super::rod::RodSystem;
use super::rod_model::RodParts;
use super::seen_with::with_constants;
use crate::Error;
use crate::outcome::{Neighbours, RecordingSummary, SitesAre};
use crate::scene::{
    Frame, Method, Model, PriorSpread, Recording, Synthetic, TimeGrid, Unknown, UnreachableRows, Use, rounded,
};

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

    fn reach(&self) -> Reach {
        Reach { arc_length: self.marker.s, offset: self.marker.offset.norm() }
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

/// Nothing observed, for a forward run.
pub(crate) fn none(rod: &RodSystem) -> Observed {
    observed(rod, Vec::new(), Frame::default().rotation_rows(), Vec::new(), None, Vec::new())
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
    let (label, text) = text_of(files, recording)?;
    let rows = match files.scene.scene.algorithm.method {
        Method::Static => csv::shape(&label, &text)?,
        _ => csv::observations(&label, &text)?,
    };
    let bad = |line: usize, message: String| Error::Data { place: format!("{label}:{line}"), message };
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
    let on_the_rod = |line: usize, s: f64| match s >= 0.0 && s <= length * (1.0 + 1e-9) {
        true => Ok(()),
        false => Err(bad(line, format!("s_m = {} is off the rod (0 to {} m)", rounded(s), rounded(length)))),
    };
    // markers whose places the file has
    let mut placed: HashMap<String, usize> = HashMap::new();
    let mut site_of = HashMap::new();
    for (i, site) in sites.iter().enumerate() {
        site_of.entry(bits(site.marker.s)).or_insert(i);
    }
    let rotation = recording.frame.rotation_rows();
    let shift: [f64; 3] =
        std::array::from_fn(|c| (0..3).map(|j| rotation[j][c] * recording.frame.translation[j]).sum());
    let followed: HashSet<&str> = match &files.scene.scene.model {
        Model::Rod(model) => model.followed_markers().collect(),
        _ => HashSet::new(),
    };
    let clock = Clock { recording, grid, shift: files.scene.adjusted.clock };
    let run = [grid.start, grid.time(grid.last_step())];
    let (rows_may_be, late) = unknown_errors(files, rod, run)?;
    let mut left = LeftOut::default();
    let mut seen = Vec::new();
    let mut sightings = Vec::new();
    let mut recorded = Vec::new();
    for row in &rows {
        let site = match &row.subject {
            Subject::Marker(name) if followed.contains(name.as_str()) => {
                left.followed += 1;
                continue;
            }
            Subject::Marker(name) if recording.ignore.contains(name) => {
                left.ignored += 1;
                continue;
            }
            Subject::Marker(name) => {
                let in_scene = recording.markers.iter().position(|m| m.name == *name);
                match (in_scene, row.arc_length, placed.get(name)) {
                    (Some(site), ..) => site,
                    (None, Some(s), Some(&site)) if bits(s) == bits(sites[site].marker.s) => site,
                    (None, Some(s), Some(&site)) => {
                        let before = sites[site].marker.s;
                        let message = format!("marker {name:?} is at s_m = {s}, in a row before at {before}");
                        return Err(bad(row.line, message));
                    }
                    (None, Some(s), None) => {
                        on_the_rod(row.line, s)?;
                        placed.insert(name.clone(), sites.len());
                        sites.push(Placed { label: format!("marker {name}"), ..Placed::at_arc_length(s) });
                        sites.len() - 1
                    }
                    (None, None, _) => {
                        let remedy = "add it to [[observations.markers]] or to observations.ignore, or \
                                      give its `s_m` in the file";
                        return Err(bad(row.line, format!("marker {name:?} has no place: {remedy}")));
                    }
                }
            }
            Subject::ArcLength(s) => {
                on_the_rod(row.line, *s)?;
                *site_of.entry(bits(*s)).or_insert_with(|| {
                    sites.push(Placed::at_arc_length(*s));
                    sites.len() - 1
                })
            }
        };
        let time = row.time - recording.time_zero + clock.shift;
        let sigma = row.sigma.or(recording.sigma).ok_or_else(|| {
            bad(row.line, "no standard deviation: fill `sigma_m`, or give observations.sigma".to_string())
        })?;
        recorded.push(Recorded { time: row.time, site, position: row.position, sigma });
        let at = clock.place(row.time, row.time_rounding, &mut left).map_err(|e| bad(row.line, e))?;
        let Some(at) = at else { continue };
        let values = (0..3).map(|c| row.position[c].map(|v| v + shift[c])).collect();
        seen.push(Seen { site, step: at.floor() as usize, weight: at.fract(), values, sigma });
        let sigma = (rows_may_be * sigma).hypot(late);
        sightings.push(Sighting { line: row.line, site, time, written: row.position, sigma });
    }
    left.repeated = leave_out_repeated(&mut seen, &mut sightings);

    // nalgebra takes the rows of R for columns: this is Rᵀ.
    let axes = Matrix3::from(rotation);
    let reach = sites.iter().map(Placed::reach).collect();
    let held = Held::new(&rod.parts, axes, shift, reach, sightings.len());
    let labels: Vec<&str> = sites.iter().map(|s| s.label.as_str()).collect();
    let mut impossible = Impossible { recording, bad: &bad, left: &mut left, seen, sightings };

    let exchanged = {
        let arc_lengths: Vec<f64> = sites.iter().map(|s| s.marker.s).collect();
        continuity::exchanges(&impossible.sightings, &arc_lengths)
    };
    if !exchanged.is_empty() {
        let reason = continuity::explain_exchanges(&impossible.sightings, &exchanged, &labels);
        let rows = exchanged.iter().flat_map(|e| e.rows.iter().copied()).collect();
        impossible.leave_out("rows of exchanged labels", rows, &reason)?;
    }
    let unreachable = held.unreachable(&impossible.sightings);
    if !unreachable.is_empty() {
        let reason = held.explain(&impossible.sightings, &unreachable, &labels);
        let rows = unreachable.iter().map(|u| u.row).collect();
        impossible.leave_out("rows beyond the rod's reach", rows, &reason)?;
    }
    let fastest = Fastest::of(&rod.parts, recording.max_speed, run);
    let jumps = continuity::jumps(&impossible.sightings, fastest);
    if !jumps.is_empty() {
        let reason = continuity::explain_jumps(&impossible.sightings, &jumps, fastest, &labels);
        impossible.leave_out("rows that jump", jumps.iter().map(|j| j.row).collect(), &reason)?;
    }
    let Impossible { seen, sightings, .. } = impossible;
    let neighbours = held.chords(&sightings).into_iter().map(|chord| Neighbours {
        labels: chord.sites.map(|site| sites[site].label.clone()),
        arc: chord.arc,
        farthest: chord.farthest,
        allowed: chord.allowed,
    });
    let times: Vec<f64> = rows.iter().map(|row| row.time).collect();
    let counted = left.count(rows.len(), &seen, |site| sites[site].withheld, grid);
    let sites_by_name = sites.iter().map(|site| site.label.as_str());
    let summary = summary(SitesAre::Markers, counted, (&times, &clock), sites_by_name, &recorded);
    let summary = RecordingSummary { neighbours: neighbours.collect(), ..summary };
    let observed = observed(rod, sites, rotation, seen, None, left.into_texts());
    Ok(Observed { recording: Some(summary), ..observed })
}

/// By how much σ of rows may be larger than the scene says, and how far supports may be from where they are
/// taken to be \[m\], where σ, clock, drives and recorded places are estimated: two σ, and one.
fn unknown_errors(files: &Files, rod: &RodSystem, run: [f64; 2]) -> Result<(f64, f64), Error> {
    let prior = |key: &str, unknown: &Option<Unknown>| -> Result<f64, Error> {
        Ok(match files.scene.prior_of_one(key, unknown)? {
            Some(PriorSpread::Normal(sigma) | PriorSpread::LogNormal(sigma)) => sigma,
            None => 0.0,
        })
    };
    let estimate = &files.scene.scene.estimate;
    let share = prior("estimate.observation_sigma", &estimate.observation_sigma)?;
    let late = prior("estimate.clock", &estimate.clock)? * speed_of_supports(&rod.parts, run);
    Ok(((2.0 * share).exp(), late.hypot(rod.parts.estimates.supports_off())))
}

/// Rows of a recording while those that cannot be true are looked for.
struct Impossible<'a> {
    recording: &'a Recording,
    bad: &'a dyn Fn(usize, String) -> Error,
    left: &'a mut LeftOut,
    seen: Vec<Seen>,
    sightings: Vec<Sighting>,
}

impl Impossible<'_> {
    /// Leaves rows out, where the scene wants that.
    ///
    /// # Errors
    /// The reason with the line of the first of them, where it does not.
    fn leave_out(&mut self, what: &str, rows: HashSet<usize>, reason: &str) -> Result<(), Error> {
        let mut lines: Vec<usize> = rows.iter().map(|row| self.sightings[*row].line).collect();
        lines.sort_unstable();
        if self.recording.unreachable == UnreachableRows::Error {
            let remedy = "observations.unreachable = \"skip\" leaves such rows out";
            return Err((self.bad)(lines[0], format!("{reason} ({remedy})")));
        }
        let listed: Vec<String> = lines.iter().map(usize::to_string).collect();
        self.left.refused += rows.len();
        self.left.impossible.push(format!("{what}, in lines {}: {reason}", listed.join(", ")));
        let mut row = 0..;
        self.seen.retain(|_| row.next().is_some_and(|row| !rows.contains(&row)));
        let mut row = 0..;
        self.sightings.retain(|_| row.next().is_some_and(|row| !rows.contains(&row)));
        Ok(())
    }
}

/// Leaves out rows whose site, time and values are those of an earlier row; how many.
fn leave_out_repeated(seen: &mut Vec<Seen>, sightings: &mut Vec<Sighting>) -> usize {
    let mut known = HashSet::new();
    let new: Vec<bool> = sightings
        .iter()
        .map(|s| known.insert((s.site, s.time.to_bits(), s.written.map(|v| v.map(f64::to_bits)))))
        .collect();
    let mut kept = new.iter();
    seen.retain(|_| *kept.next().expect("a flag a row"));
    let mut kept = new.iter();
    sightings.retain(|_| *kept.next().expect("a flag a row"));
    new.iter().filter(|new| !**new).count()
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
    let operator = |rotation: [[f64; 3]; 3], mounted: bool| -> MakeOperator {
        let (markers, parts, models) = (Rc::clone(&markers), rod.parts.clone(), rod.models());
        // values are those of the recording turned into its axes but not displaced: the origin is the model's
        let axes = Matrix3::from(rotation).transpose();
        let seen = move |parts: &RodParts, markers: &[Marker]| {
            Markers::new(&parts.dynamics()?, markers)?.in_axes(axes, Vector3::zeros())
        };
        Box::new(move || {
            let operator = seen(&parts, &markers)?;
            let seeing = if mounted { parts.estimates.seen } else { parts.estimates.seen.of_places() };
            let operator = if seeing.moves_sites() { operator.with_frames() } else { operator };
            let places = (!parts.estimates.is_empty()).then(|| parts.places()).transpose()?;
            Ok(with_constants(operator, places, seeing, &markers, &models))
        })
    };
    let site = |(i, site): (usize, Placed)| Site {
        label: site.label,
        rows: 3 * i..3 * i + 3,
        anchors: [0, 1, 2].map(|c| rod.nearest_position(site.marker.s) + c).to_vec(),
        place: Some(site.marker.s),
        withheld: site.withheld,
    };
    Observed {
        errors: None,
        space: Some(ObservedSpace {
            arc_lengths: markers.iter().map(|m| m.s).collect(),
            rotation,
            make_places: operator(Frame::default().rotation_rows(), false),
        }),
        make_operator: operator(rotation, true),
        sites: sites.into_iter().enumerate().map(site).collect(),
        seen,
        left_out,
        recording: None,
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
