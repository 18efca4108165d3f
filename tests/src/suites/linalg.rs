//! Linear algebra at its edges: every factorization and iteration ends in a right answer or in a typed error.

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use nalgebra::{DMatrix, DVector};
use problems::registers::upper_halves_in_use;
use problems::rods::wave;
use varda_linalg::dense::{Cholesky, Matrix, View, gram, product};
use varda_linalg::krylov::{CgLimits, Lanczos, LanczosLimits, conjugate_gradients};
use varda_linalg::sparse::{self, Ordering};
use varda_linalg::{Eigen, Error, LinearSolver, Structure, band, dot, eigenvalues, norm};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("linalg");
    for (n, w) in [(1, 0), (2, 1), (12, 5), (40, 8), (104, 10), (60, 13)] {
        rows.case(&format!("n = {n}, half-bandwidth {w}"), |case| same_system(case, n, w));
    }
    for scale in [1e300, 1e-300] {
        rows.case(&format!("entries of {scale:e}"), |case| extreme(case, scale));
    }
    rows.case("rows of different scale", rows_of_different_scale);
    rows.case("indefinite", indefinite);
    rows.case("rank-deficient", rank_deficient);
    rows.case("NaN", not_a_number);
    rows.case("nothing", nothing);
    rows.case("one unknown", one);
    for n in if options.quick { vec![1, 7, 33] } else { vec![1, 7, 33, 150, 400] } {
        rows.case(&format!("eigenvalues, n = {n}"), |case| eigen(case, n));
        rows.case(&format!("products, n = {n}"), |case| products(case, n));
    }
    rows.case("conjugate gradients", conjugate);
    rows.case("Lanczos iteration", lanczos);
    rows.case("sparse grid", grid);
    rows.case("registers", registers);
    rows.finish()
}

/// A symmetric band matrix, diagonally dominant with a condition number below 10: n, values and a right-hand
/// side.
fn dominant(n: usize, w: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| match i.abs_diff(j) {
        0 => 1.5 * (w as f64 + 1.0),
        d if d <= w => wave(i.min(j) * 31 + d, 1),
        _ => 0.0,
    })
}

fn right_hand_side(n: usize) -> DVector<f64> {
    DVector::from_fn(n, |i, _| wave(i, 2) + 1.5)
}

/// The same matrix in every layout that holds it.
fn structures(n: usize, w: usize) -> Vec<(&'static str, Structure)> {
    let pairs = (0..n).flat_map(|j| (j.saturating_sub(w)..(j + w + 1).min(n)).map(move |i| (i, j)));
    vec![
        ("symmetric band", Structure::SymmetricBand { half_bandwidth: w }),
        ("band", Structure::Band { half_bandwidth: w }),
        ("dense", Structure::Dense),
        ("sparse", Structure::from_pairs(n, pairs).expect("pairs below n")),
    ]
}

/// ‖x − expected‖ / ‖expected‖, in the largest component.
fn relative(x: &[f64], expected: &DVector<f64>) -> f64 {
    let gap = x.iter().zip(expected.iter()).fold(0.0, |m: f64, (a, b)| greater(m, (a - b).abs()));
    gap / expected.amax()
}

/// The larger of two, NaN if one is.
fn greater(a: f64, b: f64) -> f64 {
    if a >= b { a } else { b }
}

/// Solves with every layout; the transpose too.
fn solve(
    structure: &Structure,
    a: &DMatrix<f64>,
    b: &DVector<f64>,
) -> Result<[Vec<f64>; 2], varda_linalg::BadPivot> {
    let n = b.len();
    let mut solver = LinearSolver::new(n, structure);
    let mut factor = solver.empty_factor();
    solver.factor(&structure.values(n, |i, j| a[(i, j)]), &mut factor)?;
    let (mut x, mut y) = (b.as_slice().to_vec(), b.as_slice().to_vec());
    solver.solve(&factor, &mut x);
    solver.solve_transpose(&factor, &mut y);
    Ok([x, y])
}

