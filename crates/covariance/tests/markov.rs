//! Matérn fields along a line by recursion: the dense matrix, its Cholesky root, and 120 digits.

mod promises;

use promises::{EPS, columns, inverse_errors, out, worst_broken_promise};
use varda_covariance::{Covariance, CovarianceFunction, Dense, Error, Kernel, Markov, Precision, Taper};

const FREE: [f64; 6] = [0.1, 0.125, 0.3, 0.625, 0.6875, 0.9];

/// What is known, 2ν, L, and [B₂₂, B₀₃, L₄₄, L₅₀, Σⱼ L₅ⱼ] at the places `FREE` for
/// σ = 1, by Cholesky's method with 120 decimal digits (mpmath).
const DIGITS: [(&str, i32, f64, [f64; 5]); 18] = [
    ("start", 1, 0.5, [0.6132589765455, 0.04874353719895, 0.4703182081619, 0.07535150879393, 1.910793080248]),
    (
        "start",
        1,
        1e3,
        [0.0004748872053599, 7.495782438058e-5, 0.01117999051098, 0.00865316635778, 0.09168899641496],
    ),
    ("start", 3, 0.5, [0.2603202011793, 0.01651086118877, 0.1777996943674, 0.1274135936098, 2.075097168091]),
    (
        "start",
        3,
        1e3,
        [1.171586500738e-10, 1.715334461202e-11, 2.988885598874e-6, 2.595464137674e-5, 0.0001465545824259],
    ),
    ("start", 5, 0.5, [0.1327860753454, 0.009951343951724, 0.1105863782466, 0.2106867196624, 2.111305447475]),
    (
        "start",
        5,
        1e3,
        [2.818923794461e-14, 7.315438036244e-15, 1.631523460232e-9, 1.773538972937e-6, 1.922262867804e-6],
    ),
    ("both", 1, 0.5, [0.5829791385404, 0.03586119420697, 0.4426864422417, 0.01085005277167, 0.555438126854]),
    (
        "both",
        1,
        1e3,
        [0.0003460714111056, 2.678571130999e-5, 0.009999999973958, 0.0003793721205484, 0.01330199281419],
    ),
    ("both", 3, 0.5, [0.22575116869, 0.009549941885989, 0.131202259975, 0.005100045323785, 0.1385673146701]),
    (
        "both",
        3,
        1e3,
        [4.326757284689e-11, 2.128601600425e-12, 1.549705704248e-6, 9.41714361543e-8, 1.767929065565e-6],
    ),
    (
        "both",
        5,
        0.5,
        [0.1013573967318, 0.004505414930635, 0.05761620512697, 0.004870641448705, 0.06309997756514],
    ),
    (
        "both",
        5,
        1e3,
        [1.197778727983e-17, 8.629008803925e-19, 3.885761783318e-10, 1.305337702469e-10, 7.081115152631e-10],
    ),
    ("many", 1, 0.5, [0.1579124782165, 0.0, 0.4426864422417, 0.0, 0.4846389578941]),
    ("many", 1, 1e3, [7.999999973333e-5, 0.0, 0.009999999973958, 0.0, 0.01108792709686]),
    (
        "many",
        3,
        0.5,
        [0.009226788746246, 0.0007825031634634, 0.115694190912, 0.001085785531512, 0.1065800060891],
    ),
    (
        "many",
        3,
        1e3,
        [1.247880977745e-12, 1.292971740385e-13, 1.340266103397e-6, 1.653558250899e-8, 1.254842185418e-6],
    ),
    (
        "many",
        5,
        0.5,
        [0.001301341893061, 0.0003402397763355, 0.0408714674444, 0.001635641904786, 0.04020164661404],
    ),
    (
        "many",
        5,
        1e3,
        [5.407584850792e-20, 2.124973940204e-20, 2.585024587953e-10, 2.138678151678e-11, 3.155729384688e-10],
    ),
];

fn known(which: &str) -> &'static [f64] {
    match which {
        "none" => &[],
        "start" => &[0.0, 0.0625],
        "both" => &[0.9375, 0.0, 0.0625, 1.0],
        _ => &[0.0, 0.0625, 0.25, 0.5, 0.9375, 1.0],
    }
}

fn matern(two_nu: i32, length: f64) -> CovarianceFunction {
    let kernel = match two_nu {
        1 => Kernel::Matern12 { length },
        3 => Kernel::Matern32 { length },
        _ => Kernel::Matern52 { length },
    };
    CovarianceFunction { sigma: 1.0, kernel, taper: Taper::None }
}

