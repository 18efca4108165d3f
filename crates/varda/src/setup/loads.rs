//! What pulls at a rod: from keys and recordings to the loads of varda-rod.

use std::sync::Arc;

use varda_rod::{Drag, FollowerForce, Load, Loads, Moment, Motion, Rod, Vector3};

use super::motion::Motions;
use crate::Error;
use crate::scene::{Frame, RodModel, SceneFile};

/// The loads of a scene, and the sum of the largest sizes of its forces \[N\].
///
/// # Errors
/// [`Error::Scene`] pointing at the key, or the error of a file.
pub(super) fn loads(
    file: &SceneFile,
    motions: &mut Motions,
    model: &RodModel,
    rod: &Rod,
) -> Result<(Loads, f64), Error> {
    let mut loads = Loads { gravity: model.gravity.into(), ..Loads::default() };
    let mut pull = 0.0;
    for (i, keys) in model.forces.iter().enumerate() {
        let path = format!("model.forces.{i}");
        let columns = match keys.follower {
            false => ["time_s", "fx_n", "fy_n", "fz_n"],
            true => ["time_s", "f1_n", "f2_n", "ft_n"],
        };
        let of =
            Of { path: &path, file: keys.file.as_deref(), time_zero: keys.time_zero, frame: &keys.frame };
        let force = of.vector(motions, keys.force, columns)?;
        pull += force.rows.iter().fold(0.0, |most: f64, row| most.max(row.norm()));
        if !keys.follower {
            loads.point_forces.push((keys.arc_length, force.motion));
            continue;
        }
        let refuse = |e: varda_rod::Error| file.invalid(&path, e.to_string());
        let motion = force.motion;
        let follower = if force.rows.iter().all(|f| f.x == 0.0 && f.y == 0.0) {
            FollowerForce::tangential(rod, keys.arc_length, move |t: f64| motion.at(t).z)
        } else {
            FollowerForce::new(rod, keys.arc_length, move |t: f64| motion.at(t))
        };
        loads.of_motion.push(Arc::new(follower.map_err(refuse)?));
    }
    for (i, keys) in model.moments.iter().enumerate() {
        let path = format!("model.moments.{i}");
        let refuse = |e: varda_rod::Error| file.invalid(&path, e.to_string());
        let of =
            Of { path: &path, file: keys.file.as_deref(), time_zero: keys.time_zero, frame: &keys.frame };
        let moment = match (keys.twist, keys.file.as_deref()) {
            (Some(twist), _) => Moment::about_tangent(rod, keys.arc_length, move |_| twist),
            (None, Some(name)) if motions.has_column(&of.key(), name, "twist_nm")? => {
                let motion =
                    of.recorded(motions, name, ["time_s", "twist_nm"], |[_, m]| [0.0, 0.0, m])?.motion;
                Moment::about_tangent(rod, keys.arc_length, move |t: f64| motion.at(t).z)
            }
            (None, _) => {
                let columns = ["time_s", "mx_nm", "my_nm", "mz_nm"];
                let motion = of.vector(motions, keys.moment, columns)?.motion;
                Moment::new(rod, keys.arc_length, move |t: f64| motion.at(t))
            }
        };
        loads.of_motion.push(Arc::new(moment.map_err(refuse)?));
    }
    if let Some(keys) = &model.drag {
        let drag = Drag {
            fluid_density: keys.fluid_density,
            diameter: keys.diameter,
            normal: keys.normal,
            tangential: keys.tangential,
            flow: keys.flow.into(),
        };
        drag.check(rod).map_err(|e| file.invalid("model.drag", e.to_string()))?;
        let coefficient = drag.normal.max(drag.tangential);
        let pressure = 0.5 * drag.fluid_density * drag.flow.norm_squared();
        pull += pressure * drag.diameter * coefficient * rod.length();
        loads.of_motion.push(Arc::new(drag));
    }
    Ok((loads, pull))
}

/// The keys of a load that is given, or recorded.
struct Of<'a> {
    path: &'a str,
    file: Option<&'a str>,
    time_zero: f64,
    frame: &'a Frame,
}

/// A vector in time, and its rows.
struct Given {
    motion: Arc<dyn Motion>,
    rows: Vec<Vector3<f64>>,
}

impl Of<'_> {
    fn key(&self) -> String {
        format!("{}.file", self.path)
    }

    /// What is given, or the rows of the file.
    fn vector(
        &self,
        motions: &mut Motions,
        given: Option<[f64; 3]>,
        columns: [&str; 4],
    ) -> Result<Given, Error> {
        match self.file {
            Some(name) => self.recorded(motions, name, columns, |[_, x, y, z]| [x, y, z]),
            None => {
                let vector = Vector3::from(given.unwrap_or_default());
                Ok(Given { motion: Arc::new(vector), rows: vec![vector] })
            }
        }
    }

    fn recorded<const N: usize>(
        &self,
        motions: &mut Motions,
        name: &str,
        columns: [&str; N],
        of_row: impl Fn([f64; N]) -> [f64; 3],
    ) -> Result<Given, Error> {
        let turn = varda_rod::Matrix3::from(self.frame.rotation_rows()).transpose();
        let vector = |row| (turn * Vector3::from(of_row(row))).into();
        let (motion, rows) = motions.straight(self.path, name, self.time_zero, columns, vector)?;
        Ok(Given { motion: Arc::new(motion), rows })
    }
}
