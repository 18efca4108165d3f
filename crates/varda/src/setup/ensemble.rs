//! From `[algorithm.ensemble]` to the members and their localization.

use varda_assimilation::ObservationSet;
use varda_covariance::{Covariance, Ensemble, Localization, sample};
use varda_implicit::line::Line;

use crate::Error;
use crate::scene::{self, SceneFile};
use crate::setup::covariance::line_distance;
use crate::setup::random::{Stream, stream};

/// Eigenvalues of a localization below this fraction of the largest are left out: the length of the control
/// is proportional to its rank.
const TRUNCATION: f64 = 0.01;

/// Most numbers of the members of an analysis that are kept for files of other formats.
const MEMBER_NUMBERS: usize = 4_000_000;

/// The steps at which members of an analysis are kept: all, or the first and the last where that would be too
/// many numbers.
pub(crate) fn steps_of_members(count: usize, last: usize, state: usize) -> Vec<usize> {
    match last == 0 || count.saturating_mul(last + 1).saturating_mul(state) <= MEMBER_NUMBERS {
        true => (0..=last).collect(),
        false => vec![0, last],
    }
}

/// Where the components of a control are.
#[derive(Debug, Clone, PartialEq)]
pub enum ComponentPositions {
    /// Without places: lorenz63's three variables.
    Nowhere,
    /// On a ring of n, a distance of 1 apart.
    Ring(usize),
    /// On a line, or on the circle it closes to.
    Line(Line),
    /// At arc lengths \[m\] of a rod, one for every component.
    Rod(Vec<f64>),
}

impl ComponentPositions {
    /// How far they reach, in the unit of their distances.
    pub(crate) fn extent(&self) -> f64 {
        match self {
            ComponentPositions::Nowhere => 0.0,
            ComponentPositions::Ring(n) => *n as f64,
            ComponentPositions::Line(line) => line.length,
            ComponentPositions::Rod(s) => {
                let [first, last] =
                    [f64::min, f64::max].map(|of| s.iter().copied().reduce(of).unwrap_or(0.0));
                last - first
            }
        }
    }

    /// Distance of components i and j of the control.
    fn distance(&self, i: usize, j: usize) -> f64 {
        match self {
            ComponentPositions::Nowhere => 0.0,
            ComponentPositions::Ring(n) => i.abs_diff(j).min(n - i.abs_diff(j)) as f64,
            ComponentPositions::Line(line) => line_distance(line, i, j),
            ComponentPositions::Rod(s) => (s[i] - s[j]).abs(),
        }
    }
}

/// The ensemble of a scene: members drawn from N(x_b, B), inflated.
///
/// # Errors
/// [`Error::Scene`] for a localization that is not a covariance for these distances.
pub fn draw(
    file: &SceneFile,
    ensemble: &scene::Ensemble,
    background: &[f64],
    covariance: &dyn Covariance,
    positions: &ComponentPositions,
) -> Result<Ensemble, Error> {
    let n = background.len();
    let path = "algorithm.ensemble.localization_length";
    let localization = match file.checked(ensemble.localization())? {
        None => Localization::none(n),
        Some(taper) => Localization::by_distance(taper, n, |i, j| positions.distance(i, j), TRUNCATION)
            .map_err(|e| file.invalid(path, e.to_string()))?,
    };
    let mut rng = stream(file.scene.seed, Stream::Ensemble);
    let mut members = Vec::with_capacity(ensemble.members * n);
    for _ in 0..ensemble.members {
        let error = sample(covariance, &mut rng);
        members.extend(background.iter().zip(&error).map(|(x, e)| x + ensemble.inflation * e));
    }
    Ensemble::new(&members, localization).map_err(|e| file.invalid("algorithm.ensemble", e.to_string()))
}

/// For every stacked row of `observations` the component of the control at whose place it was measured;
/// `by_row` has it for every row of the operator.
pub fn anchors(observations: &ObservationSet, by_row: &[usize]) -> Vec<usize> {
    observations.observations().iter().flat_map(|o| o.rows.iter().map(|&row| by_row[row])).collect()
}
