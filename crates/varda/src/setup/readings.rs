//! What sensors on a rod read: rows of a file.

use std::cell::OnceCell;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use varda_rod::{Matrix3, Sensors, UnitQuaternion, Vector3};

use super::csv::Table;
use super::observations::{MakeOperator, Seen};
use super::recorded_rows::{Clock, LeftOut};
use super::recording::Recorded;
use super::rod::RodSystem;
use super::rotations::{self, Rotations, Rows};
use super::seen_with::with_constants;
use crate::Error;
use crate::outcome::Quantity;
use crate::scene::{SceneFile, Sensor, SensorKind};

/// What a file of readings holds.
#[derive(Default)]
pub(super) struct Readings {
    /// What was read, sites being sensors in the order of the scene.
    pub(super) seen: Vec<Seen>,
    /// Every row of a sensor.
    pub(super) recorded: Vec<Recorded>,
    /// The times of all rows \[s\].
    pub(super) times: Vec<f64>,
    /// What every sensor that reads rotations is, and what it read.
    pub(super) rotations: HashMap<usize, (SensorKind, Rows)>,
}

impl SensorKind {
    /// What its values are.
    pub(super) fn quantity(self) -> Quantity {
        match self {
            SensorKind::Tension | SensorKind::AxialSupportForce => Quantity::AxialForce,
            SensorKind::SupportForce => Quantity::Force,
            SensorKind::SupportMoment => Quantity::SupportMoment,
            SensorKind::Moment => Quantity::Moment,
            SensorKind::Acceleration | SensorKind::SpecificForce => Quantity::Acceleration,
            SensorKind::Direction => Quantity::Direction,
            SensorKind::Orientation => Quantity::Orientation,
            SensorKind::AngularRate => Quantity::AngularRate,
            SensorKind::Spin => Quantity::Spin,
        }
    }
}

/// A sensor of the scene as one of the rod.
fn of_rod(sensor: &Sensor) -> varda_rod::Sensor {
    let s = sensor.arc_length;
    // nalgebra takes rows for columns
    let axes = sensor.axes.map_or_else(Matrix3::identity, |rows| Matrix3::from(rows).transpose());
    match sensor.kind {
        SensorKind::Tension => varda_rod::Sensor::Tension { s },
        SensorKind::SupportForce => varda_rod::Sensor::SupportForce { s },
        SensorKind::AxialSupportForce => varda_rod::Sensor::AxialSupportForce { s },
        SensorKind::SupportMoment => varda_rod::Sensor::SupportMoment { s },
        SensorKind::Moment => varda_rod::Sensor::Moment { s },
        SensorKind::Acceleration => varda_rod::Sensor::Acceleration { s },
        SensorKind::SpecificForce => varda_rod::Sensor::SpecificForce { s, axes },
        SensorKind::Direction => varda_rod::Sensor::Direction { s },
        SensorKind::Orientation => varda_rod::Sensor::Orientation { s, axes },
        SensorKind::AngularRate => varda_rod::Sensor::AngularRate { s },
        SensorKind::Spin => varda_rod::Sensor::Spin { s },
    }
}

/// Makes the operator of sensors on a rod whose steps are `interval` \[s\] long; those of rotations are
/// measured from what they have read by then.
///
/// # Errors
/// The key of a sensor that does not fit the rod, its integrator or its supports.
pub(super) fn operator(
    file: &SceneFile,
    rod: &RodSystem,
    sensors: &[Sensor],
    interval: f64,
    rotations: &Rc<OnceCell<Rotations>>,
) -> Result<MakeOperator, Error> {
    for (i, sensor) in sensors.iter().enumerate() {
        Sensors::new(rod.parts.dynamics()?, interval, &[of_rod(sensor)]).map_err(|e| {
            let key = match e {
                varda_rod::Error::NoRates => "time.integrator".to_string(),
                varda_rod::Error::NoFrames | varda_rod::Error::NoAngle => {
                    format!("observations.sensors.{i}.kind")
                }
                _ => format!("observations.sensors.{i}.arc_length"),
            };
            file.invalid(&key, e.to_string())
        })?;
    }
    let all: Rc<[varda_rod::Sensor]> = sensors.iter().map(of_rod).collect();
    let (parts, models, rotations) = (rod.parts.clone(), rod.models(), Rc::clone(rotations));
    Ok(Box::new(move || {
        let mut operator = Sensors::new(parts.dynamics()?, interval, &all)?;
        for (sensor, read) in rotations.get().into_iter().flat_map(Rotations::all) {
            operator = operator.measured_from(sensor, read.clone());
        }
        let places = (!parts.estimates.is_empty()).then(|| parts.places()).transpose()?;
        Ok(with_constants(operator, places, parts.estimates.seen.of_sensors(), &[], &models))
    }))
}

