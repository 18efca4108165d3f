//! Observations of a rod: points on it at times, in the axes of a recording or in the images of cameras.

use std::cell::OnceCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use varda_rod::{Camera, Marker, Markers, Matrix3, Vector3, View, Views};

use super::continuity::{self, Fastest, speed_of_supports};
use super::csv;
use super::files::Files;
use super::observations::{Draws, MakeOperator, Observed, ObservedSpace, Seen, Site};
use super::pixels::{self, Pixels};
use super::points::{About, Placed, Points};
use super::reachable::{Held, Sighting};
use super::readings::{self, Readings};
use super::recorded_rows::{Clock, LeftOut, summary, text_of};
use super::recording::Recorded;
use super::rod::RodSystem;
use super::rod_model::RodParts;
use super::rotations::{Rotations, Rows};
use super::seen_with::with_constants;
use super::stacked::Stacked;
use crate::Error;
use crate::outcome::{Neighbours, Quantity, RecordingSummary, SitesAre};
use crate::scene::{
    self, Frame, Method, PriorSpread, Recording, SceneFile, Sensor, SensorKind, Synthetic, TimeGrid, Unknown,
    UnreachableRows, Use,
};

/// Points at the arc lengths that a twin experiment observes; their values are not yet drawn.
pub(crate) fn synthetic(
    files: &Files,
    keys: &Synthetic,
    rod: &RodSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let points: Vec<Placed> = keys.places.iter().map(|s| Placed::at_arc_length(*s)).collect();
    let steps = files.scene.checked(keys.observed_steps(grid.steps))?;
    let sigma = files.scene.checked(keys.place_sigma())?.map(|sigma| sigma.of(rod.length()));
    let places = if sigma.is_some() { points.len() } else { 0 };
    let mut views: Vec<View> = (0..places).map(|point| View::Place { point }).collect();
    let mut draws =
        Draws { steps, sigma: vec![sigma.unwrap_or_default(); places], within: vec![None; places] };
    for (camera, of) in keys.cameras.iter().enumerate() {
        views.extend((0..points.len()).map(|point| View::Pixels { camera, point }));
        let sigma = of.sigma.ok_or_else(|| {
            files
                .scene
                .invalid(&format!("observations.cameras.{camera}.sigma"), "a twin draws pixels with it")
        })?;
        draws.sigma.resize(views.len(), sigma);
        draws.within.resize(views.len(), of.image);
    }
    for (i, sensor) in keys.sensors.iter().enumerate() {
        let sigma = sensor.sigma.ok_or_else(|| {
            files.scene.invalid(&format!("observations.sensors.{i}.sigma"), "a twin draws readings with it")
        })?;
        draws.sigma.push(sigma);
        draws.within.push(None);
    }
    let what = What {
        points,
        views,
        names: &keys.cameras,
        cameras: cameras(files.scene, &keys.cameras, [0.0; 3])?,
        rotation: Frame::default().rotation_rows(),
        sensors: &keys.sensors,
        rotations: None,
    };
    Ok(Observed { draws: Some(draws), ..observed(files.scene, rod, what, Vec::new(), grid, false)? })
}

/// Nothing observed, for a forward run.
pub(crate) fn none(files: &Files, rod: &RodSystem, grid: TimeGrid) -> Result<Observed, Error> {
    let rotation = Frame::default().rotation_rows();
    let (points, views, cameras) = (Vec::new(), Vec::new(), Vec::new());
    let what = What { points, views, names: &[], cameras, rotation, sensors: &[], rotations: None };
    observed(files.scene, rod, what, Vec::new(), grid, false)
}