/// Places with spacings between 1 and 20 times the least, by a fixed sequence.
fn irregular(n: usize) -> Vec<f64> {
    let steps: Vec<f64> = (0..=n).map(|i| 1.0 + 19.0 * (0.5 + 0.5 * (7.3 * (i * i) as f64).sin())).collect();
    let total: f64 = steps.iter().sum();
    let mut s = 0.07;
    steps[..n]
        .iter()
        .map(|step| {
            s += 0.92 * step / total;
            s
        })
        .collect()
}

/// Every entry keeps its relative digits, where the matrix itself is singular to working precision: at
/// L = 1000 variances are 1e-20 of σ².
#[test]
fn entries_have_their_digits() {
    for (which, two_nu, length, digits) in DIGITS {
        let b = Markov::new(&matern(two_nu, length), &FREE, known(which)).unwrap();
        let full = columns(6, 6, |x, y| b.apply(x, y));
        let root = columns(6, 6, |v, x| b.root(v, x));
        let row: f64 = (0..6).map(|j| root[j][5]).sum();
        let entries = [full[2][2], full[3][0], root[4][4], root[0][5], row];
        for (i, (entry, digit)) in entries.iter().zip(digits).enumerate() {
            // Zero: places between which one is known, for ν = 1/2.
            let scale = if digit == 0.0 { full[2][2] } else { digit.abs() };
            let error = (entry - digit).abs() / scale;
            // What is left of the variance is down to 1e-20, that is 1e-10 of σ; f′ and f″ are carried
            // to rounding of their size, and 1/(λ d) of that shows in f at a distance d of known places.
            assert!(error <= 1e-9, "{which} {two_nu} {length} {i}: {entry:e} {digit:e} {error:e}");
        }
    }
}

/// (L/d)², d the least distance of a known place from another: the condition number of k_cc of two places,
/// which the dense matrix pays for, and what a slope between them makes of rounding.
fn condition(free: &[f64], known: &[f64], length: f64) -> f64 {
    let mut all = [free, known].concat();
    all.sort_by(f64::total_cmp);
    let near = |pair: &&[f64]| known.contains(&pair[0]) || known.contains(&pair[1]);
    let least = all.windows(2).filter(near).fold(f64::INFINITY, |least, pair| least.min(pair[1] - pair[0]));
    1.0 + (length / least).powi(2)
}

/// The matrix of the kernel, wherever there is one: 1e-3 to 1e3 of the line, irregular places, clamps.
#[test]
fn b_is_that_of_the_dense_matrix() {
    let mut compared = 0;
    for n in [1, 2, 5, 40] {
        let free = irregular(n);
        let held: [&[f64]; 4] =
            [&[], &[0.0, 0.05], &[0.0, 0.05, 1.0, 1.03], &[0.0, 0.05, free[n / 2] + 1e-3, 1.0]];
        for two_nu in [1, 3, 5] {
            for length in [1e-3, 0.03, 0.3, 1.0, 30.0, 1e3] {
                for known in held {
                    let function = CovarianceFunction { sigma: 3.0, ..matern(two_nu, length) };
                    let b = Markov::new(&function, &free, known).unwrap();
                    let condition = condition(&free, known, length);
                    let promise = worst_broken_promise(&b, 5);
                    assert!(promise <= condition, "{n} {two_nu} {length} {known:?}: {promise}");
                    // The dense matrix refuses known points that it cannot tell apart.
                    let Ok(matrix) = function.conditioned_matrix(&free, known) else { continue };
                    compared += 1;
                    let bound = (10.0 * condition + 8.0 * n as f64) * EPS * 9.0;
                    let full = columns(n, n, |x, y| b.apply(x, y));
                    for i in 0..n {
                        for j in 0..n {
                            let gap = (full[j][i] - matrix[i * n + j]).abs();
                            assert!(
                                gap <= bound,
                                "{n} {two_nu} {length} {known:?} {i} {j}: {gap:e} {bound:e}"
                            );
                        }
                    }
                }
            }
        }
    }
    assert!(compared > 200, "{compared}");
}

/// The root is Cholesky's, and the inverse that of B, where the dense matrix has one.
#[test]
fn the_root_is_choleskys() {
    let n = 24;
    let free = irregular(n);
    for two_nu in [1, 3, 5] {
        for length in [0.01, 0.1, 0.4] {
            for known in [&[][..], &[0.0, 0.05], &[0.0, 0.05, 1.0, 1.03]] {
                let function = matern(two_nu, length);
                let b = Markov::new(&function, &free, known).unwrap();
                let dense = Dense::new(n, &function.conditioned_matrix(&free, known).unwrap()).unwrap();
                assert!(b.is_well_determined());
                let (solve, whiten) = inverse_errors(&b, 7);
                assert!(solve <= 1.0 && whiten <= 1.0, "{two_nu} {length}: {solve} {whiten}");
                let condition = varda_covariance::Spectrum::of(&dense).unwrap().condition_number();
                let (ours, theirs) =
                    (columns(n, n, |v, x| b.root(v, x)), columns(n, n, |v, x| dense.root(v, x)));
                for (ours, theirs) in ours.iter().flatten().zip(theirs.iter().flatten()) {
                    // Sensitivity of the Cholesky factor: cond B times rounding of B (Higham 2002, 10.8).
                    assert!(
                        (ours - theirs).abs() <= 4.0 * condition * EPS + 1e-14,
                        "{two_nu} {length} {ours} {theirs}"
                    );
                }
            }
        }
    }
}

