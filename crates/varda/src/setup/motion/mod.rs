//! How the supports of a rod move: from keys and recordings to motions of varda-rod.

mod body;
mod held;
mod rows;

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::Arc;

use varda_rod::{
    EllipseDrive, Motion, Quaternion, RecordedMotion, RecordedRotation, SmoothBy, Smoothing, UnitQuaternion,
    Vector3, noise_of_rotations, noise_of_rows,
};

use super::csv::{self, ObservedRow, Subject};
use super::files::Files;
use crate::Error;
use crate::scene::{self, MotionValues, Observations, PoseValues, Recording};
use body::{Body, without_spin};
use held::Carried;
pub(super) use held::{Held, Moving};
use rows::{Axes, Source};

/// Reads motions; keeps what there is to say of them.
pub(super) struct Motions<'a> {
    files: &'a Files<'a>,
    /// First and last model time of a run \[s\].
    pub(super) run: [f64; 2],
    pub(super) remarks: Vec<String>,
    pub(super) followed: Vec<Followed>,
}

/// A recorded motion that the support at `path` follows.
pub(super) struct Followed {
    pub(super) path: String,
    /// Mean time between its rows \[s\].
    pub(super) interval: f64,
    /// The frequency from which on it is smoothed \[Hz\].
    pub(super) cut_off: Option<f64>,
    /// Of a body that turns.
    pub(super) turned: Option<Turned>,
}

/// A recorded rotation that a clamp follows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turned {
    /// The frequency from which on it is smoothed \[Hz\].
    pub(super) cut_off: Option<f64>,
    /// The clamp's place from the body's origin, in the clamp's axes (m₁, m₂, t) \[m\].
    pub(super) arm: Vector3<f64>,
}

/// The drive that keys say of a support at this position.
pub(super) fn drive(position: [f64; 3], motion: &scene::Motion) -> Option<EllipseDrive> {
    let &scene::Motion::Ellipse { radii, omega, ramp_periods } = motion else { return None };
    let (centre, ramp) = (position.into(), ramp_periods * TAU / omega);
    Some(EllipseDrive { centre, radii, omega, phase: 0.0, ramp })
}

/// Turns of a clamp as a function of time.
type TurnsInTime = Arc<dyn Fn(f64) -> f64 + Send + Sync>;

impl<'a> Motions<'a> {
    pub(super) fn of(files: &'a Files<'a>) -> Result<Self, Error> {
        let grid = files.scene.grid()?;
        // The truth of a twin experiment runs from 0 on.
        let first = if files.scene.scene.time.spin_up > 0 { 0.0 } else { grid.start };
        Ok(Motions {
            files,
            run: [first, grid.time(grid.last_step())],
            remarks: Vec::new(),
            followed: Vec::new(),
        })
    }

    /// The motion of a support that the key `path` describes.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key, or the error of the file.
    pub(super) fn read(
        &mut self,
        path: &str,
        held: Held,
        motion: Option<&scene::Motion>,
    ) -> Result<Moving, Error> {
        // Keys that are absent are said by the motion.
        let position = held.position.unwrap_or_default();
        let place: Arc<dyn Motion> = match motion {
            None => Arc::new(position),
            Some(motion @ scene::Motion::Ellipse { .. }) => {
                Arc::new(drive(position, motion).expect("keys of a drive"))
            }
            Some(scene::Motion::Table(keys)) => Arc::new(self.table(path, position.into(), keys)?),
            Some(scene::Motion::Pose(keys)) => {
                let carried = self.pose(path, held, keys)?;
                return Ok(self.turns_with(carried));
            }
            Some(scene::Motion::Markers(keys)) => match self.markers(path, held, keys)? {
                Following::Body(carried) => return Ok(self.turns_with(carried)),
                Following::Point(place) => Arc::new(place),
            },
        };
        Ok(Moving {
            place,
            tangent: Arc::new(held.tangent.unwrap_or_default()),
            director: Arc::new(held.director.unwrap_or_default()),
        })
    }

