//! The data beside the model, before anything is minimized: what `varda check` prints, and what `varda run`
//! says in short before it starts.

mod background;
mod early;
mod finding;
mod localization;
mod numerics;
mod recording;
mod values;

pub use background::Misfit;
pub use finding::{Finding, Severity};
pub use numerics::{MeshEffect, ModeDamping, enough_segments, numerical_damping, numerical_slowing};

use serde::Serialize;

use crate::Error;
use crate::outcome::{Quantity, RecordingSummary};
use crate::scene::SceneFile;
use crate::setup::finer::{Finer, finer};
use crate::setup::observations::Seen;
use crate::setup::{Inputs, Plan};

/// What can be said of a scene without a minimization: one forward run, and two equilibria of a rod at most.
///
/// ```
/// use varda::preview::Preview;
/// use varda::scene::SceneFile;
///
/// let preview = Preview::new(&SceneFile::open("hanging-rod-case1", &["time.window=20".into()])?)?;
/// assert!(preview.modes[0].frequency > 0.5 && preview.recording.is_none());
/// let odd = Preview::new(&SceneFile::open("lorenz96", &["observations.sigma=100.0".into()])?)?;
/// assert_eq!(odd.findings[0].place, "observations.sigma");
/// # Ok::<(), varda::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Preview {
    /// Sizes and memory.
    pub plan: Plan,
    /// What the recording holds, of a scene with one.
    pub recording: Option<RecordingSummary>,
    /// How far the background is from what was seen, of a recording.
    pub misfit: Option<Misfit>,
    /// The slowest modes of a rod, and what damps them.
    pub modes: Vec<ModeDamping>,
    /// What a mesh of half the segments' length does to a rod at rest.
    pub mesh: Option<MeshEffect>,
    /// Seconds that a run may take, from and to, by the forward run.
    pub seconds: [f64; 2],
    /// What looks wrong, errors first.
    pub findings: Vec<Finding>,
}

impl Preview {
    /// Looks at a scene and its files.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`](crate::setup::Problem::from_scene); [`Error::Model`] where the
    /// forward run fails.
    pub fn new(file: &SceneFile) -> Result<Preview, Error> {
        Preview::of(Inputs::read(file)?)
    }

    /// The same of inputs that were read.
    ///
    /// # Errors
    /// As for [`Preview::new`].
    pub fn of(inputs: Inputs) -> Result<Preview, Error> {
        let file = inputs.file.clone();
        let plan = Plan::of(&inputs)?;
        let mut findings = findings(&inputs);
        let recording = inputs.observed.recording.clone();
        // a twin has the mesh of its truth
        let of_places = |s: &&Seen| inputs.observed.sites[s.site].quantity == Quantity::Place;
        let seen = inputs.observed.seen.iter().filter(|_| recording.is_some()).filter(of_places);
        let finest = seen.map(|s| s.sigma).reduce(f64::min);
        let (grid, control) = (inputs.grid, plan.n_control);
        let window = grid.step * file.scene.time.window as f64;
        let forward = background::run(inputs)?;
        let (mut modes, mut mesh) = (Vec::new(), None);
        if let Some((parts, first)) = &forward.rod {
            let (rest, t) = match first {
                Some((rest, t)) => (rest.clone(), *t),
                None => (parts.at_rest(grid.start)?, grid.start),
            };
            if !parts.at_rest_always {
                modes = numerics::damping(parts, &rest, t, grid.step);
                findings.extend(numerics::too_much(&modes, window));
            }
            // a finer mesh may have no equilibrium that is found from this one: then nothing is said of it
            mesh = numerics::halved(&file, parts, &rest, t).ok();
            findings
                .extend(mesh.as_ref().and_then(|m| numerics::too_coarse(m, parts.rod.segments(), finest)));
        }
        findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
        let again = match file.checked(finer(&file))? {
            Finer::Scene(finer) if recording.is_some() => finer.work,
            _ => 0.0,
        };
        let seconds = background::expected_seconds(&file.scene, forward.seconds, control);
        let seconds = seconds.map(|s| (1.0 + again) * s);
        let misfit = forward.misfit;
        Ok(Preview { plan, recording, misfit, modes, mesh, seconds, findings })
    }

    /// Whether a run makes no sense.
    pub fn has_errors(&self) -> bool {
        self.findings.iter().any(|f| f.severity == Severity::Error)
    }
}

/// What looks wrong in a scene and its files, without a run: the values and the recording.
pub fn findings(inputs: &Inputs) -> Vec<Finding> {
    let scene = &inputs.file.scene;
    let mut found = values::values(scene);
    found.extend(early::reading(inputs));
    found.extend(localization::too_short(scene, inputs.grid.step * scene.time.window as f64));
    if let Some(recording) = &inputs.observed.recording {
        let of_recording = recording::of_recording(recording, inputs.grid.step);
        let new = |f: &Finding| !found.iter().any(|known| known.place == f.place);
        let new: Vec<Finding> = of_recording.into_iter().filter(new).collect();
        found.extend(new);
    }
    found.sort_by_key(|f| std::cmp::Reverse(f.severity));
    found
}
