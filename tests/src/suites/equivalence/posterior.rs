//! The posterior three ways, and whether errors are as large as it says.

use super::common::go_on;
use crate::row::{Case, Outcome, Rows};
use crate::suites::golden::twin;
use nalgebra::DMatrix;
use problems::small_problems::{RING, coupled, difference, dot, normals, ring, ring_model, spanning, states};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::error::Error;
use varda_assimilation::{
    Analysis, ControlTransform, CostFunction, EnVar, EnsembleUpdate, LanczosOptions, LbfgsOptions,
    LeastSquares, LowRankPosterior, NewtonOptions, ObservationSet, Posterior, Status, StrongConstraint,
    lbfgs, newton,
};
use varda_covariance::{Covariance, Ensemble, Localization};
use varda_implicit::Model;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

pub(super) fn rows(rows: &mut Rows) {
    for (name, runs) in [
        ("lin3dvar", &[(0.5, 200), (1e-2, 200), (1e-6, 200), (1e-6, 8), (1e-6, 20)][..]),
        ("l63", &[(1e-2, 200), (1e-9, 200), (1e-6, 2)]),
        ("l96", &[(1e-2, 200), (1e-9, 200), (1e-6, 8), (1e-6, 25)]),
    ] {
        rows.case(&format!("posterior of {name}"), |case| {
            twin::shipped(name, &mut |cost, transform, _| three_ways(case, cost, transform, runs))
        });
    }
    rows.case("200 linear twins, 4dvar", |case| coverage(case, &by_strong));
    rows.case("200 linear twins, 4denvar", |case| coverage(case, &by_ensemble));
    rows.case("200 linear twins, guard", |case| {
        // A B four times too small: the claims of the analysis must be found wrong.
        let tally = tally(0.5, &by_strong)?;
        let inside = tally.inside.iter().min().copied().unwrap_or(TWINS);
        case.at_most("half the standard deviations: fewest inside of 200", inside as f64, 177.0, "-")
            .because("below the 178 that a right claim may have: the guard must fail the test of coverage");
        case.at_most("12 / mean of 2J", 12.0 / tally.chi2_mean, 0.9, "-").computed(tally.chi2_mean).because(
            "four standard errors of the mean, 1.4, above 12: the guard must fail the test of the mean",
        );
        Ok(())
    });
}

/// ‖P_v − A⁻¹‖₂ by singular values.
fn error(posterior: &LowRankPosterior, inverse: &DMatrix<f64>) -> f64 {
    let n = inverse.nrows();
    let (mut unit, mut columns) = (vec![0.0; n], vec![0.0; n * n]);
    for (j, column) in columns.chunks_exact_mut(n).enumerate() {
        unit[j] = 1.0;
        posterior.apply(&unit, column);
        unit[j] = 0.0;
    }
    (DMatrix::from_vec(n, n, columns) - inverse).singular_values().max()
}