/// A row that passes where the matrix is refused as it should be.
fn refused<T: std::fmt::Debug, E: std::fmt::Display>(case: &mut Case, what: &str, found: Result<T, E>) {
    let (value, note) = match found {
        Err(error) => (0.0, error.to_string()),
        Ok(found) => (f64::NAN, format!("accepted: {found:?}")),
    };
    case.at_most(&format!("{what}, refused"), value, 0.0, "-").note(note);
}

fn same_system(case: &mut Case, n: usize, w: usize) -> Outcome {
    let (a, b) = (dominant(n, w), right_hand_side(n));
    let expected = a.clone().lu().solve(&b).ok_or("nalgebra finds the matrix singular")?;
    case.reason("condition below 10: some n ε of every factorization, nalgebra's included");
    for (name, structure) in structures(n, w) {
        let [x, y] = solve(&structure, &a, &b)?;
        case.at_most(&format!("{name} against nalgebra"), relative(&x, &expected), 1e-13, "-");
        case.at_most(&format!("{name}, transpose"), relative(&y, &expected), 1e-13, "-");
    }
    let mut x = b.as_slice().to_vec();
    Cholesky::well_determined(n, a.as_slice())?.solve(&mut x);
    case.at_most("dense Cholesky against nalgebra", relative(&x, &expected), 1e-13, "-");
    let mut x = b.as_slice().to_vec();
    let lower = Structure::SymmetricBand { half_bandwidth: w };
    band::Cholesky::new(w, lower.values(n, |i, j| a[(i, j)]))?.solve(&mut x);
    case.at_most("band Cholesky against nalgebra", relative(&x, &expected), 1e-13, "-");
    for ordering in [Ordering::Natural, Ordering::MinimumDegree] {
        let factor = sparse::Cholesky::new(n, &lower, &lower.values(n, |i, j| a[(i, j)]), ordering)?;
        let mut x = b.as_slice().to_vec();
        factor.solve(&mut x);
        let what = format!("sparse Cholesky, {ordering:?}, against nalgebra");
        case.at_most(&what, relative(&x, &expected), 1e-13, "-");
        let inverse = a.clone().try_inverse().ok_or("nalgebra finds the matrix singular")?.diagonal();
        let what = format!("diagonal of the inverse, {ordering:?}");
        case.at_most(&what, relative(&factor.inverse_diagonal(), &inverse), 1e-13, "-");
    }
    Ok(())
}

fn extreme(case: &mut Case, scale: f64) -> Outcome {
    let (n, w) = (40, 5);
    let (unit, b) = (dominant(n, w), right_hand_side(n));
    let expected = unit.clone().lu().solve(&b).ok_or("nalgebra finds the matrix singular")?;
    let (a, b) = (unit.clone() * scale, b * scale);
    case.reason("a factor common to all entries changes no ratio: as at scale 1");
    for (name, structure) in structures(n, w) {
        let [x, _] = solve(&structure, &a, &b)?;
        case.at_most(name, relative(&x, &expected), 1e-13, "-");
    }
    let factor = Cholesky::well_determined(n, a.as_slice())?;
    let mut x = b.as_slice().to_vec();
    factor.solve(&mut x);
    case.at_most("dense Cholesky", relative(&x, &expected), 1e-13, "-");
    let mut x = b.as_slice().to_vec();
    factor.solve_columns(&mut x);
    case.at_most("dense Cholesky, in blocks", relative(&x, &expected), 1e-13, "-");
    let pairs = Structure::Band { half_bandwidth: w };
    let factor =
        sparse::Cholesky::new(n, &pairs, &pairs.values(n, |i, j| a[(i, j)]), Ordering::MinimumDegree)?;
    let mut x = b.as_slice().to_vec();
    factor.solve(&mut x);
    case.at_most("sparse Cholesky", relative(&x, &expected), 1e-13, "-");
    let values = eigenvalues(n, a.as_slice())?;
    let mut known: Vec<f64> = unit.symmetric_eigenvalues().iter().map(|v| v * scale).collect();
    known.sort_by(f64::total_cmp);
    case.at_most("eigenvalues", relative(&values, &DVector::from_vec(known)), 1e-13, "-");
    // squares of such vectors overflow or vanish: conjugate gradients say so, or have nothing to do
    let mut x = vec![0.0; n];
    let limits = CgLimits { residual: 1e-12, iterations: n };
    let mut apply = |p: &[f64], out: &mut [f64]| {
        pairs.product(&pairs.values(n, |i, j| a[(i, j)]), p, out);
        Ok::<f64, Error>(dot(p, out))
    };
    let found = conjugate_gradients(&mut apply, b.as_slice(), &limits, &mut x);
    if scale > 1.0 {
        refused(case, "conjugate gradients", found);
    } else {
        let iterations = found?.iterations;
        case.count("conjugate gradients of a right-hand side whose square is 0: iterations", iterations, 0);
    }
    Ok(())
}