    /// The turns of the clamp at `path`.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key, or the error of the file.
    pub(super) fn turns(&mut self, path: &str, keys: &scene::Turns) -> Result<TurnsInTime, Error> {
        let keys = match keys {
            scene::Turns::Constant(turns) => {
                let turns = *turns;
                return Ok(Arc::new(move |_| turns));
            }
            scene::Turns::Recorded(keys) => keys,
        };
        let path = format!("{path}.turns");
        let columns = ["time_s", "turns"];
        let turns = self.straight(&path, &keys.file, keys.time_zero, columns, |[_, t]| [t, 0.0, 0.0])?.0;
        Ok(Arc::new(move |t| turns.at(t).x))
    }

    /// Straight lines between the vectors of the rows that `{path}.file` names, and these vectors.
    pub(super) fn straight<const N: usize>(
        &mut self,
        path: &str,
        file: &str,
        time_zero: f64,
        columns: [&str; N],
        vector: impl Fn([f64; N]) -> [f64; 3],
    ) -> Result<(RecordedMotion, Vec<Vector3<f64>>), Error> {
        let (key, clock) = (format!("{path}.file"), format!("{path}.time_zero"));
        let Recorded { source, times, rows, .. } =
            self.recorded((&key, file), (&clock, time_zero), columns)?;
        let vectors: Vec<Vector3<f64>> = rows.into_iter().map(|row| vector(row).into()).collect();
        let motion = RecordedMotion::through(&times, &vectors).map_err(|e| source.refused(e))?;
        Ok((motion, vectors))
    }

    /// Whether the file that a key names has a column.
    pub(super) fn has_column(&self, key: &str, file: &str, column: &str) -> Result<bool, Error> {
        let (_, text) = self.files.text(key, file)?;
        Ok(csv::has_column(&text, column))
    }

    /// The rows of a recording: the key that names its file and that, the key of its clock and that.
    fn recorded<'b, const N: usize>(
        &mut self,
        (key, file): (&'b str, &'b str),
        time_zero: (&'b str, f64),
        columns: [&str; N],
    ) -> Result<Recorded<'b, N>, Error>
    where
        'a: 'b,
    {
        let (label, text) = self.files.text(key, file)?;
        let source = self.source(key, label, time_zero);
        let (written, rows): (Vec<_>, Vec<_>) = csv::recorded(&source.label, &text, columns)?
            .into_iter()
            .map(|(line, row)| ((line, row[0]), row))
            .unzip();
        let times = source.checked(&written, &mut self.remarks)?;
        Ok(Recorded { source, written, times, rows })
    }

    fn table(
        &mut self,
        path: &str,
        position: Vector3<f64>,
        keys: &scene::RecordedMotion,
    ) -> Result<RecordedMotion, Error> {
        let (key, clock) = (format!("{path}.motion.file"), format!("{path}.motion.time_zero"));
        let columns = ["time_s", "x_m", "y_m", "z_m"];
        let Recorded { source, times, rows, .. } =
            self.recorded((&key, &keys.file), (&clock, keys.time_zero), columns)?;
        let origin = match keys.values {
            MotionValues::Displacement => position,
            MotionValues::Absolute => keys.frame.translation.into(),
        };
        let axes = Axes::of(&keys.frame, origin);
        let places: Vec<_> = rows.iter().map(|&[_, x, y, z]| axes.place([x, y, z])).collect();
        let by = choice(keys.sigma, keys.cutoff, || noise_of_rows(&times, &places));
        let motion = match by {
            None => RecordedMotion::through(&times, &places),
            Some(by) => RecordedMotion::smoothed(&times, &places, by),
        };
        let motion = motion.map_err(|e| source.refused(e))?;
        self.say(path, "motion", &source.label, by, motion.smoothing());
        self.follows(path, &times, &motion);
        Ok(motion)
    }