/// Dense, Lanczos and L-BFGS against the inverse of the dense Hessian by another library; Lanczos and the
/// refined L-BFGS to a tolerance and with so many products at most.
fn three_ways(
    case: &mut Case,
    cost: &mut StrongConstraint,
    transform: &ControlTransform,
    runs: &[(f64, usize)],
) -> Outcome {
    let n = cost.dim();
    let mut v = vec![0.0; n];
    let options = LbfgsOptions::default().with_memory(200);
    let minimum = lbfgs(cost, &mut v, &options, &mut go_on)?;
    case.count("l-bfgs: converged", usize::from(minimum.status == Status::Converged), 1);
    let known = minimum.inverse_hessian.ok_or("l-bfgs returned no inverse Hessian")?;
    let mut hessian = vec![0.0; n * n];
    cost.hessian(&mut hessian)?;
    let inverse =
        DMatrix::from_vec(n, n, hessian).cholesky().ok_or("a Hessian that is not positive")?.inverse();
    let dense = Posterior::new(cost)?;
    let diagonal: Vec<f64> = inverse.diagonal().as_slice().to_vec();
    let apart = difference(&dense.control_variable_variance(), &diagonal);
    case.at_most("dense: variance of v", apart, 1e-11, "-")
        .because("both are backward stable, with a condition of at most 1e4");
    let mut scale = vec![0.0; n];
    transform.covariance().variance(&mut scale);
    let scale: f64 = scale.iter().sum();
    // The bound of ‖P_v − A⁻¹‖ times tr B is one of the trace.
    let compare = |case: &mut Case, what: &str, low: &LowRankPosterior, bound: f64, note: String| {
        case.reason(
            "what the low rank claims as its own bound, and 1e-11 for the rounding of the two inverses",
        );
        case.at_most(
            &format!(
                "{what}: |P_v − \
            A⁻¹|"
            ),
            error(low, &inverse),
            bound + 1e-11,
            "-",
        )
        .note(note);
        let (trace, full) = (low.trace(transform), dense.trace(transform));
        case.at_most(&format!("{what}: Δ tr P_a / tr B"), (trace - full).abs() / scale, bound + 1e-11, "-")
            .note(format!("tr P_a is {:.4} of the dense one", trace / full));
    };
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for &(tolerance, max_products) in runs {
        let options = LanczosOptions::default().with_tolerance(tolerance).with_max_products(max_products);
        let made = [
            ("lanczos", LowRankPosterior::lanczos(cost, &options, &mut rng)?),
            ("l-bfgs, refined", LowRankPosterior::refined(&known, cost, &options, &mut rng)?),
        ];
        for (name, low) in made {
            let bound = low.error_bound().ok_or("no bound")?;
            let what = format!("{name}, tolerance {tolerance:.0e}, at most {max_products}");
            let note = format!("{} products, its own bound", low.products());
            compare(case, &what, &low, bound, note);
            if max_products >= n {
                case.at_most(&format!("{what}: its own bound"), bound, tolerance, "-")
                    .because("the tolerance asked for");
            }
        }
    }
    let by_lbfgs = LowRankPosterior::from_inverse_hessian(&known)?;
    let estimate = by_lbfgs.error_estimate(cost, 20, &mut rng)?;
    // The estimate is a mean of 20 squares: three standard deviations low at worst. P_v and A⁻¹ lie
    // between 0 and I, 1 apart at most.
    let bound = (estimate / (1.0 - 3.0 * (2.0 / 20.0_f64).sqrt()).sqrt()).min(1.0);
    let note = if bound < 1.0 { "its own estimate" } else { "its own estimate promises nothing" };
    compare(case, "l-bfgs, no products", &by_lbfgs, bound, note.into());
    Ok(())
}

const TWINS: usize = 200;
/// 190 of 200 expected inside 95 % intervals, with a standard deviation of 3.08. The binomial distribution
/// has 3e-4 below 178 and 4e-5 above 199.
const INSIDE: (f64, f64) = (188.5, 10.5);
/// 2.5 and 97.5 % points of χ² with m = 12 degrees of freedom.
const CHI2: std::ops::RangeInclusive<f64> = 4.404..=23.337;

/// J, the analysis, its standard deviations.
type Analysed = (f64, Vec<f64>, Vec<f64>);
type Analyse<'a> = dyn Fn(&dyn Covariance, &[f64], &mut ObservationSet) -> Result<Analysed> + 'a;

/// How many of the twins lie inside.
struct Tally {
    inside: [usize; RING],
    chi2_inside: usize,
    chi2_mean: f64,
}