/// Row and column i scaled by 10^{±100}: a Cholesky factor is scaled alike, and pivots are judged row
/// by row.
fn rows_of_different_scale(case: &mut Case) -> Outcome {
    let n = 20;
    let unit = dominant(n, 3);
    let scale = |i: usize| 10.0_f64.powi([-100, 0, 100][i % 3]);
    let a = DMatrix::from_fn(n, n, |i, j| scale(i) * unit[(i, j)] * scale(j));
    let solution = right_hand_side(n);
    let b = &unit * &solution;
    let mut x: Vec<f64> = b.iter().enumerate().map(|(i, b)| b * scale(i)).collect();
    Cholesky::well_determined(n, a.as_slice())?.solve(&mut x);
    x.iter_mut().enumerate().for_each(|(i, x)| *x *= scale(i));
    case.reason(
        "Cholesky is invariant under scaling of rows and columns, but for the rounding of the scales",
    );
    case.at_most("dense Cholesky", relative(&x, &solution), 1e-12, "-");
    let lower = Structure::SymmetricBand { half_bandwidth: 3 };
    let mut values = lower.values(n, |i, j| a[(i, j)]);
    let mut x: Vec<f64> = b.iter().enumerate().map(|(i, b)| b * scale(i)).collect();
    case.count("negative pivots of the band", band::ldlt_factor(3, &mut values)?, 0);
    band::ldlt_solve(3, &values, &mut x);
    x.iter_mut().enumerate().for_each(|(i, x)| *x *= scale(i));
    case.at_most("band LDLᵀ", relative(&x, &solution), 1e-12, "-");
    Ok(())
}

fn indefinite(case: &mut Case) -> Outcome {
    let (n, w) = (40, 4);
    // every third diagonal entry turned: dominant still, so that no pivot is small
    let mut a = dominant(n, w) * 2.0;
    (0..n).step_by(3).for_each(|i| a[(i, i)] *= -1.0);
    let b = right_hand_side(n);
    let expected = a.clone().lu().solve(&b).ok_or("nalgebra finds the matrix singular")?;
    case.reason("diagonally dominant: no growth, some n ε");
    for (name, structure) in structures(n, w) {
        let [x, _] = solve(&structure, &a, &b)?;
        case.at_most(name, relative(&x, &expected), 1e-13, "-");
    }
    let lower = Structure::SymmetricBand { half_bandwidth: w };
    let mut values = lower.values(n, |i, j| a[(i, j)]);
    let negative = a.clone().symmetric_eigenvalues().iter().filter(|v| **v < 0.0).count();
    case.count("negative pivots of the band (Sylvester)", band::ldlt_factor(w, &mut values)?, negative);
    let mut z = vec![0.0; n];
    let curvature = band::ldlt_negative_curvature(w, &values, &mut z).ok_or("no negative curvature")?;
    let z = DVector::from_vec(z);
    let found = (z.transpose() * &a * &z)[(0, 0)];
    let error = (found - curvature).abs() / curvature.abs();
    case.at_most("zᵀ A z of the direction of negative curvature", error, 1e-12, "-");
    refused(case, "dense Cholesky", Cholesky::new(n, a.as_slice()).map(|_| ()));
    refused(case, "band Cholesky", band::Cholesky::new(w, lower.values(n, |i, j| a[(i, j)])).map(|_| ()));
    let values = lower.values(n, |i, j| a[(i, j)]);
    refused(
        case,
        "sparse Cholesky",
        sparse::Cholesky::new(n, &lower, &values, Ordering::Natural).map(|_| ()),
    );
    let mut x = vec![0.0; n];
    let mut apply = |p: &[f64], out: &mut [f64]| {
        out.copy_from_slice((&a * DVector::from_column_slice(p)).as_slice());
        Ok::<f64, Error>(dot(p, out))
    };
    let limits = CgLimits { residual: 1e-12, iterations: n };
    let found = conjugate_gradients(&mut apply, b.as_slice(), &limits, &mut x);
    refused(case, "conjugate gradients", found);
    Ok(())
}

