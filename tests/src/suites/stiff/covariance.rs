//! Covariances near and beyond singular, and one of 10⁵ points.

use super::common::refused;
use crate::row::{Outcome, Rows, Work};
use problems::small_problems::{difference, normals};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use varda_covariance::{
    Banded, Covariance, CovarianceFunction, Dense, Diagonal, Kernel, Precision, Spectrum, Taper, Truncated,
};

const NONE: Taper = Taper::None;

fn gaussian(length: f64, taper: Taper) -> CovarianceFunction {
    CovarianceFunction { sigma: 1.0, kernel: Kernel::Gaussian { length }, taper }
}

pub(super) fn run(rows: &mut Rows) {
    smooth_kernels(rows);
    degenerate(rows);
    tapered(rows, 1000);
    large(rows, &[12_500, 25_000, 50_000, 100_000]);
}

/// Gaussian kernels on 25 points over L = 1, far beyond singular in double precision.
fn smooth_kernels(rows: &mut Rows) {
    let n = 25;
    let places: Vec<f64> = (0..n).map(|i| i as f64 / (n - 1) as f64).collect();
    for length in rows.grid("lengths of a Gaussian kernel", [0.05, 0.06, 0.08, 0.1, 0.2, 0.3, 0.5]) {
        rows.case(&format!("Gaussian kernel of {length} L on {n} points"), |case| {
            let matrix = gaussian(length, NONE).matrix(&places)?;
            let truncated = Truncated::eigen(n, &matrix, 0.0)?;
            let spectrum = Spectrum::new(Truncated::eigen(n, &matrix, 0.0)?.spectrum()?.eigenvalues);
            let exact = exact_condition(length, n);
            let (found, rank) = (spectrum.condition_number(), spectrum.effective_rank());
            let says = match spectrum.reliable_condition_number() {
                Some(condition) => format!("{condition:.1e}"),
                None => "above 1e16".to_string(),
            };
            let note = format!(
                "exact condition {exact:.0e}, reported {says}; effective rank {rank:.1}, {} directions kept",
                truncated.root_dim()
            );
            // B is kept to the n ε λ₁ that truncation may leave out
            let mut column = vec![0.0; n];
            let mut unit = vec![0.0; n];
            let mut worst = 0.0_f64;
            for j in 0..n {
                unit[j] = 1.0;
                truncated.apply(&unit, &mut column);
                unit[j] = 0.0;
                worst = (0..n).fold(worst, |m, i| m.max((column[i] - matrix[i * n + j]).abs()));
            }
            let bound = n as f64 * f64::EPSILON * spectrum.eigenvalues[0];
            case.at_most("truncated root: largest error of an entry", worst, bound, "-")
                .because("n ε λ₁: what truncation may leave out")
                .work(Work { condition: Some(exact), ..Work::default() })
                .note(note);
            let error = match spectrum.reliable_condition_number() {
                Some(condition) => (condition / exact).ln().abs(),
                None if exact > 1e13 => 0.0,
                None => f64::NAN,
            };
            case.at_most("condition reported: |ln(reported/exact)|, or said to be beyond", error, 1.0, "-")
                .because(
                    "eigenvalues carry ε λ₁: a condition of 1e16 ε is right within e, or it is not \
                    told",
                )
                .computed(found);
            match Dense::new(n, &matrix) {
                Ok(dense) => {
                    let x = normals(5, n);
                    let (mut y, mut back) = (vec![0.0; n], vec![0.0; n]);
                    dense.apply(&x, &mut y);
                    dense.solve(&y, &mut back);
                    let bound = 10.0 * f64::EPSILON * exact;
                    case.at_most(
                        "Cholesky root: relative error of B⁻¹ B x",
                        difference(&back, &x),
                        bound,
                        "-",
                    )
                    .because("ε times the condition, some ten roundings");
                }
                Err(error) => {
                    refused(case, "Cholesky refused, naming the pivot", Err::<(), _>(error), "pivot")
                }
            }
            Ok(())
        });
    }
}

