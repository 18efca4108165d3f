//! The check of a user's covariance: everything shipped passes, and every single fault is found.

use varda_covariance::{
    Banded, BlockDiagonal, Covariance, CovarianceFunction, Dense, Diagonal, Diffusion, Ensemble, Grid,
    Hybrid, Interleaved, Kernel, Kronecker, Localization, Precision, Scaled, SparsePrecision, Sum, Taper,
    Truncated, check,
};

const GAUSSIAN: CovarianceFunction =
    CovarianceFunction { sigma: 2e-3, kernel: Kernel::Gaussian { length: 0.4 }, taper: Taper::None };

fn places(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.1 * i as f64).collect()
}

fn tapered() -> CovarianceFunction {
    CovarianceFunction { taper: Taper::Triangle { support: 0.7 }, ..GAUSSIAN }
}

fn dense(n: usize) -> Dense {
    Dense::new(n, &tapered().matrix(&places(n)).unwrap()).unwrap()
}

#[track_caller]
fn passes(b: &(impl Covariance + ?Sized)) {
    let report = check::covariance(b, 5);
    assert!(report.passed(), "{report}");
}

#[track_caller]
fn inverse_passes(b: &(impl Precision + ?Sized)) {
    let report = check::precision(b, 5);
    assert!(report.passed(), "{report}");
    passes(b);
}

#[test]
fn everything_with_an_inverse_passes() {
    inverse_passes(&Diagonal::new(vec![1e-9, 3.0, 1e12]).unwrap());
    inverse_passes(&dense(20));
    inverse_passes(&dense(150));
    inverse_passes(&Banded::along(&tapered(), &places(3000)).unwrap());
    // ill-conditioned, as far as Cholesky goes
    let matern = CovarianceFunction { kernel: Kernel::Matern52 { length: 30.0 }, ..GAUSSIAN };
    inverse_passes(&Dense::new(40, &matern.matrix(&places(40)).unwrap()).unwrap());
    let grid = Grid::rectangle([30, 20], [1.0, 1.0]).unwrap();
    inverse_passes(&SparsePrecision::matern(grid, 0.5, 6.0, 2).unwrap());
    inverse_passes(&Diffusion::new(grid, &[0.5; 600], 5.0, 10).unwrap());
    inverse_passes(&Interleaved::new(dense(9), 3));
    inverse_passes(&BlockDiagonal::new(vec![dense(9), dense(4)]));
    inverse_passes(&Kronecker::new(dense(4), dense(30)));
    inverse_passes(&Scaled::new(dense(3), vec![1e6, 1.0, 1e-6]).unwrap());
}

#[test]
fn everything_without_an_inverse_passes() {
    let matrix = GAUSSIAN.matrix(&places(100)).unwrap();
    passes(&Truncated::eigen(100, &matrix, 1e-4).unwrap());
    passes(&Truncated::pivoted_cholesky(100, &matrix, 1e-4).unwrap());
    passes(&Sum::new(vec![dense(20), dense(20)]).unwrap());
    let members: Vec<f64> = (0..5 * 30).map(|i| ((i * i) as f64 * 0.37).sin()).collect();
    let taper = Taper::GaspariCohn { support: 0.8 };
    for localization in [
        Localization::none(30),
        Localization::by_distance(taper, 30, |i, j| 0.1 * i.abs_diff(j) as f64, 1e-6).unwrap(),
    ] {
        let ensemble = Ensemble::new(&members, localization).unwrap();
        passes(&ensemble);
        let part = dense(30);
        passes(&Hybrid::new(&part, 0.4, ensemble, 0.6).unwrap());
    }
}

/// B, and what is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    Asymmetric,
    Negative,
    Variance,
    Root,
    RootTranspose,
    NotLinear,
    Unwritten,
    NotANumber,
    Solve,
    Whiten,
    WhitenTranspose,
    LastBits,
}

struct Mutant {
    part: Dense,
    fault: Fault,
    calls: std::cell::Cell<u32>,
}

impl Mutant {
    fn new(n: usize, fault: Fault) -> Self {
        Self { part: dense(n), fault, calls: std::cell::Cell::new(0) }
    }

    /// One entry of a product, in the middle, wrong by a share of σ or of 1/σ.
    fn wrong(&self, fault: Fault, x: &[f64], y: &mut [f64], size: f64) {
        if self.fault == fault {
            let i = y.len() / 2;
            y[i] += 1e-4 * size * x[i - 1];
        }
    }
}

const SIGMA: f64 = GAUSSIAN.sigma;