/// The second difference with mirrored ends: constants in its kernel; and outer products of few vectors.
fn rank_deficient(case: &mut Case) -> Outcome {
    let n = 40;
    let a = DMatrix::from_fn(n, n, |i, j| match i.abs_diff(j) {
        0 if i == 0 || i + 1 == n => 1.0,
        0 => 2.0,
        1 => -1.0,
        _ => 0.0,
    });
    let b = right_hand_side(n);
    for (name, structure) in structures(n, 1) {
        refused(case, name, solve(&structure, &a, &b));
    }
    refused(case, "dense Cholesky", Cholesky::well_determined(n, a.as_slice()).map(|_| ()));
    let lower = Structure::SymmetricBand { half_bandwidth: 1 };
    let values = lower.values(n, |i, j| a[(i, j)]);
    refused(case, "band Cholesky", band::Cholesky::new(1, values.clone()).map(|_| ()));
    for ordering in [Ordering::Natural, Ordering::MinimumDegree] {
        let found = sparse::Cholesky::new(n, &lower, &values, ordering).map(|_| ());
        refused(case, &format!("sparse Cholesky, {ordering:?}"), found);
    }
    let columns: Vec<f64> = (0..3 * n).map(|i| wave(i, 3)).collect();
    let mut outer = vec![0.0; n * n];
    gram(View::new(&columns, n, 3), &mut outer);
    refused(case, "rank 3, dense Cholesky", Cholesky::well_determined(n, &outer).map(|_| ()));
    let values = eigenvalues(n, &outer)?;
    let zero = values[..n - 3].iter().fold(0.0, |m: f64, v| greater(m, v.abs())) / values[n - 1];
    case.at_most("rank 3: the n − 3 zero eigenvalues, of the largest", zero, 1e-14, "-")
        .because("n ε of the largest eigenvalue");
    // Lanczos iteration finds the space it cannot leave
    let mut iteration = Lanczos::new(n);
    let mut apply = |p: &[f64], out: &mut [f64]| {
        product(View::new(&outer, n, n), View::new(p, n, 1), out);
        Ok::<(), Error>(())
    };
    let limits = LanczosLimits { residual: 0.0, radius: f64::INFINITY, iterations: n };
    iteration.run(&mut apply, &columns[..n], &limits)?;
    case.at_most("rank 3: Lanczos iterations", iteration.iterations() as f64, 5.0, "-")
        .because("an invariant space of 3, one or two more where rounding hides it");
    Ok(())
}