/// The cameras of a scene, with their places displaced, in axes that are turned alike.
///
/// # Errors
/// [`Error::Scene`] for what is no camera.
fn cameras(file: &SceneFile, keys: &[scene::Camera], shift: [f64; 3]) -> Result<Vec<Camera>, Error> {
    let camera = |(i, keys): (usize, &scene::Camera)| {
        let place = Vector3::from(keys.position) + Vector3::from(shift);
        // nalgebra takes the rows of R for columns
        let rotation = Matrix3::from(keys.rotation).transpose();
        Camera::new(keys.focal_length, keys.principal_point)
            .and_then(|camera| camera.distorted(keys.distortion))
            .and_then(|camera| camera.posed(place, rotation))
            .map_err(|e| file.invalid(&format!("observations.cameras.{i}"), e.to_string()))
    };
    keys.iter().enumerate().map(camera).collect()
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
    let timed = files.scene.scene.algorithm.method != Method::Static;
    // pixels or readings alone are a recording too
    let (label, rows) = match (&recording.file, recording.pixels.as_ref().or(recording.readings.as_ref())) {
        (None, Some(_)) => (String::new(), Vec::new()),
        (file, _) => {
            let (label, text) = text_of(files, "observations.file", file)?;
            let rows = if timed { csv::observations(&label, &text)? } else { csv::shape(&label, &text)? };
            (label, rows)
        }
    };
    let bad = |line: usize, message: String| Error::Data { place: format!("{label}:{line}"), message };
    let mut points = Points::of(files, recording, rod.length());
    let rotation = recording.frame.rotation_rows();
    let shift: [f64; 3] =
        std::array::from_fn(|c| (0..3).map(|j| rotation[j][c] * recording.frame.translation[j]).sum());
    let clock = Clock { recording, grid, shift: files.scene.adjusted.clock };
    let run = [grid.start, grid.time(grid.last_step())];
    let (rows_may_be, late) = unknown_errors(files, rod, run)?;
    let mut left = LeftOut::default();
    let mut seen = Vec::new();
    let mut sightings = Vec::new();
    let mut recorded = Vec::new();
    for row in &rows {
        let site = match points.about(&row.subject, row.arc_length).map_err(|e| bad(row.line, e))? {
            About::Point(point) => point,
            About::Followed => {
                left.followed += 1;
                continue;
            }
            About::Ignored => {
                left.ignored += 1;
                continue;
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
    let pixels = match &recording.pixels {
        None => Pixels::default(),
        Some(_) => {
            let (label, text) = text_of(files, "observations.pixels", &recording.pixels)?;
            pixels::recorded((&label, &text), timed, &clock, &mut points, &mut left)?
        }
    };
    let readings = match &recording.readings {
        None => Readings::default(),
        Some(_) => {
            let (label, text) = text_of(files, "observations.readings", &recording.readings)?;
            readings::recorded((&label, &text), timed, &clock, &mut left)?
        }
    };
    let sites = points.all;

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
    let Impossible { mut seen, sightings, .. } = impossible;
    let neighbours = held.chords(&sightings).into_iter().map(|chord| Neighbours {
        labels: chord.sites.map(|site| sites[site].label.clone()),
        arc: chord.arc,
        farthest: chord.farthest,
        allowed: chord.allowed,
    });
    let neighbours = neighbours.collect();

    let places = if recording.file.is_some() { sites.len() } else { 0 };
    let later = |site: usize| site + places;
    seen.extend(pixels.seen.into_iter().map(|s| Seen { site: later(s.site), ..s }));
    recorded.extend(pixels.recorded.into_iter().map(|r| Recorded { site: later(r.site), ..r }));
    let seen_by = pixels.sites.iter().map(|&(camera, point)| View::Pixels { camera, point });
    let views: Vec<View> = (0..places).map(|point| View::Place { point }).chain(seen_by).collect();
    let later = |site: usize| site + views.len();
    seen.extend(readings.seen.into_iter().map(|s| Seen { site: later(s.site), ..s }));
    recorded.extend(readings.recorded.into_iter().map(|r| Recorded { site: later(r.site), ..r }));
    let what = What {
        views,
        points: sites,
        sensors: &recording.sensors,
        rotations: Some(readings.rotations),
        names: &recording.cameras,
        cameras: cameras(files.scene, &recording.cameras, shift)?,
        rotation,
    };
    let times = rows.iter().map(|row| row.time).chain(pixels.times).chain(readings.times);
    let times: Vec<f64> = times.collect();
    let observed = observed(files.scene, rod, what, seen, grid, true)?;
    let between = |s: &&Seen| s.weight > 0.0 && observed.sites[s.site].is_rotation();
    if observed.seen.iter().any(|s| between(&s)) && rod.models()(0).rate().is_none() {
        let message = "directions and orientations are read between two steps, where this integrator has no \
                       state: \"bdf2\" or \"backward-euler\" have, or take steps that meet the readings";
        return Err(files.scene.invalid("observations.readings", message));
    }
    let counted = left.count(times.len(), &observed.seen, |site| observed.sites[site].withheld, grid);
    let summary = summary(SitesAre::Markers, counted, (&times, &clock), &observed.sites, &recorded);
    let recording = Some(RecordingSummary { neighbours, ..summary });
    Ok(Observed { recording, left_out: left.into_texts(), ..observed })
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

/// What is seen of a rod, and how.
struct What<'a> {
    /// Points of the rod.
    points: Vec<Placed>,
    /// A view of one of them for every site.
    views: Vec<View>,
    /// The cameras of views, in the axes of coordinates, and their keys.
    names: &'a [scene::Camera],
    cameras: Vec<Camera>,
    /// From the axes of coordinates to those of the model, by rows.
    rotation: [[f64; 3]; 3],
    /// Sensors on it.
    sensors: &'a [Sensor],
    /// Rotations that these read, where that is known.
    rotations: Option<HashMap<usize, (SensorKind, Rows)>>,
}

/// Observations of this; what a recording saw in its window must be in sight there. A twin experiment sees
/// everything at all times.
///
/// # Errors
/// [`Error::Scene`] for a sensor that does not fit the rod.
fn observed(
    file: &SceneFile,
    rod: &RodSystem,
    what: What,
    seen: Vec<Seen>,
    grid: TimeGrid,
    is_recording: bool,
) -> Result<Observed, Error> {
    let What { points, mut views, names, cameras, rotation, sensors, rotations: read } = what;
    let markers: Rc<[Marker]> = points.iter().map(|p| p.marker).collect();
    let operator = |markers: &Rc<[Marker]>, rotation: [[f64; 3]; 3], mounted: bool| -> MakeOperator {
        let (markers, parts, models) = (Rc::clone(markers), rod.parts.clone(), rod.models());
        // values are those of the recording turned into its axes but not displaced: the origin is the model's
        let axes = Matrix3::from(rotation).transpose();
        let seen = move |parts: &RodParts, markers: &[Marker]| {
            Markers::new(&parts.dynamics()?, markers)?.in_axes(axes, Vector3::zeros())
        };
        Box::new(move || {
            let operator = seen(&parts, &markers)?;
            let seeing = &parts.estimates.seen;
            let seeing = if mounted { seeing.clone() } else { seeing.of_places() };
            let operator = if seeing.moves_sites() { operator.with_frames() } else { operator };
            let places = (!parts.estimates.is_empty()).then(|| parts.places()).transpose()?;
            Ok(with_constants(operator, places, seeing, &markers, &models))
        })
    };
    let mut rows = 0;
    let mut sites: Vec<Site> = views
        .iter()
        .map(|view| {
            let (point, camera) = match *view {
                View::Place { point } => (&points[point], None),
                View::Pixels { camera, point } => (&points[point], Some(&names[camera])),
            };
            rows += view.rows();
            let nearest = rod.nearest_position(point.marker.s);
            Site {
                label: match camera {
                    None => point.label.clone(),
                    Some(camera) => format!("{} in camera {}", point.label, camera.name),
                },
                quantity: if camera.is_some() { Quantity::Pixels } else { Quantity::Place },
                camera: camera.map(|camera| camera.name.clone()),
                sensor: None,
                rows: rows - view.rows()..rows,
                anchors: (0..view.rows()).map(|c| nearest + c).collect(),
                place: Some(point.marker.s),
                withheld: point.withheld || camera.is_some_and(|camera| camera.used == Use::Withhold),
            }
        })
        .collect();
    let named = sites.iter().zip(&views).map(|(site, view)| (site.label.clone(), *view)).collect();
    let in_sight = is_recording.then(|| {
        // readings of sensors come behind
        let is_used = |s: &&Seen| sites.get(s.site).is_some_and(|site| !site.withheld);
        let used = seen.iter().filter(is_used).filter(|s| s.at() <= grid.steps as f64);
        let used = used.filter(|s| s.values.iter().any(Option::is_some));
        // a time between two steps needs both
        let steps = |s: &Seen| {
            let site = s.site;
            (s.step..=s.step + usize::from(s.weight > 0.0)).map(move |step| (step, site))
        };
        (grid, Rc::new(used.flat_map(steps).collect::<HashSet<(usize, usize)>>()))
    });
    let seen_as = |operator: MakeOperator, named: Vec<(String, View)>| -> MakeOperator {
        if named.iter().enumerate().all(|(i, (_, view))| *view == View::Place { point: i }) {
            return operator;
        }
        let (cameras, in_sight, parts) = (cameras.clone(), in_sight.clone(), rod.parts.clone());
        Box::new(move || {
            let mut views = Views::new(operator()?, cameras.clone(), named.clone())?;
            let poses = &parts.estimates.seen.poses;
            if !poses.is_empty() {
                let first = parts.places()?.parameters().start;
                views =
                    views.with_poses(poses.iter().map(|pose| pose.map(|at| Some(first + at?))).collect())?;
            }
            Ok(match in_sight.clone() {
                None => Box::new(views),
                // steps of windows of a sequence are their own: the time says which it is of all
                Some((grid, seen)) => Box::new(views.seen_where(move |at, view| {
                    let step = ((at.time - grid.start) / grid.step + 1e-6).floor() as usize;
                    seen.contains(&(step, view))
                })),
            })
        })
    };
    let (is_all, rotations) = (sensors.is_empty(), Rc::new(OnceCell::new()));
    if let Some(read) = read {
        let _ = rotations.set(Rotations::new(sites.len(), read));
    }
    let mut make_operator = seen_as(operator(&markers, rotation, true), named);
    // sensors have places too
    let mut all_markers = markers.to_vec();
    for sensor in sensors {
        let (place, count) = (Placed::at_arc_length(sensor.arc_length), sensor.kind.values());
        let nearest = rod.nearest_position(sensor.arc_length);
        sites.push(Site {
            label: format!("sensor {}", sensor.name),
            quantity: sensor.kind.quantity(),
            camera: None,
            sensor: Some((sensor.name.clone(), sensor.kind)),
            rows: rows..rows + count,
            anchors: (0..count).map(|c| nearest + c).collect(),
            place: Some(sensor.arc_length),
            withheld: sensor.used == Use::Withhold,
        });
        rows += count;
        views.push(View::Place { point: all_markers.len() });
        all_markers.push(place.marker);
    }
    if !is_all {
        let of_sensors = readings::operator(file, rod, sensors, grid.step, &rotations)?;
        make_operator = Box::new(move || Ok(Stacked::of(vec![make_operator()?, of_sensors()?])));
    }
    let of_places = views.iter().map(|view| (String::new(), View::Place { point: view.point() })).collect();
    let markers: Rc<[Marker]> = all_markers.into();
    Ok(Observed {
        errors: None,
        space: Some(ObservedSpace {
            arc_lengths: views.iter().map(|view| markers[view.point()].s).collect(),
            rotation,
            make_places: seen_as(operator(&markers, Frame::default().rotation_rows(), false), of_places),
        }),
        make_operator,
        sites,
        seen,
        left_out: Vec::new(),
        recording: None,
        rotations,
        draws: None,
    })
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
