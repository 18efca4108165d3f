//! The grid of time of a window.

use std::f64::consts::TAU;

use serde::Serialize;
use varda_implicit::At;

use super::invalid::{Either, Invalid, invalid, one_of};
use super::{Model, Scene};

/// Times of a window and its forecast: step k is at `start + k · step` seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TimeGrid {
    /// Model time at the start \[s\].
    pub start: f64,
    /// Δt \[s\].
    pub step: f64,
    /// Steps in the window.
    pub steps: usize,
    /// Steps of the forecast after the window.
    pub forecast: usize,
}

impl TimeGrid {
    /// The grid that `[time]` and `report.forecast` describe.
    pub(crate) fn of(scene: &Scene) -> Result<TimeGrid, Invalid> {
        let time = &scene.time;
        let step = match one_of("time", ("step", time.step), ("steps_per_period", time.steps_per_period))? {
            Either::First(step) => step,
            Either::Second(n) => {
                let omega = match &scene.model {
                    Model::Rod(rod) => rod.drive_frequency(),
                    _ => None,
                };
                let Some(omega) = omega else {
                    return invalid(
                        "time.steps_per_period",
                        "a period is that of the drive [model.start.motion] kind = \"ellipse\", which is not \
                         there",
                    );
                };
                TAU / (omega * n as f64)
            }
        };
        Ok(TimeGrid {
            start: time.spin_up as f64 * step,
            step,
            steps: time.window,
            forecast: (scene.report.forecast / step).round() as usize,
        })
    }

    /// Model time of step k \[s\].
    pub fn time(&self, k: usize) -> f64 {
        self.start + k as f64 * self.step
    }

    /// Times of all steps of the window and its forecast \[s\].
    pub fn times(&self) -> Vec<f64> {
        (0..=self.last_step()).map(|k| self.time(k)).collect()
    }

    /// Step k with its time, as observation operators want it.
    pub fn at(&self, k: usize) -> At {
        At { step: k, time: self.time(k) }
    }

    /// Times of the steps of the window, 0 … `steps` \[s\].
    pub fn times_of_window(&self) -> Vec<f64> {
        (0..=self.steps).map(|k| self.time(k)).collect()
    }

    /// The last step of the forecast; of the window, where there is none.
    pub fn last_step(&self) -> usize {
        self.steps + self.forecast
    }
}
