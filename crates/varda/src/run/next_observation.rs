//! Where one more observation would help most: σ at the end of the window with one more marker or component,
//! from the posterior carried along the run.

use std::collections::BTreeSet;
use std::ops::Range;

use varda_assimilation::variance_after;
use varda_linalg::interrupt;

use crate::Error;
use crate::outcome::{Candidate, NextObservation, Quantity};
use crate::setup::Problem;
use crate::setup::memory::{FURTHER_COLUMNS, FURTHER_NUMBERS, FURTHER_PLACES, FURTHER_TIMES};
use crate::setup::observations::Seen;

/// What is gathered on the way.
pub(super) struct Gathering {
    steps: BTreeSet<usize>,
    end: usize,
    sigma: f64,
    places: Vec<(Candidate, Range<usize>)>,
    /// What σ is asked of, at the end, and how many vectors that are.
    target: Range<usize>,
    vectors: usize,
    /// Rows of G of each place.
    rows: Vec<Vec<f64>>,
    /// The target's rows of W, by columns.
    root: Vec<f64>,
    columns: usize,
}

impl Gathering {
    /// For a root of so many columns; `None` where it is too large, nothing is observed, or observed errors
    /// are correlated.
    pub(super) fn new(problem: &Problem, columns: usize) -> Option<Gathering> {
        let (grid, layout) = (problem.experiment.grid, &problem.experiment.state);
        let observed = &problem.observed;
        let used: Vec<&Seen> = observed.seen.iter().filter(|s| observed.is_assimilated(s, &grid)).collect();
        let steps: Vec<usize> = used.iter().map(|s| s.step).collect::<BTreeSet<_>>().into_iter().collect();
        let correlated = problem.experiment.scene.observations.correlation().is_some();
        if columns > FURTHER_COLUMNS || steps.is_empty() || correlated {
            return None;
        }
        // of one more marker or component: pixels and readings say nothing of its σ
        let is_whole = |quantity| matches!(quantity, Quantity::Place | Quantity::Component);
        let seen_whole = used.iter().filter(|s| is_whole(observed.sites[s.site].quantity));
        let mut sigmas: Vec<f64> = seen_whole.map(|s| s.sigma).collect();
        sigmas.sort_by(f64::total_cmp);
        let (group, sigma) = (layout.groups.first()?, *sigmas.get(sigmas.len() / 2)?);
        let vectors = group.range.len() / group.width;
        let places = evenly(vectors, FURTHER_PLACES).map(|i| {
            let first = group.range.start + i * group.width;
            let geometry = layout.geometry.as_ref();
            let candidate = Candidate {
                arc_length: geometry.map(|g| g.place(group, i)),
                component: geometry.is_none().then(|| layout.names[first].clone()),
                sigma: f64::NAN,
            };
            (candidate, first..first + group.width)
        });
        let places: Vec<_> = places.collect();
        let of_a_time = (columns * places.len() * group.width).max(1);
        let times = FURTHER_TIMES.min(FURTHER_NUMBERS / of_a_time).min(steps.len());
        if times == 0 {
            return None;
        }
        Some(Gathering {
            steps: evenly(steps.len(), times).map(|i| steps[i]).collect(),
            end: grid.steps,
            sigma,
            rows: places.iter().map(|_| Vec::with_capacity(columns * group.width * times)).collect(),
            places,
            target: group.range.clone(),
            vectors,
            root: Vec::new(),
            columns,
        })
    }

    /// Takes what is needed of the root W of step k, whose columns are n long.
    pub(super) fn see(&mut self, k: usize, n: usize, w: &[f64]) {
        if self.steps.contains(&k) {
            for ((_, range), rows) in self.places.iter().zip(&mut self.rows) {
                for c in range.clone() {
                    rows.extend(w.chunks_exact(n).map(|column| column[c] / self.sigma));
                }
            }
        }
        if k == self.end {
            self.root.reserve_exact(self.target.len() * self.columns);
            w.chunks_exact(n).for_each(|column| self.root.extend_from_slice(&column[self.target.clone()]));
        }
    }

    /// The answer, where the run came to the end of the window.
    pub(super) fn answer(self) -> Result<Option<NextObservation>, Error> {
        if self.root.is_empty() {
            return Ok(None);
        }
        let rms = |variance: Vec<f64>| (variance.iter().sum::<f64>() / self.vectors as f64).max(0.0).sqrt();
        let after = |rows: &[f64]| Ok::<_, Error>(rms(variance_after(self.columns, &self.root, rows)?));
        let sigma_now = after(&[])?;
        let mut candidates = Vec::with_capacity(self.places.len());
        for ((candidate, _), rows) in self.places.iter().zip(&self.rows) {
            candidates.push(Candidate { sigma: after(rows)?, ..candidate.clone() });
            if interrupt::requested() {
                return Ok(None);
            }
        }
        Ok(Some(NextObservation { sigma_now, sigma_seen: self.sigma, times: self.steps.len(), candidates }))
    }
}

/// At most `most` of `count` numbers from 0 on, evenly, the last among them.
fn evenly(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (1..=taken).map(move |i| i * count / taken - 1)
}

#[cfg(test)]
mod tests {
    use super::evenly;

    #[test]
    fn evenly_with_the_last() {
        assert_eq!(evenly(3, 5).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(evenly(10, 4).collect::<Vec<_>>(), [1, 4, 6, 9]);
        assert_eq!(evenly(0, 4).count(), 0);
    }
}
