//! Correlated errors of what was seen: chains of values along the rod or line, or in time.

use std::collections::BTreeMap;
use std::ops::Range;

use varda_covariance::Kernel;

use super::covariance::kernel;
use crate::Error;
use crate::scene::{Along, SceneFile, TimeGrid};

/// How errors are correlated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ErrorKernel {
    along: Along,
    pub(super) kernel: Kernel,
}

impl ErrorKernel {
    /// Of `[observations.correlation]`; `None` without it.
    ///
    /// # Errors
    /// [`Error::Scene`] where the keys do not say one length.
    pub(super) fn of_scene(file: &SceneFile) -> Result<Option<ErrorKernel>, Error> {
        let Some(keys) = file.scene.observations.correlation() else { return Ok(None) };
        let along = file.checked(keys.along())?;
        let (Along::Length(length) | Along::Time(length)) = along;
        Ok(Some(ErrorKernel { along, kernel: kernel(keys.kernel, length) }))
    }
}

/// The chains of what was seen.
pub(super) struct Chains {
    by: ErrorKernel,
    /// The number of each time, by step and weight.
    times: BTreeMap<(usize, u64), usize>,
    step: f64,
}

impl Chains {
    /// Those of values at these times, a step and a fraction of the way to the next.
    pub(super) fn of(by: ErrorKernel, times: impl Iterator<Item = (usize, f64)>, grid: &TimeGrid) -> Chains {
        let mut times: BTreeMap<(usize, u64), usize> = times.map(|(k, w)| ((k, w.to_bits()), 0)).collect();
        times.values_mut().enumerate().for_each(|(i, time)| *time = i);
        Chains { by, times, step: grid.step }
    }

    /// The chain of some axes of a site at a time, and their place there. `rows` are those of the site.
    pub(super) fn entries(
        &self,
        (step, weight): (usize, f64),
        rows: Range<usize>,
        place: Option<f64>,
        axes: &[usize],
    ) -> Vec<(usize, f64)> {
        let entry = |axis: &usize| match self.by.along {
            Along::Time(_) => (rows.start + axis, (step as f64 + weight) * self.step),
            Along::Length(_) => {
                let time = self.times[&(step, weight.to_bits())];
                (rows.len() * time + axis, place.unwrap_or(0.0))
            }
        };
        axes.iter().map(entry).collect()
    }
}