    fn pose(&mut self, path: &str, held: Held, keys: &scene::RecordedPose) -> Result<Carried, Error> {
        let (key, clock) = (format!("{path}.motion.file"), format!("{path}.motion.time_zero"));
        let columns = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"];
        let Recorded { source, written, times, rows } =
            self.recorded((&key, &keys.file), (&clock, keys.time_zero), columns)?;
        let axes = Axes::of(&keys.frame, keys.frame.translation.into());
        let mut places = Vec::with_capacity(rows.len());
        let mut rotations = Vec::with_capacity(rows.len());
        for (&(line, _), &[_, x, y, z, qx, qy, qz, qw]) in written.iter().zip(&rows) {
            let q = Quaternion::new(qw, qx, qy, qz);
            // Written with three digits or more.
            if !((q.norm() - 1.0).abs() <= 0.01) {
                let message = format!("(qx, qy, qz, qw) has length {}: a rotation has 1", q.norm());
                return Err(source.bad(line, message));
            }
            places.push(axes.place([x, y, z]));
            rotations.push(axes.rotation(UnitQuaternion::new_normalize(q)));
        }
        self.no_jump_of(&source, &written, &rotations)?;
        let place = choice(keys.sigma, keys.cutoff, || noise_of_rows(&times, &places));
        let angle = choice(keys.sigma_angle, keys.cutoff, || noise_of_rotations(&times, &rotations));
        let (place, rotation) = self.follow(path, &source, &times, (&places, place), (&rotations, angle))?;
        Ok(match keys.values {
            PoseValues::Absolute => Carried {
                place,
                rotation,
                offset: keys.offset.into(),
                tangent: keys.tangent_axis.into(),
                director: keys.director_axis.into(),
            },
            PoseValues::Displacement => Carried::from_time_zero(place, rotation, held),
        })
    }

    fn markers(&mut self, path: &str, held: Held, keys: &scene::RecordedMarkers) -> Result<Following, Error> {
        let key = format!("{path}.motion.names");
        let scene = self.files.scene;
        let Observations::File(recording) = &scene.scene.observations else {
            let message = "markers are followed in a recording: observations.kind = \"file\"";
            return Err(scene.invalid(&key, message));
        };
        let Some(file) = &recording.file else {
            return Err(scene.invalid("observations", "no file is named: its markers move a support"));
        };
        let (label, text) = self.files.text("observations.file", file)?;
        let source = self.source(&key, label, ("observations.time_zero", recording.time_zero));
        let rows = csv::observations(&source.label, &text)?;
        let (written, frames, sigma) = frames(&source, &rows, keys, recording)?;
        let times = source.checked(&written, &mut self.remarks)?;
        let sigma = keys.sigma.or(if keys.cutoff.is_some() { None } else { sigma });
        let seen = SeenMarkers { source, written, times, frames, sigma };
        match keys.names.len() {
            1 => self.one_marker(path, held, keys, &seen).map(Following::Point),
            2 => self.two_markers(path, held, keys, &seen).map(Following::Body),
            _ => self.three_markers(path, held, keys, &seen).map(Following::Body),
        }
    }

    /// A marker at the support: its place.
    fn one_marker(
        &mut self,
        path: &str,
        held: Held,
        keys: &scene::RecordedMarkers,
        seen: &SeenMarkers,
    ) -> Result<Shifted, Error> {
        let places: Vec<_> = seen.frames.iter().filter_map(|seen| seen[0]).collect();
        let by = choice(seen.sigma, keys.cutoff, || noise_of_rows(&seen.times, &places));
        let motion = curve(&seen.times, &places, by).map_err(|e| seen.source.refused(e))?;
        self.say(path, "motion", &format!("of marker {}", keys.names[0]), by, motion.smoothing());
        self.follows(path, &seen.times, &motion);
        let displaced = held.position.filter(|_| keys.values == PoseValues::Displacement);
        let shift = displaced.map(|p| Vector3::from(p) - motion.at(0.0)).unwrap_or_default();
        Ok(Shifted { motion, shift })
    }

