//! Everything that a scene and its files say, read once, before anything is run.

use super::files::{Files, InputFile};
use super::observations::Observed;
use super::system::System;
use super::{component_observations, rod_observations};
use crate::Error;
use crate::scene::{BackgroundSource, Observations, SceneFile, TimeGrid};

/// A scene and its files, read.
pub struct Inputs {
    /// The scene.
    pub file: SceneFile,
    /// The scene with the whole sequence of `[algorithm.cycles]` as its window.
    pub(crate) one_window: SceneFile,
    /// The grid of that window.
    pub grid: TimeGrid,
    /// What is modelled.
    pub system: System,
    /// What is observed; values of a twin experiment are not drawn yet.
    pub observed: Observed,
    /// What is wrong with a recording, where only a forward run is wanted; nothing is then observed.
    pub fault_of_observations: Option<Error>,
    /// The background.
    pub(crate) background: KnownBackground,
    /// The files that were read.
    pub files: Vec<InputFile>,
}

/// The background, as far as it is known without a run.
pub(crate) enum KnownBackground {
    /// Drawn around the truth of a twin experiment.
    Drawn,
    /// Read from a file.
    Read(Vec<f64>),
    /// The static equilibrium of a rod, still to be computed.
    AtRest,
}

impl Inputs {
    /// Whether background and observations are to be drawn around a truth.
    pub(crate) fn is_twin(&self) -> bool {
        matches!(self.background, KnownBackground::Drawn)
    }

    /// Reads the files of a scene.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Data`] or [`Error::Scene`], naming the key or the line.
    pub fn read(file: &SceneFile) -> Result<Inputs, Error> {
        let inputs = Inputs::for_simulation(file)?;
        match inputs.fault_of_observations {
            Some(fault) => Err(fault),
            None => Ok(inputs),
        }
    }

    /// The same for a forward run, which needs no recording: a fault of the recording is kept beside.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Data`] or [`Error::Scene`], naming the key or the line.
    pub fn for_simulation(file: &SceneFile) -> Result<Inputs, Error> {
        if !file.recordings.is_empty() {
            let message = "several recordings are only assimilated (run) and checked, all at once; the scene \
                           without them: --set recordings=[]";
            return Err(file.invalid("recordings", message));
        }
        let one_window = file.as_one_window();
        let grid = one_window.grid()?;
        let files = Files::of(&one_window);
        let mut system = System::read(&files, grid)?;
        let (mut observed, fault_of_observations) = match (observed(&files, &system, grid), &system) {
            (Err(fault), System::Rod(rod)) => (rod_observations::none(&files, rod, grid)?, Some(fault)),
            (observed, _) => (observed?, None),
        };
        observed.correlate(&one_window, &grid)?;
        if system.estimates().seen.clock.is_some() && system.models()(0).rate().is_none() {
            let message = "a clock needs the velocities of steps, which this integrator does not have: \
                           \"bdf2\" or \"backward-euler\", or an explicit one";
            return Err(file.invalid("estimate.clock", message));
        }
        let background = background(&files, &mut system)?;
        let files = files.into_read();
        let file = file.clone();
        Ok(Inputs { file, grid, system, observed, fault_of_observations, background, files, one_window })
    }
}

/// The observations of a scene, by their kind and that of the model.
fn observed(files: &Files, system: &System, grid: TimeGrid) -> Result<Observed, Error> {
    let keys = &files.scene.scene.observations;
    match (system, keys) {
        (System::Rod(rod), Observations::Synthetic(keys)) => {
            rod_observations::synthetic(files, keys, rod, grid)
        }
        (System::Rod(rod), Observations::File(keys)) => rod_observations::recorded(files, keys, rod, grid),
        (System::Components(model), Observations::Synthetic(keys)) => {
            component_observations::synthetic(files, keys, model, grid)
        }
        (System::Components(model), Observations::File(keys)) => {
            component_observations::recorded(files, keys, model, grid)
        }
    }
}

fn background(files: &Files, system: &mut System) -> Result<KnownBackground, Error> {
    let keys = &files.scene.scene.background;
    match system {
        System::Rod(rod) => Ok(match files.scene.checked(keys.source())? {
            BackgroundSource::TruthPlusDraw => KnownBackground::Drawn,
            BackgroundSource::File(name) => KnownBackground::Read(rod.read_background(files, name)?),
            BackgroundSource::StaticEquilibrium => KnownBackground::AtRest,
        }),
        System::Components(model) => Ok(match files.scene.checked(keys.file_of_components())? {
            None => KnownBackground::Drawn,
            Some(name) => KnownBackground::Read(model.read_background(files, name)?),
        }),
    }
}