/// Truths are drawn around the background with B and observed with R; the analysis is told a B with `claimed`
/// times its standard deviations.
fn tally(claimed: f64, analyse: &Analyse) -> Result<Tally> {
    let (b, told) = (coupled(RING, 0.8)?, coupled(RING, 0.8 * claimed)?);
    let background = normals(1, RING);
    let mut model = ring_model();
    let mut tally = Tally { inside: [0; RING], chi2_inside: 0, chi2_mean: 0.0 };
    for seed in 0..TWINS as u64 {
        let mut truth = vec![0.0; RING];
        b.root(&normals(40_000 + seed, RING), &mut truth);
        truth.iter_mut().zip(&background).for_each(|(x, b)| *x += b);
        let run = states(&mut model, &truth, 12)?;
        let mut y = normals(50_000 + seed, 12);
        let template = ring(&y)?;
        let seen = template.observations().iter().flat_map(|o| {
            let later = &run[(o.step + 1).min(12)];
            let here = &run[o.step];
            o.rows
                .iter()
                .zip(&o.sigma)
                .map(move |(&r, s)| ((1.0 - o.weight) * here[r] + o.weight * later[r], *s))
        });
        y.iter_mut().zip(seen).for_each(|(y, (x, sigma))| *y = x + sigma * *y);
        let (value, z, sigma) = analyse(&told, &background, &mut ring(&y)?)?;
        for (i, count) in tally.inside.iter_mut().enumerate() {
            *count += usize::from((z[i] - truth[i]).abs() <= 1.959964 * sigma[i]);
        }
        tally.chi2_inside += usize::from(CHI2.contains(&(2.0 * value)));
        tally.chi2_mean += 2.0 * value / TWINS as f64;
    }
    Ok(tally)
}

fn coverage(case: &mut Case, analyse: &Analyse) -> Outcome {
    let tally = tally(1.0, analyse)?;
    let (middle, half) = INSIDE;
    case.reason(
        "190 of 200 expected with σ = 3.08: the binomial distribution has 3e-4 below 178 and 4e-5 above 199",
    );
    for (i, &count) in tally.inside.iter().enumerate() {
        case.at_most(
            &format!("component {i}: |inside 95 % − 188.5|"),
            (count as f64 - middle).abs(),
            half,
            "-",
        )
        .computed(count as f64);
    }
    let count = tally.chi2_inside as f64;
    case.at_most("2J: |inside 95 % of χ² − 188.5|", (count - middle).abs(), half, "-").computed(count);
    let bound = 4.0 * (24.0 / TWINS as f64).sqrt();
    case.at_most("|mean of 2J − m|", (tally.chi2_mean - 12.0).abs(), bound, "-")
        .computed(tally.chi2_mean)
        .because("2J has mean 12 and variance 24: four standard errors of a mean over 200");
    Ok(())
}

fn by_strong(b: &dyn Covariance, background: &[f64], set: &mut ObservationSet) -> Result<Analysed> {
    let m = set.dim();
    let mut model = ring_model();
    let transform = ControlTransform::new(background.to_vec(), b)?;
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), set)?;
    let mut v = vec![0.0; RING];
    let minimum = newton(&mut cost, &mut v, &NewtonOptions::default(), &mut go_on)?;
    let posterior = Posterior::new(&mut cost)?;
    let analysis = Analysis::new(&transform, &v, &minimum, &posterior, m);
    Ok((minimum.value, analysis.analysis, analysis.sigma_analysis))
}

fn by_ensemble(b: &dyn Covariance, background: &[f64], set: &mut ObservationSet) -> Result<Analysed> {
    let ensemble = Ensemble::new(&spanning(b, background), Localization::none(RING))?;
    let make = || -> Box<dyn Model + Send> { Box::new(ring_model()) };
    let mut cost = EnVar::new(&make, background.to_vec(), &ensemble, set, &[])?;
    let mut v = vec![0.0; cost.dim()];
    cost.solve(&mut v)?;
    let value = cost.evaluate(&v, None)?;
    let mut z = vec![0.0; RING];
    cost.transform().control(&v, &mut z);
    let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot)?;
    let column = |p: usize| columns.chunks(RING).map(|x| x[p]).collect::<Vec<_>>();
    Ok((value, z, (0..RING).map(|p| dot(&column(p), &column(p)).sqrt()).collect()))
}