    /// Two markers along the tangent: place and direction, and no spin about it.
    fn two_markers(
        &mut self,
        path: &str,
        held: Held,
        keys: &scene::RecordedMarkers,
        seen: &SeenMarkers,
    ) -> Result<Carried, Error> {
        let whole = seen.frames.iter().filter_map(|seen| seen[0].zip(seen[1]));
        let (places, directions): (Vec<_>, Vec<_>) = whole.map(|(a, b)| (a, b - a)).unzip();
        let rotations = without_spin(&directions);
        let length = directions.iter().map(|d| d.norm()).sum::<f64>() / directions.len() as f64;
        let by_place = choice(seen.sigma, keys.cutoff, || None);
        let angle = choice(seen.sigma.map(|s| s * 2.0_f64.sqrt() / length), keys.cutoff, || None);
        let (place, rotation) =
            self.follow(path, &seen.source, &seen.times, (&places, by_place), (&rotations, angle))?;
        if keys.values == PoseValues::Displacement {
            return Ok(Carried::from_time_zero(place, rotation, held));
        }
        let director = rotation.at(0.0).inverse() * Vector3::from(held.director.unwrap_or_default());
        Ok(Carried { offset: Vector3::zeros(), tangent: directions[0], director, place, rotation })
    }

    /// Three markers of a rigid body or more: the first at the face, the second ahead of it, the third aside.
    fn three_markers(
        &mut self,
        path: &str,
        held: Held,
        keys: &scene::RecordedMarkers,
        seen: &SeenMarkers,
    ) -> Result<Carried, Error> {
        let SeenMarkers { source, written, times, frames, sigma } = seen;
        let body = self.rigid(source, frames, &keys.names)?;
        let poses: Vec<_> = frames.iter().filter_map(|seen| body.pose(seen)).collect();
        let (rotations, places): (Vec<_>, Vec<_>) = poses.into_iter().unzip();
        self.no_jump_of(source, written, &rotations)?;
        let count = (body.markers.len() as f64).sqrt();
        let by_place = choice(sigma.map(|s| s / count), keys.cutoff, || noise_of_rows(times, &places));
        let angle = choice(sigma.and_then(|s| body.sigma_angle(s)), keys.cutoff, || {
            noise_of_rotations(times, &rotations)
        });
        let (place, rotation) = self.follow(path, source, times, (&places, by_place), (&rotations, angle))?;
        if keys.values == PoseValues::Displacement {
            return Ok(Carried::from_time_zero(place, rotation, held));
        }
        let [face, ahead, aside] = [0, 1, 2].map(|i| body.markers[i]);
        let tangent = (ahead - face).normalize();
        let aside = aside - face;
        let m1 = (aside - tangent * aside.dot(&tangent)).normalize();
        let [along_1, along_2, along_t] = keys.offset;
        let offset = face + m1 * along_1 + tangent.cross(&m1) * along_2 + tangent * along_t;
        Ok(Carried { place, rotation, offset, tangent, director: m1 })
    }

    /// The rigid body of three markers or more.
    fn rigid(
        &mut self,
        source: &Source,
        frames: &[Vec<Option<Vector3<f64>>>],
        names: &[String],
    ) -> Result<Body, Error> {
        let all = names.join(", ");
        let Some(body) = Body::of(frames) else {
            return Err(source.invalid(format!("{}: {all} are never seen together", source.label)));
        };
        if !(body.breadth() > 0.02) {
            return Err(source.invalid(format!(
                "{}: {all} lie on a line, which does not say how the body turns about it",
                source.label
            )));
        }
        if !(body.off <= 0.1 * body.size()) {
            return Err(source.invalid(format!(
                "{}: {all} are no rigid body: coordinates are off one by {:.2e} m (RMS) where it is {:.2e} m \
                 large; are the labels exchanged, or is one of them elsewhere?",
                source.label,
                body.off,
                body.size()
            )));
        }
        Ok(body)
    }