impl Covariance for Mutant {
    fn dim(&self) -> usize {
        self.part.dim()
    }
    fn root_dim(&self) -> usize {
        self.part.root_dim()
    }
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let last = y[y.len() - 1];
        self.part.apply(x, y);
        self.wrong(Fault::Asymmetric, x, y, SIGMA * SIGMA);
        self.calls.set(self.calls.get() + 1);
        match self.fault {
            // symmetric, of the same variance, and not positive
            Fault::Negative => {
                y[0] += 0.5 * SIGMA * SIGMA * x[1];
                y[1] += 0.5 * SIGMA * SIGMA * x[0];
            }
            Fault::NotLinear => y[3] += 1e-6 * SIGMA * x[3].abs().sqrt(),
            Fault::Unwritten => *y.last_mut().unwrap() = last,
            Fault::NotANumber => y[2] = f64::NAN,
            Fault::LastBits if self.calls.get().is_multiple_of(3) => y[0] *= 1.0 + 2.0 * f64::EPSILON,
            _ => {}
        }
    }
    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.part.root(v, x);
        self.wrong(Fault::Root, v, x, SIGMA);
    }
    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.part.root_transpose(x, v);
        self.wrong(Fault::RootTranspose, x, v, SIGMA);
    }
    fn variance(&self, variance: &mut [f64]) {
        self.part.variance(variance);
        if self.fault == Fault::Variance {
            variance[4] *= 1.0 + 1e-6;
        }
    }
}

impl Precision for Mutant {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.part.solve(x, y);
        self.wrong(Fault::Solve, x, y, 1.0 / (SIGMA * SIGMA));
    }
    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.part.whiten(x, v);
        self.wrong(Fault::Whiten, x, v, 1.0 / SIGMA);
    }
    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.part.whiten_transpose(v, x);
        self.wrong(Fault::WhitenTranspose, v, x, 1.0 / SIGMA);
    }
}

#[test]
fn every_single_fault_is_found_and_named() {
    let cases = [
        (Fault::None, ""),
        (Fault::Asymmetric, "product: ⟨x, B y⟩ − ⟨B x, y⟩"),
        (Fault::Asymmetric, "product: B_ij − B_ji in units of σ_i σ_j"),
        (Fault::Negative, "product: most negative eigenvalue"),
        (Fault::Negative, "root: B^{1/2} B^{T/2} x − B x"),
        (Fault::Variance, "variance: difference to the diagonal of B"),
        (Fault::Root, "root transposed: ⟨B^{1/2} v, x⟩ − ⟨v, B^{T/2} x⟩"),
        (Fault::RootTranspose, "root transposed: ⟨B^{1/2} v, x⟩ − ⟨v, B^{T/2} x⟩"),
        (Fault::NotLinear, "product: departure from linearity"),
        (Fault::Unwritten, "product: values not written, or not finite"),
        (Fault::NotANumber, "product: values not written, or not finite"),
        (Fault::LastBits, "product: values that differ when run again"),
        (Fault::Solve, "solve: B B⁻¹ x − x"),
        (Fault::Whiten, "whiten: B^{1/2} B^{-1/2} x − x"),
        (Fault::WhitenTranspose, "whiten transposed: B^{T/2} B^{-T/2} v − v"),
    ];
    // the second is larger than what is looked at entry by entry
    for (n, (fault, expected)) in [20, 200].into_iter().flat_map(|n| cases.map(|case| (n, case))) {
        let sampled = n > 64 && (expected.contains("_ij") || expected.contains("eigenvalue"));
        if sampled || n > 64 && matches!(fault, Fault::Variance) {
            continue; // only found where that entry is among those drawn
        }
        let report = check::precision(&Mutant::new(n, fault), 1);
        let found = report.failed().any(|finding| finding.what.starts_with(expected));
        assert_eq!(found, fault != Fault::None, "{n} components, {fault:?}:\n{report}");
        assert_eq!(report.passed(), fault == Fault::None, "{report}");
    }
}

#[test]
fn what_cannot_be_judged_does_not_pass() {
    let report = check::covariance(&Diagonal::new(Vec::new()).unwrap(), 1);
    assert!(!report.passed(), "{report}");
    struct Zero;
    impl Covariance for Zero {
        fn dim(&self) -> usize {
            3
        }
        fn root_dim(&self) -> usize {
            1
        }
        fn apply(&self, _: &[f64], y: &mut [f64]) {
            y.fill(0.0);
        }
        fn root(&self, _: &[f64], x: &mut [f64]) {
            x.fill(0.0);
        }
        fn root_transpose(&self, _: &[f64], v: &mut [f64]) {
            v.fill(0.0);
        }
        fn variance(&self, variance: &mut [f64]) {
            variance.fill(0.0);
        }
    }
    assert!(!check::covariance(&Zero, 1).passed());
}