fn not_a_number(case: &mut Case) -> Outcome {
    let n = 40;
    let b = right_hand_side(n);
    for (what, bad) in [("NaN", f64::NAN), ("infinity", f64::INFINITY)] {
        let mut a = dominant(n, 2);
        a[(20, 21)] = bad;
        a[(21, 20)] = bad;
        for (name, structure) in structures(n, 2) {
            refused(case, &format!("{what}: {name}"), solve(&structure, &a, &b));
        }
        refused(case, &format!("{what}: dense Cholesky"), Cholesky::new(n, a.as_slice()).map(|_| ()));
        let lower = Structure::SymmetricBand { half_bandwidth: 2 };
        let values = lower.values(n, |i, j| a[(i, j)]);
        refused(case, &format!("{what}: band Cholesky"), band::Cholesky::new(2, values.clone()).map(|_| ()));
        let found = sparse::Cholesky::new(n, &lower, &values, Ordering::MinimumDegree).map(|_| ());
        refused(case, &format!("{what}: sparse Cholesky"), found);
        refused(case, &format!("{what}: eigenvalues"), eigenvalues(n, a.as_slice()));
        refused(case, &format!("{what}: eigenvectors"), Eigen::new(n, a.as_slice()));
        let mut apply = |_: &[f64], out: &mut [f64]| {
            out.fill(bad);
            Ok::<f64, Error>(bad)
        };
        let limits = CgLimits { residual: 1e-12, iterations: n };
        let found = conjugate_gradients(&mut apply, b.as_slice(), &limits, &mut vec![0.0; n]);
        refused(case, &format!("{what}: conjugate gradients"), found);
        let mut apply = |_: &[f64], out: &mut [f64]| {
            out.fill(bad);
            Ok::<(), Error>(())
        };
        let mut iteration = Lanczos::new(n);
        iteration.begin(b.as_slice());
        refused(case, &format!("{what}: Lanczos iteration"), iteration.extend(&mut apply));
    }
    Ok(())
}

fn nothing(case: &mut Case) -> Outcome {
    let none = DVector::zeros(0);
    for (name, structure) in structures(0, 0) {
        let [x, y] = solve(&structure, &DMatrix::zeros(0, 0), &none)?;
        case.count(&format!("{name}: values of a solution"), x.len() + y.len(), 0);
        case.count(&format!("{name}: groups of columns"), structure.colouring(0).len(), 0);
    }
    let dense = Cholesky::well_determined(0, &[])?;
    dense.solve_columns(&mut []);
    let band = band::Cholesky::new(3, Vec::new())?;
    let pattern = Structure::from_pairs(0, [])?;
    let sparse = sparse::Cholesky::new(0, &pattern, &[], Ordering::MinimumDegree)?;
    case.count("unknowns of Cholesky factors", dense.dim() + band.dim() + sparse.dim(), 0);
    case.count("eigenvalues", eigenvalues(0, &[])?.len() + Eigen::new(0, &[])?.vectors.len(), 0);
    let mut out = [];
    product(View::new(&[], 0, 3), View::new(&[0.0; 6], 3, 2), &mut out);
    gram(View::new(&[], 0, 0), &mut out);
    let mut zeros = [f64::NAN; 4];
    product(View::new(&[], 2, 0), View::new(&[], 0, 2), &mut zeros);
    case.at_most("a sum of no products", zeros.iter().fold(0.0, |m, v| greater(m, v.abs())), 0.0, "-");
    let mut apply = |_: &[f64], _: &mut [f64]| Ok::<f64, Error>(0.0);
    let limits = CgLimits { residual: 0.0, iterations: 9 };
    let end = conjugate_gradients(&mut apply, &[], &limits, &mut [])?;
    case.count("conjugate gradients: iterations", end.iterations, 0);
    Ok(())
}