    fn follow(
        &mut self,
        path: &str,
        source: &Source,
        times: &[f64],
        (places, by_place): (&[Vector3<f64>], Option<SmoothBy>),
        (rotations, by_angle): (&[UnitQuaternion<f64>], Option<SmoothBy>),
    ) -> Result<(RecordedMotion, RecordedRotation), Error> {
        let place = curve(times, places, by_place).map_err(|e| source.refused(e))?;
        let rotation = match by_angle {
            None => RecordedRotation::through(times, rotations),
            Some(by) => RecordedRotation::smoothed(times, rotations, by),
        };
        let rotation = rotation.map_err(|e| source.refused(e))?;
        self.say(path, "motion", &source.label, by_place, place.smoothing());
        self.follows(path, times, &place);
        self.say(path, "rotation", &source.label, by_angle, rotation.smoothing());
        Ok((place, rotation))
    }

    /// Refuses rotations of which nobody knows the way from one to the next.
    fn no_jump_of(
        &self,
        source: &Source,
        written: &[(usize, f64)],
        rotations: &[UnitQuaternion<f64>],
    ) -> Result<(), Error> {
        let most = 0.5 * std::f64::consts::PI;
        match rotations.windows(2).position(|w| !(w[0].angle_to(&w[1]) <= most)) {
            None => Ok(()),
            Some(at) => {
                let turn = rotations[at].angle_to(&rotations[at + 1]).to_degrees();
                let (line, time) = written[at + 1];
                Err(source.bad(
                    line,
                    format!(
                        "it turns by {turn:.0}° from the row before (time_s = {time}), more than a quarter \
                         turn: is the real part qw the last column, are labels exchanged, or are rows \
                         missing?"
                    ),
                ))
            }
        }
    }

    fn source<'b>(&self, key: &'b str, label: String, time_zero: (&'b str, f64)) -> Source<'b>
    where
        'a: 'b,
    {
        Source { scene: self.files.scene, key, label, time_zero, run: self.run }
    }

    fn follows(&mut self, path: &str, times: &[f64], motion: &RecordedMotion) {
        let interval = match times {
            [first, .., last] => (last - first) / (times.len() - 1) as f64,
            _ => f64::INFINITY,
        };
        let cut_off = motion.smoothing().map(|s| s.cut_off);
        self.followed.push(Followed { path: path.to_string(), interval, cut_off, turned: None });
    }

    /// The support whose motion was followed last turns with a body.
    fn turns_with(&mut self, carried: Carried) -> Moving {
        let cut_off = carried.rotation.smoothing().map(|s| s.cut_off);
        if let Some(last) = self.followed.last_mut() {
            last.turned = Some(Turned { cut_off, arm: carried.arm() });
        }
        carried.into()
    }

    fn say(&mut self, path: &str, what: &str, label: &str, by: Option<SmoothBy>, done: Option<Smoothing>) {
        let (Some(by), Some(Smoothing { sigma, cut_off })) = (by, done) else { return };
        let unit = if what == "rotation" { "rad" } else { "m" };
        let (whose, remedy) = match by {
            SmoothBy::Sigma(_) => ("given", "sigma = 0 follows every row"),
            SmoothBy::Found => ("found in its rows", "sigma = 0 follows every row"),
            SmoothBy::CutOff(_) => ("left over", "cutoff chooses the frequency"),
        };
        self.remarks.push(format!(
            "jitter of the recorded {what} {label}: what is faster than {cut_off:.3} Hz, by σ = {sigma:.2e} \
             {unit} {whose} ({path}.motion.{remedy})"
        ));
    }
}

/// Rows of a recording: what they are about, lines and times as they are written, and model times.
struct Recorded<'a, const N: usize> {
    source: Source<'a>,
    written: Vec<(usize, f64)>,
    times: Vec<f64>,
    rows: Vec<[f64; N]>,
}