/// Condition number of the kernel matrix, exact to rounding at any size.
fn exact_condition(length: f64, n: usize) -> f64 {
    // On equally spaced points B is Toeplitz with entries q^((i−j)²), q = exp(−h²/2ℓ²): a
    // Vandermonde-like kernel whose LDLᵀ is known in closed form, d_k = Π_{j=1..k} (1 − q^(2j)).
    // ‖B⁻¹‖ follows from B⁻¹ = L⁻ᵀ D⁻¹ L⁻¹ with L⁻¹ of Gaussian binomials; all terms
    // of one row alternate in sign, so that |B⁻¹| = |L⁻ᵀ| D⁻¹ |L⁻¹| loses no digit.
    let h = 1.0 / (n - 1) as f64;
    let q = (-0.5 * (h / length).powi(2)).exp();
    let apply = |x: &[f64], y: &mut [f64]| {
        for i in 0..n {
            y[i] = (0..n).map(|j| q.powi((i.abs_diff(j) * i.abs_diff(j)) as i32) * x[j]).sum();
        }
    };
    // With p = q², row i of |L⁻¹| holds q^(i−j) [i choose j]_p, j ≤ i; 1 − p^k by expm1, exact for
    // p near 1.
    let one_minus = |k: usize| -((2.0 * k as f64) * q.ln()).exp_m1();
    let mut inverse = vec![vec![0.0; n]; n];
    for i in 0..n {
        inverse[i][i] = 1.0;
        for j in (0..i).rev() {
            inverse[i][j] = inverse[i][j + 1] * one_minus(j + 1) / one_minus(i - j) * q;
        }
    }
    let mut pivots = vec![1.0; n];
    for k in 1..n {
        pivots[k] = pivots[k - 1] * one_minus(k);
    }
    let apply_inverse = |x: &[f64], y: &mut [f64]| {
        let mut middle = vec![0.0; n];
        for i in 0..n {
            middle[i] = (0..=i).map(|j| inverse[i][j] * x[j]).sum::<f64>() / pivots[i];
        }
        for j in 0..n {
            y[j] = (j..n).map(|i| inverse[i][j] * middle[i]).sum();
        }
    };
    largest_eigenvalue(n, &apply) * largest_eigenvalue(n, &apply_inverse)
}

/// Power iteration on a matrix of positive entries.
fn largest_eigenvalue(n: usize, apply: &dyn Fn(&[f64], &mut [f64])) -> f64 {
    let (mut x, mut y, mut value) = (vec![1.0 / (n as f64).sqrt(); n], vec![0.0; n], 0.0);
    for _ in 0..200 {
        apply(&x, &mut y);
        value = y.iter().map(|y| y * y).sum::<f64>().sqrt();
        x.iter_mut().zip(&y).for_each(|(x, y)| *x = y / value);
    }
    value
}

/// Duplicate points, rank one, zero variance, indefinite: a root that is right, or an error with its number.
fn degenerate(rows: &mut Rows) {
    rows.case("duplicate points", |case| {
        let places = [0.0, 0.1, 0.1, 0.2, 0.3];
        let f = gaussian(0.1, Taper::GaspariCohn { support: 0.25 });
        refused(case, "Cholesky refused, naming the pivot", Dense::new(5, &f.matrix(&places)?), "pivot 2");
        refused(case, "band refused, naming the pivot", Banded::along(&f, &places), "pivot 2");
        let truncated = Truncated::eigen(5, &f.matrix(&places)?, 0.0)?;
        case.count("directions kept", truncated.root_dim(), 4);
        let mut variance = [0.0; 5];
        truncated.variance(&mut variance);
        let worst = variance.iter().fold(0.0_f64, |m, v| m.max((v - 1.0).abs()));
        case.at_most("error of the variance", worst, 5.0 * 3.0 * f64::EPSILON, "-").because("n ε λ₁");
        Ok(())
    });
    rows.case("rank 1", |case| {
        let u = [1.0, -2.0, 0.5, 3.0];
        let matrix: Vec<f64> = (0..16).map(|p| u[p / 4] * u[p % 4]).collect();
        refused(case, "Cholesky refused, naming the pivot", Dense::new(4, &matrix), "pivot 1");
        for (name, root) in [
            ("eigen", Truncated::eigen(4, &matrix, 0.0)?),
            ("pivoted Cholesky", Truncated::pivoted_cholesky(4, &matrix, 0.0)?),
        ] {
            case.count(&format!("{name}: directions kept"), root.root_dim(), 1);
            let mut column = [0.0; 4];
            root.apply(&[1.0, 0.0, 0.0, 0.0], &mut column);
            case.at_most(&format!("{name}: error of a column"), difference(&column, &u), 1e-14, "-")
                .because("n ε of λ₁ = 14.25");
        }
        Ok(())
    });
    rows.case("zero variance", |case| {
        refused(case, "zero matrix refused", Truncated::eigen(3, &[0.0; 9], 0.0), "zero");
        refused(case, "one component, naming the pivot", Dense::new(2, &[1.0, 0.0, 0.0, 0.0]), "pivot 1");
        refused(case, "σ of zero, naming it", Diagonal::uniform(3, 0.0), "standard deviation");
        let kept = Truncated::eigen(2, &[1.0, 0.0, 0.0, 0.0], 0.0)?;
        let mut x = [9.0; 2];
        kept.root(&[1.0], &mut x);
        case.at_most("truncated: the component without variance", x[1].abs(), 0.0, "-");
        Ok(())
    });
    rows.case("not positive semidefinite", |case| {
        let matrix = [1.0, 0.9, -0.9, 0.9, 1.0, 0.9, -0.9, 0.9, 1.0];
        refused(case, "Cholesky, naming the pivot", Dense::new(3, &matrix), "pivot 2");
        refused(
            case,
            "eigen, with the eigenvalue",
            Truncated::eigen(3, &matrix, 0.0),
            "not positive semidefinite",
        );
        refused(
            case,
            "pivoted Cholesky, with the variance",
            Truncated::pivoted_cholesky(3, &matrix, 0.0),
            "not positive semidefinite",
        );
        Ok(())
    });
}