fn one(case: &mut Case) -> Outcome {
    let (a, b) = (DMatrix::from_element(1, 1, -4.0), DVector::from_element(1, 2.0));
    for (name, structure) in structures(1, 0) {
        let [x, y] = solve(&structure, &a, &b)?;
        case.at_most(name, greater((x[0] + 0.5).abs(), (y[0] + 0.5).abs()), 0.0, "-");
    }
    for structure in [Structure::Dense, Structure::SymmetricBand { half_bandwidth: 0 }] {
        refused(case, "zero", solve(&structure, &DMatrix::zeros(1, 1), &b));
    }
    // 1/d of a subnormal number overflows
    let tiny = DMatrix::from_element(1, 1, 1e-310);
    for (name, structure) in structures(1, 0).into_iter().take(3) {
        refused(case, &format!("subnormal, {name}"), solve(&structure, &tiny, &b));
    }
    let eigen = Eigen::new(1, &[-4.0])?;
    case.at_most("eigenvalue", (eigen.values[0] + 4.0).abs(), 0.0, "-");
    case.at_most("eigenvector", eigen.vectors[0].abs() - 1.0, 0.0, "-");
    let factor = sparse::Cholesky::new(1, &Structure::Dense, &[4.0], Ordering::MinimumDegree)?;
    case.at_most("sparse Cholesky", (factor.inverse_diagonal()[0] - 0.25).abs(), 0.0, "-");
    Ok(())
}

fn eigen(case: &mut Case, n: usize) -> Outcome {
    let a = DMatrix::from_fn(n, n, |i, j| wave(i.min(j) * 37 + i.max(j), 4));
    let Eigen { values, vectors } = Eigen::new(n, a.as_slice())?;
    let mut known: Vec<f64> = a.clone().symmetric_eigenvalues().iter().copied().collect();
    known.sort_by(f64::total_cmp);
    let scale = known[0].abs().max(known[n - 1].abs());
    case.reason("n ε of the largest eigenvalue, of both programs");
    let gap = |found: &[f64]| {
        found.iter().zip(&known).fold(0.0, |m: f64, (a, b)| greater(m, (a - b).abs())) / scale
    };
    case.at_most("eigenvalues against nalgebra", gap(&values), 1e-13, "-");
    case.at_most("eigenvalues alone", gap(&eigenvalues(n, a.as_slice())?), 1e-13, "-");
    let z = DMatrix::from_column_slice(n, n, &vectors);
    let residual = (&a * &z - &z * DMatrix::from_diagonal(&DVector::from_vec(values))).amax() / scale;
    case.at_most("A Z − Z D", residual, 1e-13, "-");
    let orthonormal = (z.transpose() * &z - DMatrix::identity(n, n)).amax();
    case.at_most("Zᵀ Z − I", orthonormal, 1e-13, "-").because("n ε");
    Ok(())
}

fn products(case: &mut Case, n: usize) -> Outcome {
    let m = n / 2 + 1;
    let a = DMatrix::from_fn(n, m, |i, j| wave(i + 5 * j, 5));
    let b = DMatrix::from_fn(n, m, |i, j| wave(3 * i + j, 6));
    let ours = |matrix: &DMatrix<f64>| Matrix::from_columns(n, m, matrix.as_slice().to_vec());
    let (p, q) = (ours(&a), ours(&b));
    let gap = |found: &[f64], known: DMatrix<f64>| {
        found.iter().zip(known.iter()).fold(0.0, |m: f64, (a, b)| greater(m, (a - b).abs()))
    };
    let bound = 4.0 * n as f64 * f64::EPSILON;
    case.reason("sums of n products of numbers below 1: n ε, four times for two programs");
    let mut c = vec![f64::NAN; m * m];
    product(p.transpose(), q.view(), &mut c);
    case.at_most("Aᵀ B against nalgebra", gap(&c, a.transpose() * &b), bound, "-");
    let mut c = vec![f64::NAN; n * n];
    gram(p.view(), &mut c);
    case.at_most("A Aᵀ against nalgebra", gap(&c, &a * a.transpose()), bound, "-");
    let sum = Matrix::identity(m).plus(-2.0, p.transpose(), q.view());
    let known = DMatrix::identity(m, m) - a.transpose() * &b * 2.0;
    case.at_most("I − 2 Aᵀ B against nalgebra", gap(sum.as_slice(), known), 2.0 * bound, "-");
    Ok(())
}

