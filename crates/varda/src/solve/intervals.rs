//! Intervals of constants under a posterior that need not be Gaussian.

use std::collections::BTreeMap;

use varda_assimilation::{ControlTransform, Error, LeastSquares, Posterior};

use super::task::PosteriorSpread;

/// What 95 % intervals leave outside.
const OUTSIDE: f64 = 0.05;

/// The spread of a posterior, with intervals of these components of the control.
pub(super) fn spread(
    posterior: &Posterior,
    cost: &mut dyn LeastSquares,
    transform: &ControlTransform,
    v: &[f64],
    components: &[usize],
) -> Result<PosteriorSpread, Error> {
    let places: Vec<usize> = (0..v.len()).collect();
    let mut found = Found::default();
    Ok(PosteriorSpread {
        intervals: found.of(posterior, cost, v, (transform, &places), components)?,
        ..PosteriorSpread::around(posterior, transform, true)
    })
}

/// Intervals of numbers of the control variable, by their places: what several recordings share is followed
/// once.
#[derive(Default)]
pub(super) struct Found(BTreeMap<usize, [f64; 2]>);

impl Found {
    /// Ends of 95 % intervals of these components of the control, less the analysis: by what J is along each.
    /// `places` are those of the transform's control variable in that of the cost.
    pub(super) fn of(
        &mut self,
        posterior: &Posterior,
        cost: &mut dyn LeastSquares,
        v: &[f64],
        (transform, places): (&ControlTransform, &[usize]),
        components: &[usize],
    ) -> Result<Vec<[f64; 2]>, Error> {
        let mut all = Vec::new();
        for component in components {
            let mut unit = vec![0.0; transform.control_dim()];
            unit[*component] = 1.0;
            let mut own = vec![0.0; transform.dim()];
            transform.adjoint(&unit, &mut own);
            let mut a = vec![0.0; v.len()];
            places.iter().zip(&own).for_each(|(place, own)| a[*place] = *own);
            // a constant is one number of v times its prior's σ
            let place = a.iter().position(|a| *a != 0.0);
            let place = place.filter(|place| a[place + 1..].iter().all(|a| *a == 0.0) && a[*place] > 0.0);
            all.push(match place {
                Some(place) => {
                    let sigma = std::mem::replace(&mut a[place], 1.0);
                    let ends = match self.0.get(&place) {
                        Some(ends) => *ends,
                        None => posterior.interval(cost, v, &a, OUTSIDE)?,
                    };
                    self.0.insert(place, ends);
                    ends.map(|end| sigma * end)
                }
                None => posterior.interval(cost, v, &a, OUTSIDE)?,
            });
        }
        Ok(all)
    }
}