/// What a file of readings says, in the model's time: rows with the header `time_s,sensor` and the columns of
/// the kinds of sensors, optionally `sigma`; of a shape at rest without `time_s`.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub(super) fn recorded(
    (file, text): (&str, &str),
    timed: bool,
    clock: &Clock,
    left: &mut LeftOut,
) -> Result<Readings, Error> {
    let sensors = &clock.recording.sensors;
    let mut known = vec!["sensor", "sigma"];
    known.extend(SensorKind::ALL.iter().flat_map(|kind| kind.columns()));
    let mut needed = Vec::new();
    for columns in sensors.iter().map(|sensor| sensor.kind.columns()) {
        if !needed.contains(&columns) {
            needed.push(columns);
        }
    }
    let time = if timed { "time_s," } else { "" };
    known.extend(timed.then_some("time_s"));
    let expected = format!("{time}sensor,{}, optionally sigma", needed.concat().join(","));
    let mut table = Table::open(file, text, &known, &expected)?;
    for name in known.iter().filter(|name| ["time_s", "sensor"].contains(name)) {
        table.require(name, &expected)?;
    }
    needed.iter().flat_map(|columns| columns.iter()).try_for_each(|name| table.require(name, &expected))?;
    let (mut rows, mut finest) = (Vec::new(), f64::INFINITY);
    while table.next()? {
        if timed {
            finest = finest.min(table.last_digit("time_s"));
        }
        let line = table.line();
        let name = table.cell("sensor");
        let Some(site) = sensors.iter().position(|sensor| sensor.name == name) else {
            let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
            let message =
                format!("sensor {name:?} is none of [[observations.sensors]]: {}", names.join(", "));
            return Err(table.bad(line, message));
        };
        let (kind, columns) = (sensors[site].kind, sensors[site].kind.columns());
        let others = needed.iter().filter(|other| **other != columns).flat_map(|other| other.iter());
        if let Some(other) = others.into_iter().find(|other| !table.cell(other).is_empty()) {
            let (kind, columns) = (kind.name(), columns.join(", "));
            let message = format!("`{other}` of sensor {name:?}, whose kind {kind} has {columns}");
            return Err(table.bad(line, message));
        }
        let sigma = table.number("sigma")?;
        if let Some(sigma) = sigma.filter(|s| !(*s > 0.0)) {
            return Err(table.bad(line, format!("`sigma` = {sigma} must be greater than 0")));
        }
        let sigma = sigma.or(sensors[site].sigma).ok_or_else(|| {
            table.bad(line, "no standard deviation: fill `sigma`, or give the sensor's `sigma`")
        })?;
        let values = columns.iter().map(|column| table.number(column)).collect::<Result<Vec<_>, Error>>()?;
        rows.push((line, if timed { table.needed("time_s")? } else { 0.0 }, site, values, sigma));
    }
    if rows.is_empty() {
        return Err(table.bad(1, "holds no readings"));
    }
    let (mut readings, mut repeated) = (Readings::default(), HashSet::new());
    let rounding = if timed { 0.5 * finest } else { 0.0 };
    // the last rotation of each sensor in the file, and how far it has turned there
    let mut turned: HashMap<usize, (UnitQuaternion<f64>, Vector3<f64>)> = HashMap::new();
    for (line, time, site, values, sigma) in rows {
        let bad = |message: String| Error::Data { place: format!("{file}:{line}"), message };
        let kind = sensors[site].kind;
        let rotation = rotations::read(kind, &values).map_err(bad)?;
        let position: [Option<f64>; 3] = match rotation {
            Some(q) if kind == SensorKind::Orientation => {
                let (before, sum) = turned.entry(site).or_insert((q, Vector3::zeros()));
                *sum += (before.inverse() * q).scaled_axis();
                *before = q;
                sum.map(Some).into()
            }
            _ => std::array::from_fn(|c| values.get(c).copied().flatten()),
        };
        readings.times.push(time);
        readings.recorded.push(Recorded { time, site, position, sigma });
        let Some(at) = clock.place(time, rounding, left).map_err(bad)? else { continue };
        if !repeated.insert((site, time.to_bits(), position.map(|v| v.map(f64::to_bits)))) {
            left.repeated += 1;
            continue;
        }
        let values = match (kind.is_rotation(), rotation) {
            (false, _) => values,
            (true, None) => vec![None; kind.values()],
            (true, Some(q)) => {
                let t = clock.grid.start + at * clock.grid.step;
                let (_, rows) = readings.rotations.entry(site).or_insert_with(|| (kind, Rows::new()));
                if rows.iter().any(|(other, _)| *other == t) {
                    let (name, kind) = (&sensors[site].name, kind.name());
                    return Err(bad(format!("sensor {name:?} reads a second {kind} at this time")));
                }
                rows.push((t, q));
                vec![Some(0.0); kind.values()]
            }
        };
        readings.seen.push(Seen { site, step: at.floor() as usize, weight: at.fract(), values, sigma });
    }
    Ok(readings)
}