fn conjugate(case: &mut Case) -> Outcome {
    let n = 60;
    let a = dominant(n, 4);
    let b = right_hand_side(n);
    let expected = a.clone().lu().solve(&b).ok_or("nalgebra finds the matrix singular")?;
    let mut x = vec![0.0; n];
    let mut apply = |p: &[f64], out: &mut [f64]| {
        out.copy_from_slice((&a * DVector::from_column_slice(p)).as_slice());
        Ok::<f64, Error>(dot(p, out))
    };
    let limits = CgLimits { residual: 1e-13, iterations: n };
    let end = conjugate_gradients(&mut apply, b.as_slice(), &limits, &mut x)?;
    case.at_most("against nalgebra", relative(&x, &expected), 1e-12, "-")
        .because("a residual of 1e-13 times a condition number below 10");
    case.at_most("iterations", end.iterations as f64, 46.0, "-")
        .because("the error falls by (√10 − 1)/(√10 + 1) = 0.52 an iteration or faster: 1e-13 in 46");
    // three different eigenvalues: three iterations, whatever the size
    let mut apply = |p: &[f64], out: &mut [f64]| {
        out.iter_mut().enumerate().for_each(|(i, out)| *out = [1.0, 2.0, 5.0][i % 3] * p[i]);
        Ok::<f64, Error>(dot(p, out))
    };
    let end = conjugate_gradients(&mut apply, b.as_slice(), &limits, &mut x)?;
    case.count("three eigenvalues: iterations", end.iterations, 3);
    Ok(())
}

fn lanczos(case: &mut Case) -> Outcome {
    let n = 50;
    let a = dominant(n, 6);
    let start = right_hand_side(n);
    let mut iteration = Lanczos::new(n);
    let mut apply = |p: &[f64], out: &mut [f64]| {
        out.copy_from_slice((&a * DVector::from_column_slice(p)).as_slice());
        Ok::<(), Error>(())
    };
    let limits = LanczosLimits { residual: 0.0, radius: f64::INFINITY, iterations: n };
    iteration.run(&mut apply, start.as_slice(), &limits)?;
    let ritz = iteration.ritz()?;
    let mut known: Vec<f64> = a.clone().symmetric_eigenvalues().iter().copied().collect();
    known.sort_by(f64::total_cmp);
    let largest = ritz.values[ritz.values.len() - 1];
    case.at_most("largest eigenvalue", (largest - known[n - 1]).abs() / known[n - 1], 1e-13, "-")
        .because("the whole space: n ε");
    let k = ritz.values.len();
    let z = DMatrix::from_column_slice(n, k, &ritz.vectors);
    let orthonormal = (z.transpose() * &z - DMatrix::identity(k, k)).amax();
    case.at_most("Zᵀ Z − I", orthonormal, 1e-13, "-").because("re-orthogonalised twice: n ε");
    // a few iterations: residuals are what they are said to be
    let limits = LanczosLimits { iterations: 8, ..limits };
    iteration.run(&mut apply, start.as_slice(), &limits)?;
    let ritz = iteration.ritz()?;
    let mut worst: f64 = 0.0;
    for (i, z) in ritz.vectors.chunks_exact(n).enumerate() {
        let z = DVector::from_column_slice(z);
        let residual = norm((&a * &z - &z * ritz.values[i]).as_slice());
        worst = greater(worst, (residual - ritz.coupling[i].abs()).abs() / known[n - 1]);
    }
    case.at_most("residuals of Ritz pairs", worst, 1e-13, "-").because("n ε of the largest eigenvalue");
    Ok(())
}