/// The markers that a support follows, at the times at which enough of them were seen.
struct SeenMarkers<'a> {
    source: Source<'a>,
    written: Vec<(usize, f64)>,
    times: Vec<f64>,
    frames: Vec<Seen>,
    /// σ of a coordinate \[m\], where it is given.
    sigma: Option<f64>,
}

/// What follows markers.
enum Following {
    Point(Shifted),
    Body(Carried),
}

/// A motion, displaced.
struct Shifted {
    motion: RecordedMotion,
    shift: Vector3<f64>,
}

impl Motion for Shifted {
    fn at(&self, t: f64) -> Vector3<f64> {
        self.motion.at(t) + self.shift
    }
}

/// How rows are smoothed: as keys say, else by what is found in them; `None` follows every row.
fn choice(sigma: Option<f64>, cutoff: Option<f64>, found: impl FnOnce() -> Option<f64>) -> Option<SmoothBy> {
    match (cutoff, sigma) {
        (Some(frequency), _) => Some(SmoothBy::CutOff(frequency)),
        (None, Some(0.0)) => None,
        (None, Some(sigma)) => Some(SmoothBy::Sigma(sigma)),
        (None, None) => found().map(|_| SmoothBy::Found),
    }
}

/// A smooth curve through rows, or through what smoothing leaves of them.
fn curve(
    times: &[f64],
    places: &[Vector3<f64>],
    by: Option<SmoothBy>,
) -> Result<RecordedMotion, varda_rod::Error> {
    match by {
        None => RecordedMotion::curved(times, places),
        Some(by) => RecordedMotion::smoothed(times, places, by),
    }
}

/// What was seen of markers at a time, each in its place.
type Seen = Vec<Option<Vector3<f64>>>;

/// The times at which enough of the named markers were seen to say where they are, in the order of time, each
/// with the line of its last row; and the σ of a coordinate where the file or the scene says it.
fn frames(
    source: &Source,
    rows: &[ObservedRow],
    keys: &scene::RecordedMarkers,
    recording: &Recording,
) -> Result<(Vec<(usize, f64)>, Vec<Seen>, Option<f64>), Error> {
    let axes = Axes::of(&recording.frame, recording.frame.translation.into());
    let mut all: BTreeMap<u64, (usize, f64, Seen)> = BTreeMap::new();
    let mut known = vec![false; keys.names.len()];
    let (mut squares, mut counted) = (0.0, 0);
    for row in rows {
        let Subject::Marker(name) = &row.subject else { continue };
        let Some(index) = keys.names.iter().position(|n| n == name) else { continue };
        known[index] = true;
        let [Some(x), Some(y), Some(z)] = row.position else { continue };
        if let Some(sigma) = row.sigma.or(recording.sigma) {
            squares += sigma * sigma;
            counted += 1;
        }
        let empty = || (row.line, row.time, vec![None; keys.names.len()]);
        let (line, _, seen) = all.entry(ordered(row.time)).or_insert_with(empty);
        let place = axes.place([x, y, z]);
        if seen[index].is_some_and(|other| other != place) {
            let message = format!("marker {name:?} is at two places at time_s = {}", row.time);
            return Err(source.bad(row.line, message));
        }
        (*line, seen[index]) = (row.line, Some(place));
    }
    if let Some(missing) = known.iter().position(|known| !known) {
        let message = format!("{} has no marker {:?}", source.label, keys.names[missing]);
        return Err(source.invalid(message));
    }
    let enough = keys.names.len().min(3);
    let (mut written, mut frames) = (Vec::new(), Vec::new());
    for (line, time, seen) in all.into_values() {
        if seen.iter().flatten().count() >= enough {
            written.push((line, time));
            frames.push(seen);
        }
    }
    Ok((written, frames, (counted > 0).then(|| (squares / f64::from(counted)).sqrt())))
}

/// Bits that ascend as finite numbers do.
fn ordered(time: f64) -> u64 {
    // −0 is 0.
    let bits = (time + 0.0).to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}
