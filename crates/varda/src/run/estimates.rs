//! The constants of an analysis, with their σ and correlations.

use varda_assimilation::Analysis;

use crate::outcome::{Estimated, IDENTIFIABLE};
use crate::setup::Problem;
use crate::setup::estimate::Constant;
use crate::solve::PosteriorSpread;

/// 95 % of a normal distribution are within so many σ.
pub(super) const INTERVAL: f64 = 1.959963984540054;

/// Estimates of an analysis with this posterior.
pub(super) fn estimated(
    problem: &Problem,
    analysis: &Analysis,
    posterior: Option<&PosteriorSpread>,
) -> Vec<Estimated> {
    let root = posterior.map_or(&[][..], |posterior| &posterior.root);
    let profiles = posterior.map_or(&[][..], |posterior| &posterior.intervals);
    let profiled = problem.single_constants();
    let estimates = problem.system.estimates();
    let constants = &estimates.constants;
    let n = analysis.analysis.len();
    let first = n - constants.len();
    let row = |i: usize| root.chunks_exact(n).map(move |column| column[first + i]);
    let product = |i: usize, j: usize| row(i).zip(row(j)).map(|(a, b)| a * b).sum::<f64>();
    let estimate = |i: usize| {
        let (constant, p) = (&constants[i], analysis.analysis[first + i]);
        let prior = analysis.background[first + i];
        let sigma_p = posterior.map(|_| analysis.sigma_analysis[first + i]);
        let profile = profiled.iter().zip(profiles).find(|(at, _)| **at == first + i).map(|(_, ends)| *ends);
        let correlation = |j: usize| {
            let size = (product(i, i) * product(j, j)).sqrt();
            if size > 0.0 { product(i, j) / size } else { 0.0 }
        };
        let by_sigma = sigma_p.map(|s| s <= IDENTIFIABLE * constant.sigma);
        let is_bounded =
            profile.is_some_and(|[low, high]| 0.5 * (high - low) <= IDENTIFIABLE * INTERVAL * constant.sigma);
        Estimated {
            name: constant.name.clone(),
            arc_length: estimates.arc_length(i),
            unit: constant.unit,
            prior: constant.at(prior),
            prior_sigma: constant.sigma_at(prior, constant.sigma),
            value: constant.at(p),
            sigma: sigma_p.map(|s| constant.sigma_at(p, s)),
            sigma_on_mesh: sigma_p.map(|s| constant.sigma_at(p, s)),
            mesh: None,
            interval: sigma_p.map(|s| {
                let ends = profile.unwrap_or([-INTERVAL * s, INTERVAL * s]);
                ends.map(|end| constant.at(p + end))
            }),
            identifiable: by_sigma.map(|by_sigma| by_sigma || is_bounded),
            by_interval_alone: by_sigma == Some(false) && is_bounded,
            truth: problem.truth.as_ref().map(|truth| constant.at(truth[first + i])),
            correlations: if root.is_empty() {
                Vec::new()
            } else {
                (0..constants.len()).map(correlation).collect()
            },
        }
    };
    (0..constants.len()).map(estimate).collect()
}

impl Estimated {
    /// Widens σ and the interval by an error of p that the mesh makes, p being the analysis.
    pub(super) fn allow_for(&mut self, error: f64, p: f64, constant: &Constant) {
        self.mesh = Some(constant.sigma_at(p, error));
        let Some(of_observations) = self.sigma_on_mesh else { return };
        let sigma = of_observations / constant.sigma_at(p, 1.0);
        let sigma = sigma.hypot(error);
        self.sigma = Some(constant.sigma_at(p, sigma));
        self.interval = self.interval.map(|ends| {
            let [low, high] = ends.map(|end| (constant.number_of(end) - p).abs().hypot(INTERVAL * error));
            [constant.at(p - low), constant.at(p + high)]
        });
    }
}
