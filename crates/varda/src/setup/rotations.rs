//! What sensors of directions and orientations have read: rotations that their values are angles from.
//!
//! Such a value has no meaning without the reading that it is measured from, and is zero for the reading
//! itself: residuals are rotation vectors, however far apart two rotations are.

use std::collections::HashMap;

use varda_rod::{Quaternion, ReadRotations, UnitQuaternion, Vector3, tilt};

use crate::scene::SensorKind;

/// Model times \[s\] and rotations.
pub(super) type Rows = Vec<(f64, UnitQuaternion<f64>)>;

/// What the sensors of a scene have read of rotations.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rotations {
    /// The site of the first sensor.
    first: usize,
    read: HashMap<usize, (SensorKind, ReadRotations)>,
}

/// How far the length of a quaternion or a direction in a file may be from 1: three digits or more.
const LENGTH: f64 = 0.01;

impl SensorKind {
    /// Whether its values are angles from what was read.
    pub(super) fn is_rotation(self) -> bool {
        matches!(self, SensorKind::Direction | SensorKind::Orientation)
    }
}

impl Rotations {
    /// Of the kinds and rows of sensors, whose sites begin with `first`.
    pub(super) fn new(first: usize, read: HashMap<usize, (SensorKind, Rows)>) -> Rotations {
        let of = |(sensor, (kind, mut rows)): (usize, (SensorKind, Rows))| {
            rows.sort_by(|a, b| a.0.total_cmp(&b.0));
            if kind == SensorKind::Direction {
                carry(&mut rows);
            }
            (sensor, (kind, ReadRotations::new(rows)))
        };
        Rotations { first, read: read.into_iter().map(of).collect() }
    }

    /// The sensors that have read some, with these.
    pub(super) fn all(&self) -> impl Iterator<Item = (usize, &ReadRotations)> {
        self.read.iter().map(|(sensor, (_, rows))| (*sensor, rows))
    }

    fn of_site(&self, site: usize) -> Option<&(SensorKind, ReadRotations)> {
        self.read.get(&site.checked_sub(self.first)?)
    }

    /// The cells that a sensor wrote at a time \[s\]; `None` for another site.
    pub(super) fn cells(&self, site: usize, t: f64) -> Option<Vec<f64>> {
        let (kind, rows) = self.of_site(site)?;
        let q = rows.nearest(t);
        Some(match kind {
            SensorKind::Direction => (q * Vector3::z()).as_slice().to_vec(),
            _ => q.coords.as_slice().to_vec(),
        })
    }

    /// A value of a site that is measured from what it read at one time \[s\], from what it read at another.
    pub(crate) fn carried(&self, site: usize, value: &[f64], [from, to]: [f64; 2]) -> Vec<f64> {
        let Some((kind, rows)) = self.of_site(site) else { return value.to_vec() };
        let (there, here) = (rows.nearest(from) * turned_by(*kind, value), rows.nearest(to));
        match kind {
            SensorKind::Direction => {
                tilt(&here.to_rotation_matrix().into_inner(), &(there * Vector3::z())).as_slice().to_vec()
            }
            _ => (here.inverse() * there).scaled_axis().as_slice().to_vec(),
        }
    }
}

/// The rotation by the angles that are a value.
fn turned_by(kind: SensorKind, value: &[f64]) -> UnitQuaternion<f64> {
    match kind {
        // towards the first axis about the second, towards the second about the first, backwards
        SensorKind::Direction => UnitQuaternion::from_scaled_axis(Vector3::new(-value[1], value[0], 0.0)),
        _ => UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(value)),
    }
}

/// What a twin reads: rotations measured from the model's axes at ascending times \[s\], with errors.
pub(super) fn drawn(kind: SensorKind, truth: &[(f64, &[f64])], errors: &[&[f64]]) -> Rows {
    let mut rows: Vec<_> = truth.iter().map(|(t, value)| (*t, turned_by(kind, value))).collect();
    if kind == SensorKind::Direction {
        carry(&mut rows);
    }
    rows.iter_mut().zip(errors).for_each(|((_, q), error)| *q *= turned_by(kind, error));
    rows
}

/// Turns axes about the third one so that they are carried along from row to row.
fn carry(rows: &mut [(f64, UnitQuaternion<f64>)]) {
    for i in 1..rows.len() {
        let (before, t) = (rows[i - 1].1, rows[i].1 * Vector3::z());
        rows[i].1 = shortest(before * Vector3::z(), t) * before;
    }
}

/// The rotation by the smallest angle that takes one unit vector into another.
fn shortest(a: Vector3<f64>, b: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&a, &b).unwrap_or_else(|| {
        // opposite to it: about any axis across
        let across = if a.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }.cross(&a);
        UnitQuaternion::from_scaled_axis(across.normalize() * std::f64::consts::PI)
    })
}

/// The rotation of a row; `None` where its cells are empty.
///
/// # Errors
/// What is wrong with it.
pub(super) fn read(kind: SensorKind, cells: &[Option<f64>]) -> Result<Option<UnitQuaternion<f64>>, String> {
    if !kind.is_rotation() || cells.iter().all(Option::is_none) {
        return Ok(None);
    }
    let columns = kind.columns().join(", ");
    let Some(values) = cells.iter().copied().collect::<Option<Vec<f64>>>() else {
        return Err(format!("({columns}) is one reading: fill all of its cells, or none"));
    };
    let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !((length - 1.0).abs() <= LENGTH) {
        return Err(format!("({columns}) has length {length}: that of a rotation is 1"));
    }
    Ok(Some(match values[..] {
        [x, y, z, w] => UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
        _ => shortest(Vector3::z(), Vector3::from_column_slice(&values) / length),
    }))
}