/// Products of kernel and taper at random places along a line have no negative eigenvalue (Schur 1911).
fn tapered(rows: &mut Rows, draws: usize) {
    rows.case(&format!("tapered kernels at random places, {draws} draws"), |case| {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut worst = 0.0_f64;
        for draw in 0..draws {
            let n = 2 + draw % 30;
            let places: Vec<f64> = (0..n).map(|_| rng.random::<f64>()).collect();
            let (length, support) = (0.01 + rng.random::<f64>(), 0.05 + 2.0 * rng.random::<f64>());
            let kernel = match draw % 4 {
                0 => Kernel::Gaussian { length },
                1 => Kernel::Matern12 { length },
                2 => Kernel::Matern32 { length },
                _ => Kernel::Matern52 { length },
            };
            let taper =
                if draw % 8 < 4 { Taper::Triangle { support } } else { Taper::GaspariCohn { support } };
            let matrix = CovarianceFunction { sigma: 1.0, kernel, taper }.matrix(&places)?;
            match Truncated::eigen(n, &matrix, 0.0) {
                Ok(_) => {}
                Err(varda_covariance::Error::NotPositiveSemidefinite { value, largest }) => {
                    worst = worst.max(-value / largest)
                }
                Err(error) => return Err(error.into()),
            }
        }
        case.at_most("largest negative eigenvalue over λ₁ beyond rounding", worst, 0.0, "-").because(
            "a product of two covariances is one (Schur 1911); `eigen` refuses what is below −n ε λ₁",
        );
        Ok(())
    });
}

/// A compact taper along a line, ten points in its support: time and memory grow like n.
fn large(rows: &mut Rows, sizes: &[usize]) {
    let mut times = Vec::new();
    for n in rows.grid("points of a compact taper", sizes.iter().copied()) {
        rows.case(&format!("compact taper, {n} points"), |case| {
            let clock = std::time::Instant::now();
            let outcome = one_large(case, n);
            times.push(clock.elapsed().as_secs_f64() / n as f64);
            outcome
        });
    }
    rows.case("compact taper, growth", |case| {
        let (first, last) = (times[0], times[times.len() - 1]);
        // linear: the time per point stays; quadratic would be the ratio of the sizes, 8. Clocks inform, they
        // never gate: what does is the half-bandwidth, which does not grow, so that memory and operations are
        // n times it.
        case.inform("time per point, largest over smallest n", last / first, "-").computed(last);
        Ok(())
    });
}

fn one_large(case: &mut crate::row::Case, n: usize) -> Outcome {
    let places: Vec<f64> = (0..n).map(|i| 0.01 * (i as f64 + 0.3 * (i as f64).sin())).collect();
    let b = Banded::along(&gaussian(0.05, Taper::GaspariCohn { support: 0.1 }), &places)?;
    let x = normals(3, n);
    let (mut y, mut back) = (vec![0.0; n], vec![0.0; n]);
    b.apply(&x, &mut y);
    b.solve(&y, &mut back);
    case.at_most("relative error of B⁻¹ B x", difference(&back, &x), 1e-10, "-")
        .because("the taper bounds the condition, whatever n: some 1e4 at ten points in the support")
        .note(format!(
            "half-bandwidth {}, {:.1} MB",
            b.half_bandwidth(),
            8e-6 * (n * (b.half_bandwidth() + 1)) as f64
        ));
    let mut variance = vec![0.0; n];
    b.variance(&mut variance);
    let worst = variance.iter().fold(0.0_f64, |m, v| m.max((v - 1.0).abs()));
    case.at_most("error of the variance", worst, 20.0 * f64::EPSILON, "-")
        .because("w + 1 terms, each rounded");
    case.at_most("half-bandwidth", b.half_bandwidth() as f64, 12.0, "-").because(
        "ten places in a support, 0.1 by 0.01 give or take 0.6 of a spacing: memory and operations \
            are n times it",
    );
    Ok(())
}
