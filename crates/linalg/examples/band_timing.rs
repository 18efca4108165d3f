//! Times the symmetric band solver: factor and solve, in microseconds, for the matrices of a rod of 25 segments and more.
#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use varda_linalg::band::{ldlt_factor, ldlt_solve};

fn main() {
    println!("{:>7} {:>3} {:>19} {:>19}", "n", "w", "factor [µs]", "solve [µs]");
    println!("{:>7} {:>3} {:>9} {:>9} {:>9} {:>9}", "", "", "least", "median", "least", "median");
    for (n, w) in [(69, 5), (72, 8), (103, 10), (399, 10), (3999, 10), (103, 11)] {
        let matrix = rod_like(n, w);
        let right: Vec<f64> = (0..n).map(|i| (0.7 * i as f64).sin()).collect();
        let (mut factor, mut b) = (matrix.clone(), right.clone());
        let factored = timed(n, || {
            factor.copy_from_slice(&matrix);
            ldlt_factor(w, black_box(&mut factor)).expect("positive definite");
        });
        let solved = timed(n, || {
            b.copy_from_slice(&right);
            ldlt_solve(w, black_box(&factor), black_box(&mut b));
        });
        println!("{n:>7} {w:>3} {:>9.3} {:>9.3} {:>9.3} {:>9.3}", factored.0, factored.1, solved.0, solved.1);
    }
}

/// Diagonally dominant, with every entry of the band in use.
fn rod_like(n: usize, w: usize) -> Vec<f64> {
    let entry = |i: usize, p: usize| match p {
        _ if i + p < w => 0.0,
        _ if p == w => 2.0 * w as f64,
        _ => (0.3 * (i * w + p) as f64).sin(),
    };
    (0..n).flat_map(|i| (0..=w).map(move |p| entry(i, p))).collect()
}

/// Least and median over batches of the time of one call [µs].
fn timed(n: usize, mut call: impl FnMut()) -> (f64, f64) {
    let repeats = 100_000 / n + 1;
    let mut batches: Vec<f64> = (0..51)
        .map(|_| {
            let start = Instant::now();
            (0..repeats).for_each(|_| call());
            start.elapsed().as_secs_f64() * 1e6 / repeats as f64
        })
        .collect();
    batches.sort_by(f64::total_cmp);
    (batches[0], batches[25])
}
