//! From `[algorithm.ensemble]` to the members and their localization.

use varda_assimilation::ObservationSet;
use varda_covariance::{Covariance, Ensemble, Localization, sample};
use varda_implicit::line::Line;

use crate::Error;
use crate::scene::{self, SceneFile};
use crate::setup::covariance::{line_distance, taper};
use crate::setup::random::{Stream, stream};

/// Eigenvalues of a localization below this fraction of the largest are left out: its rank is a factor of the control's length.
const TRUNCATION: f64 = 0.01;

/// Where the components of a control are.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// Nowhere: lorenz63's three variables.
    Nowhere,
    /// On a ring of n, a distance of 1 apart.
    Ring(usize),
    /// On a line, or on the circle it closes to.
    Line(Line),
    /// At arc lengths \[m\] of a rod: three coordinates a vertex, positions before velocities.
    Rod(Vec<f64>),
}

impl Geometry {
    /// Distance of components i and j of the control.
    fn distance(&self, i: usize, j: usize) -> f64 {
        match self {
            Geometry::Nowhere => 0.0,
            Geometry::Ring(n) => i.abs_diff(j).min(n - i.abs_diff(j)) as f64,
            Geometry::Line(line) => line_distance(line, i, j),
            Geometry::Rod(s) => (s[(i / 3) % s.len()] - s[(j / 3) % s.len()]).abs(),
        }
    }

    /// The component of the control nearest to arc length s of a rod.
    pub(crate) fn nearest(&self, s: f64) -> usize {
        let Geometry::Rod(places) = self else { return 0 };
        let off = |i: &usize| (places[*i] - s).abs();
        3 * (0..places.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }
}

/// The ensemble of a scene: members drawn from N(x_b, B), inflated.
///
/// # Errors
/// [`Error::Scene`] for a localization that is no covariance over these distances.
pub fn draw(
    file: &SceneFile,
    ensemble: &scene::Ensemble,
    background: &[f64],
    covariance: &dyn Covariance,
    geometry: &Geometry,
) -> Result<Ensemble, Error> {
    let n = background.len();
    let path = "algorithm.ensemble.localization_length";
    let localization = match ensemble.localization_length {
        None => Localization::none(n),
        Some(_) => {
            let shape = ensemble.taper.unwrap_or(scene::Taper::GaspariCohn);
            let taper = taper(shape, ensemble.localization_length);
            Localization::by_distance(taper, n, |i, j| geometry.distance(i, j), TRUNCATION)
                .map_err(|e| file.invalid(path, e.to_string()))?
        }
    };
    let mut rng = stream(file.scene.seed, Stream::Ensemble);
    let mut members = Vec::with_capacity(ensemble.members * n);
    for _ in 0..ensemble.members {
        let error = sample(covariance, &mut rng);
        members.extend(background.iter().zip(&error).map(|(x, e)| x + ensemble.inflation * e));
    }
    Ensemble::new(&members, localization).map_err(|e| file.invalid("algorithm.ensemble", e.to_string()))
}

/// For every stacked row of `observations` the component of the control at whose place it was measured; `by_row` has it for every row
/// of the operator.
pub fn anchors(observations: &ObservationSet, by_row: &[usize]) -> Vec<usize> {
    observations.observations().iter().flat_map(|o| o.rows.iter().map(|&row| by_row[row])).collect()
}
