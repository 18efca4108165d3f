//! How the supports of a rod move: from keys and recordings to motions of varda-rod.

use std::f64::consts::TAU;
use std::sync::Arc;

use varda_rod::{EllipseDrive, Matrix3, Motion, Smoothing, Vector3, noise_of_rows};

use super::csv;
use super::files::Files;
use crate::Error;
use crate::scene::{self, MotionValues};

/// Reads motions; keeps what there is to say of them.
pub(super) struct Motions<'a> {
    files: &'a Files<'a>,
    /// First and last model time of a run \[s\].
    run: [f64; 2],
    pub(super) remarks: Vec<String>,
}

impl<'a> Motions<'a> {
    pub(super) fn of(files: &'a Files<'a>) -> Result<Self, Error> {
        let grid = files.scene.grid()?;
        // The truth of a twin experiment runs from 0 on.
        let first = if files.scene.scene.time.spin_up > 0 { 0.0 } else { grid.start };
        Ok(Motions { files, run: [first, grid.time(grid.last_step())], remarks: Vec::new() })
    }

    /// The motion of a support at `position` that the key `path` describes.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key, or the error of the file.
    pub(super) fn read(
        &mut self,
        path: &str,
        position: [f64; 3],
        motion: Option<&scene::Motion>,
    ) -> Result<Arc<dyn Motion>, Error> {
        Ok(match motion {
            None => Arc::new(position),
            Some(&scene::Motion::Ellipse { radii, omega, ramp_periods }) => Arc::new(EllipseDrive {
                centre: position.into(),
                radii,
                omega,
                ramp: ramp_periods * TAU / omega,
            }),
            Some(scene::Motion::Table(keys)) => Arc::new(self.recorded(path, position.into(), keys)?),
        })
    }

    fn recorded(
        &mut self,
        path: &str,
        position: Vector3<f64>,
        keys: &scene::RecordedMotion,
    ) -> Result<varda_rod::RecordedMotion, Error> {
        let key = format!("{path}.motion.file");
        let (label, text) = self.files.text(&key, &keys.file)?;
        let rows = csv::numbers(&label, &text, ["time_s", "x_m", "y_m", "z_m"])?;
        let times: Vec<f64> = rows.iter().map(|row| row[0] - keys.time_zero).collect();
        let (Some(first), Some(last)) = (times.first(), times.last()) else {
            return Err(self.files.scene.invalid(&key, format!("{label} has no rows")));
        };
        if let Some(at) = times.windows(2).position(|w| !(w[0] < w[1])) {
            let message =
                format!("{label}, row {}: time_s = {} is not after the row before", at + 2, rows[at + 1][0]);
            return Err(self.files.scene.invalid(&key, message));
        }
        let [from, to] = self.run;
        // Rounding of the file's times.
        let slack = 1e-6 * (last - first).max(to - from);
        if *first > from + slack || *last < to - slack {
            let message = format!(
                "{label} has rows from {first} to {last} s of the model's clock, and the run needs {from} to \
                 {to} s: set {path}.motion.time_zero (now {}), the window or report.forecast",
                keys.time_zero
            );
            return Err(self.files.scene.invalid(&key, message));
        }
        let frame = &keys.frame;
        // nalgebra takes the rows for columns.
        let turn = Matrix3::from(frame.rotation_rows()).transpose();
        let origin = match keys.values {
            MotionValues::Displacement => position,
            MotionValues::Absolute => frame.translation.into(),
        };
        let places: Vec<_> = rows.iter().map(|&[_, x, y, z]| origin + turn * Vector3::new(x, y, z)).collect();
        let refused = |e: varda_rod::Error| Error::Data { place: label.clone(), message: e.to_string() };
        if keys.sigma.map_or_else(|| noise_of_rows(&times, &places).is_none(), |sigma| sigma == 0.0) {
            return varda_rod::RecordedMotion::through(&times, &places).map_err(refused);
        }
        let smooth = varda_rod::RecordedMotion::smoothed(&times, &places, keys.sigma).map_err(refused)?;
        if let Some(Smoothing { sigma, cut_off }) = smooth.smoothing() {
            let whose = if keys.sigma.is_some() { "given" } else { "found in its rows" };
            self.remarks.push(format!(
                "jitter of the recorded motion {label}: what is faster than {cut_off:.3} Hz, by \
                 σ = {sigma:.2e} m {whose} ({path}.motion.sigma = 0 follows every row)"
            ));
        }
        Ok(smooth)
    }
}