/// 200 000 places of a rod: a smooth field of the right variance, with no matrix anywhere.
#[test]
fn many_places_take_linear_work() {
    let n = 200_000;
    let free: Vec<f64> = (2..n).map(|i| i as f64 / n as f64).collect();
    let b = Markov::new(&matern(5, 0.3), &free, &[0.0, 1.0 / n as f64]).unwrap();
    assert!(!b.is_well_determined());
    let variance = out(b.dim(), |v| b.variance(v));
    // var f(1) given f(0) = f′(0) = 0: 1 − k² − 3 k′²/λ² …, from the dense formula with the two
    // functionals f and f′, whose covariance is diag(1, λ²/3).
    let (a, k) = (5.0_f64.sqrt() / 0.3, Kernel::Matern52 { length: 0.3 }.at(1.0));
    let slope = a / 3.0 * (1.0 + a) * (-a).exp();
    let expected = 1.0 - k * k - 3.0 * slope * slope;
    // The second known place is 1/n away.
    assert!((variance[n - 3] - expected).abs() <= 10.0 / n as f64, "{} {expected}", variance[n - 3]);
    assert!(variance[0] > 0.0 && variance.windows(2).all(|v| v[1] >= v[0] * (1.0 - 1e-9)));
}

#[test]
fn what_is_not_a_line_of_a_matern_field_is_refused() {
    let smooth = CovarianceFunction { kernel: Kernel::Gaussian { length: 1.0 }, ..matern(5, 1.0) };
    assert_eq!(Markov::new(&smooth, &[0.0], &[]).err(), Some(Error::NotMarkov));
    let tapered = CovarianceFunction { taper: Taper::Triangle { support: 1.0 }, ..matern(5, 1.0) };
    assert_eq!(Markov::new(&tapered, &[0.0], &[]).err(), Some(Error::NotMarkov));
    let zero = CovarianceFunction { sigma: 0.0, ..matern(5, 1.0) };
    assert!(matches!(Markov::new(&zero, &[0.0], &[]), Err(Error::Parameter { .. })));
    assert!(matches!(Markov::new(&matern(5, 1.0), &[], &[]), Err(Error::Size { .. })));
    let at = |free: &[f64], known: &[f64]| match Markov::new(&matern(5, 1.0), free, known) {
        Err(Error::Places { index, .. }) => index,
        other => panic!("{other:?}"),
    };
    assert_eq!(at(&[0.0, 1.0, 1.0], &[]), 2);
    assert_eq!(at(&[0.0, 1.0, 0.5], &[]), 2);
    assert_eq!(at(&[0.0, f64::NAN], &[]), 1);
    assert_eq!(at(&[0.0, f64::INFINITY], &[]), 1);
    at(&[0.0, 1.0], &[1.0]);
    at(&[0.0, 1.0], &[2.0, 2.0]);
    at(&[0.0, 1.0], &[f64::NAN]);
}

/// One entry of the root that is wrong by 1e-9 does not pass for that of the kernel.
#[test]
fn a_wrong_root_is_caught() {
    let free = irregular(12);
    let function = matern(5, 0.2);
    let b = Markov::new(&function, &free, &[0.0]).unwrap();
    let wrong = Markov::new(&matern(5, 0.2 * (1.0 + 1e-9)), &free, &[0.0]).unwrap();
    let matrix = function.conditioned_matrix(&free, &[0.0]).unwrap();
    let gap = |b: &Markov| {
        let full = columns(12, 12, |x, y| b.apply(x, y));
        full.iter().flatten().zip(&matrix).fold(0.0_f64, |gap, (a, b)| gap.max((a - b).abs()))
    };
    assert!(gap(&b) <= 1e-14, "{:e}", gap(&b));
    assert!(gap(&wrong) > 1e-11, "{:e}", gap(&wrong));
    let x = out(12, |x| b.root(&[1.0; 12], x));
    let back = out(12, |v| b.whiten(&x, v));
    assert!(back.iter().all(|v| (v - 1.0).abs() <= 1e-10));
}
