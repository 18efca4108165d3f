//! A sequence of windows as one long window.

use super::{Method, Observations, SceneFile};

impl SceneFile {
    /// The scene whose only window is the whole sequence of `[algorithm.cycles]`; a scene without cycles as
    /// it is.
    ///
    /// Its truth is one run and its observations one draw in the order of time, so that more cycles do not
    /// change the first ones.
    pub fn as_one_window(&self) -> SceneFile {
        let mut file = self.clone();
        let Some(cycles) = file.scene.algorithm.cycles.take() else { return file };
        let window = file.scene.time.window;
        let shift = cycles.shift_of(window);
        file.scene.time.window = cycles.steps(window);
        if let Observations::Synthetic(synthetic) = &mut file.scene.observations
            && let Some(steps) = &mut synthetic.steps
        {
            let in_all = |c: usize| steps.iter().map(move |k| c * shift + k);
            let mut all: Vec<usize> = (0..cycles.count).flat_map(in_all).collect();
            all.sort_unstable();
            all.dedup();
            *steps = all;
        }
        if let Some(ensemble) = &mut file.scene.algorithm.ensemble {
            // Every window inflates its members, the first one too.
            ensemble.inflation = 1.0;
        }
        if file.scene.algorithm.method.is_of_one_instant() {
            // Each window observes one instant, the sequence many; what is built is the same.
            file.scene.algorithm.method = Method::FourDVar;
        }
        file
    }
}
