//! Where the components of a control and the observed rows are, for the localization of an ensemble.

use varda_assimilation::ObservationSet;
use varda_covariance::{Localization, Taper};

use crate::Error;
use crate::problem::{Problem, View};
use crate::scene::{self, Ensemble, Observations};

/// C of an ensemble: a taper of the distance along the rod \[m\], or around the ring in components.
///
/// # Errors
/// [`Error::Covariance`] for a taper that is no covariance for this distance.
pub(crate) fn localization(problem: &Problem, ensemble: &Ensemble) -> Result<Localization, Error> {
    let n = problem.control_dim();
    let Some(support) = ensemble.localization_length else { return Ok(Localization::none(n)) };
    let taper = match ensemble.taper.unwrap_or(scene::Taper::GaspariCohn) {
        scene::Taper::Triangle => Taper::Triangle { support },
        scene::Taper::GaspariCohn => Taper::GaspariCohn { support },
        scene::Taper::None => return Ok(Localization::none(n)),
    };
    let distance: Box<dyn Fn(usize, usize) -> f64> = match &problem.view {
        View::Rod(rod) => {
            let (s, free) = (rod.parts.rod.arc_lengths(), rod.dynamics.free_vertices());
            let place = move |i: usize| s[free[i % (n / 2) / 3]];
            Box::new(move |i, j| (place(i) - place(j)).abs())
        }
        View::Components(_) => Box::new(move |i, j| i.abs_diff(j).min(n - i.abs_diff(j)) as f64),
    };
    // Columns of the root beyond a hundredth of the largest change nothing that 40 members could tell.
    Ok(Localization::by_distance(taper, n, distance, 0.01)?)
}

/// The component of the control at (or, on a rod, next to) the place where each stacked row was measured.
pub(crate) fn anchors(problem: &Problem, set: &ObservationSet) -> Vec<usize> {
    let of_row: Vec<usize> = match (&problem.view, &problem.scene.observations) {
        (View::Rod(rod), _) => {
            let (s, free) = (rod.parts.rod.arc_lengths(), rod.dynamics.free_vertices());
            let nearest = |at: f64| {
                let off = |i: &usize| (s[free[*i]] - at).abs();
                (0..free.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
            };
            let sites = rod.sightings.sites.iter().map(|site| nearest(site.marker.s));
            sites.flat_map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect()
        }
        (View::Components(_), Observations::Synthetic(s)) if !s.components.is_empty() => s.components.clone(),
        (View::Components(names), _) => (0..names.len()).collect(),
    };
    set.observations().iter().flat_map(|o| o.rows.iter().map(|r| of_row[*r])).collect()
}