/// −Δ + 1 on a square: sparse LU and Cholesky against each other, and a band.
fn grid(case: &mut Case) -> Outcome {
    let side = 30;
    let n = side * side;
    let near = |p: usize| {
        let (i, j) = (p % side, p / side);
        let x =
            [i.checked_sub(1), (i + 1 < side).then_some(i + 1)].into_iter().flatten().map(move |i| (i, j));
        let y =
            [j.checked_sub(1), (j + 1 < side).then_some(j + 1)].into_iter().flatten().map(move |j| (i, j));
        x.chain(y).map(move |(i, j)| i + side * j)
    };
    let structure = Structure::from_pairs(n, (0..n).flat_map(|p| near(p).chain([p]).map(move |q| (q, p))))?;
    let entry = |i: usize, j: usize| {
        if i == j {
            5.0
        } else if near(j).any(|q| q == i) {
            -1.0
        } else {
            0.0
        }
    };
    let values = structure.values(n, entry);
    let solution = right_hand_side(n);
    let mut b = vec![0.0; n];
    structure.product(&values, solution.as_slice(), &mut b);
    case.reason("condition below 9: some ε of each factorization");
    let mut solver = LinearSolver::new(n, &structure);
    let mut factor = solver.empty_factor();
    solver.factor(&values, &mut factor)?;
    let mut x = b.clone();
    solver.solve(&factor, &mut x);
    case.at_most("sparse LU", relative(&x, &solution), 1e-13, "-");
    let cholesky = sparse::Cholesky::new(n, &structure, &values, Ordering::MinimumDegree)?;
    let mut x = b.clone();
    cholesky.solve(&mut x);
    case.at_most("sparse Cholesky", relative(&x, &solution), 1e-13, "-");
    let natural = sparse::Cholesky::new(n, &structure, &values, Ordering::Natural)?;
    let share = cholesky.entries() as f64 / natural.entries() as f64;
    case.at_most("entries of minimum degree, of natural order", share, 0.6, "-")
        .because("5 n log₂ n against n^{3/2} for this side: fill must pay");
    let lower = Structure::SymmetricBand { half_bandwidth: side };
    let mut banded = lower.values(n, entry);
    case.count("negative pivots", band::ldlt_factor(side, &mut banded)?, 0);
    let mut x = b.clone();
    band::ldlt_solve(side, &banded, &mut x);
    case.at_most("band LDLᵀ", relative(&x, &solution), 1e-13, "-");
    case.at_most("groups of columns", structure.colouring(n).len() as f64, 9.0, "-")
        .because("five share a row at least; first fit needs a few more");
    Ok(())
}

/// Drops the result of a call that did not fail.
fn done<T>(_: T) -> Outcome {
    Ok(())
}

/// Calls into code for wide registers return with the upper halves clear: read from the processor.
fn registers(case: &mut Case) -> Outcome {
    let n = 144;
    let a = dominant(n, 10);
    let view = View::new(a.as_slice(), n, n);
    let (mut c, mut d) = (vec![0.0; n * n], vec![0.0; n * n]);
    let mut solver = LinearSolver::new(n, &Structure::Dense);
    let mut factor = solver.empty_factor();
    let mut calls: Vec<(&str, Box<dyn FnMut() -> Outcome + '_>)> = vec![
        (
            "a product",
            Box::new(|| {
                product(view, view, &mut c);
                Ok(())
            }),
        ),
        (
            "a symmetric product",
            Box::new(|| {
                gram(view, &mut d);
                Ok(())
            }),
        ),
        ("eigenvectors", Box::new(|| done(Eigen::new(n, a.as_slice())?))),
        ("eigenvalues", Box::new(|| done(eigenvalues(n, a.as_slice())?))),
        ("Cholesky", Box::new(|| done(Cholesky::new(n, a.as_slice())?))),
        ("LU", Box::new(|| done(solver.factor(a.as_slice(), &mut factor)?))),
    ];
    for (what, call) in &mut calls {
        call()?;
        let used = upper_halves_in_use();
        let row = case.at_most(&format!("in use after {what}"), f64::from(used == Some(true)), 0.0, "-");
        if used.is_none() {
            row.note("this processor does not tell");
        }
    }
    Ok(())
}
