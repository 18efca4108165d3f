//! Coverage: over 200 linear-Gaussian twins the errors are as large as the posterior says.

use crate::cost::coupled;
use crate::ensemble::{linear, observed, spanning};
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Ensemble, Localization};
use varda_implicit::Model;

const N: usize = 6;
const TWINS: u64 = 200;
/// 190 of 200 expected inside 95 % intervals; the binomial distribution has a standard deviation of √(200
/// · 0.95 · 0.05) = 3.08. Outside 178 … 199 lies a probability of 3e-4 below and 4e-5 above.
const INSIDE: std::ops::RangeInclusive<usize> = 178..=199;
/// 2.5 and 97.5 % points of χ² with m = 12 degrees of freedom.
const CHI2: std::ops::RangeInclusive<f64> = 4.404..=23.337;

/// The truth is drawn around the background with B (so that the twin is what the prior says), and observed
/// with R.
fn twin(seed: u64, b: &dyn Covariance, background: &[f64]) -> (Vec<f64>, ObservationSet) {
    let mut truth = vec![0.0; N];
    b.root(&normals(40_000 + seed, N), &mut truth);
    truth.iter_mut().zip(background).for_each(|(x, b)| *x += b);
    let states = run(&mut linear(N), &truth, 12);
    let (operators, mut seen) = observed(1).into_parts();
    let noise = normals(50_000 + seed, 12);
    for (o, noise) in seen.iter_mut().zip(noise.chunks(3)) {
        for (i, &row) in o.rows.iter().enumerate() {
            let later = states[(o.step + 1).min(12)][row];
            o.values[i] = (1.0 - o.weight) * states[o.step][row] + o.weight * later + o.sigma[i] * noise[i];
        }
    }
    (truth, ObservationSet::new(12, operators, seen).unwrap())
}

/// J and the analysis with its standard deviations.
type Analysed = (f64, Vec<f64>, Vec<f64>);

fn check(
    analyse: &dyn Fn(&mut ObservationSet) -> Analysed,
    b: &dyn Covariance,
    background: &[f64],
) -> Result<(), String> {
    let (mut inside, mut chi2_inside, mut chi2_sum) = ([0; N], 0, 0.0);
    for seed in 0..TWINS {
        let (truth, mut set) = twin(seed, b, background);
        let (value, z, sigma) = analyse(&mut set);
        (0..N).for_each(|i| inside[i] += usize::from((z[i] - truth[i]).abs() <= 1.959964 * sigma[i]));
        chi2_inside += usize::from(CHI2.contains(&(2.0 * value)));
        chi2_sum += 2.0 * value;
    }
    // 2 J has the mean m = 12 and the variance 2m: 4 standard errors of a mean over 200.
    let mean = chi2_sum / TWINS as f64;
    if (mean - 12.0).abs() > 4.0 * (24.0 / TWINS as f64).sqrt() {
        return Err(format!("mean of 2J {mean}"));
    }
    if !INSIDE.contains(&chi2_inside) {
        return Err(format!("{chi2_inside} of {TWINS} χ² inside"));
    }
    match inside.iter().find(|count| !INSIDE.contains(count)) {
        Some(_) => Err(format!("inside: {inside:?} of {TWINS}")),
        None => Ok(()),
    }
}

fn by_strong(b: &dyn Covariance, background: &[f64], set: &mut ObservationSet) -> Analysed {
    let m = set.dim();
    let mut model = linear(N);
    let transform = ControlTransform::new(background.to_vec(), b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), set).unwrap();
    let mut v = vec![0.0; N];
    let minimum = Minimizer::Newton(NewtonOptions::default())
        .minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))
        .unwrap();
    assert_eq!(minimum.status, Status::Converged);
    let posterior = Posterior::new(&mut cost).unwrap();
    let analysis = Analysis::new(&transform, &v, &minimum, &posterior, m);
    (minimum.value, analysis.analysis, analysis.sigma_analysis)
}

#[test]
fn strong_4dvar_and_4denvar_cover_the_truth_as_often_as_they_claim() {
    let b = coupled(N, 0.8);
    let background = normals(1, N);
    check(&|set| by_strong(&b, &background, set), &b, &background).unwrap();

    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    let by_ensemble = |set: &mut ObservationSet| -> Analysed {
        let make = || -> Box<dyn Model + Send> { Box::new(linear(N)) };
        let mut cost = EnVar::new(&make, background.clone(), &ensemble, set, &[]).unwrap();
        let mut v = vec![0.0; cost.dim()];
        cost.solve(&mut v).unwrap();
        let value = cost.evaluate(&v, None).unwrap();
        let mut z = vec![0.0; N];
        cost.transform().control(&v, &mut z);
        let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot).unwrap();
        let sigma = (0..N).map(|p| columns.chunks(N).map(|x| x[p] * x[p]).sum::<f64>().sqrt()).collect();
        (value, z, sigma)
    };
    check(&by_ensemble, &b, &background).unwrap();
}

#[test]
fn a_background_error_half_as_large_as_it_is_said_to_be_is_noticed() {
    let (b, half) = (coupled(N, 0.8), coupled(N, 0.4));
    let background = normals(1, N);
    assert!(check(&|set| by_strong(&half, &background, set), &b, &background).is_err());
}
