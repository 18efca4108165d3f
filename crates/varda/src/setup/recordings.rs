//! Several recordings of one system, each a problem of its own, and which constants they share.

use super::memory::LARGEST_DENSE_POSTERIOR;
use super::{Inputs, Problem};
use crate::Error;
use crate::scene::SceneFile;

/// What is between the seeds of two recordings: twins of one scene draw different numbers.
const SEEDS_APART: u64 = 1_000_003;

/// Several recordings of one system.
pub struct Recordings {
    /// The scene that has them.
    pub file: SceneFile,
    /// The problem of each; its scene has the keys of that recording.
    pub problems: Vec<Problem>,
    /// For each the places among its constants of those that all share.
    pub(crate) shared: Vec<Vec<usize>>,
}

impl Recordings {
    /// The recordings of a scene that has `[[recordings]]`. In a twin experiment the first draws what it
    /// would alone, and its draw of the shared constants is that of all.
    ///
    /// # Errors
    /// [`Error`] naming the key, the file's line, or the step; constants of `[estimate]` that are not the
    /// same in all recordings; recordings of which only some are a twin experiment.
    pub fn from_scene(file: &SceneFile) -> Result<Recordings, Error> {
        let mut problems = Vec::new();
        for inputs in Recordings::inputs(file)? {
            problems.push(Problem::new(inputs)?);
        }
        Recordings::of(file.clone(), problems)
    }

    /// What the scenes of the recordings and their files say.
    ///
    /// # Errors
    /// As for [`Inputs::read`].
    pub fn inputs(file: &SceneFile) -> Result<Vec<Inputs>, Error> {
        let count = file.recordings.len();
        if count == 0 {
            return Err(file.invalid("recordings", "the scene has no [[recordings]]"));
        }
        let limit = file.scene.limits.bytes().map_err(|message| file.invalid("limits.memory", message))?;
        let one = |(r, part): (usize, &SceneFile)| {
            let mut part = part.clone();
            part.scene.seed = part.scene.seed.wrapping_add(r as u64 * SEEDS_APART);
            part.scene.limits.memory = format!("{} B", (limit / count).max(1));
            Inputs::read(&part).map_err(|error| error.of_recording(&part.name))
        };
        file.recordings.iter().enumerate().map(one).collect()
    }

    /// The same from problems that were set up.
    ///
    /// # Errors
    /// As for [`from_scene`](Self::from_scene).
    pub(crate) fn of(file: SceneFile, mut problems: Vec<Problem>) -> Result<Recordings, Error> {
        let keys: Vec<&str> = file.scene.estimate.given().iter().map(|(key, _)| *key).collect();
        let of_all = |problem: &Problem| -> Vec<usize> {
            let constants = problem.system.estimates().constants.iter().enumerate();
            let key = |name: &str| name.split(['[', '.', '(']).next().unwrap_or_default().to_string();
            constants.filter(|(_, c)| keys.contains(&key(&c.name).as_str())).map(|(i, _)| i).collect()
        };
        let shared: Vec<Vec<usize>> = problems.iter().map(of_all).collect();
        let (first, rest) = problems.split_first_mut().ok_or_else(|| file.invalid("recordings", "none"))?;
        let of_first = &first.system.estimates().constants;
        for (r, (problem, mine)) in rest.iter_mut().zip(&shared[1..]).enumerate() {
            let constants = &problem.system.estimates().constants;
            let pair = |(a, b): (&usize, &usize)| (&of_first[*a], &constants[*b]);
            let unlike = shared[0].iter().zip(mine).map(pair).find(|(a, b)| a != b);
            if unlike.is_some() || mine.len() != shared[0].len() {
                let what = unlike.map_or("their number".to_string(), |(a, b)| {
                    format!("{} ({} ± {} and {} ± {})", a.name, a.value, a.sigma, b.value, b.sigma)
                });
                let path = format!("recordings.{}", r + 1);
                let message = format!(
                    "constants of [estimate] are the same in all recordings, and {what} is not; what differs \
                     belongs into the `estimate` of each recording"
                );
                return Err(file.invalid(&path, message));
            }
            if problem.truth.is_some() != first.truth.is_some() {
                let message = "some recordings are a twin experiment with a drawn background and others are \
                               not, and they share one prior: make all of them synthetic, or none";
                return Err(file.invalid(&format!("recordings.{}", r + 1), message));
            }
            if problem.truth.is_some() {
                let ends = [first.background.len(), problem.background.len()];
                let counts = [of_first.len(), constants.len()];
                for (a, b) in shared[0].iter().zip(mine) {
                    problem.background[ends[1] - counts[1] + b] = first.background[ends[0] - counts[0] + a];
                }
            }
        }
        let unknowns: usize = problems.iter().map(|problem| problem.experiment.n_unknown()).sum();
        if unknowns > LARGEST_DENSE_POSTERIOR {
            let message = format!(
                "{unknowns} unknowns in all: several recordings take at most {LARGEST_DENSE_POSTERIOR}; take \
                 fewer segments or recordings"
            );
            return Err(file.invalid("recordings", message));
        }
        Ok(Recordings { file, problems, shared })
    }
}
