//! No component, one component, one member, no columns: an answer that is right, or a typed error; no panic.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::*;
use varda_linalg::Structure;

type Made = Result<Box<dyn Covariance>, Error>;

fn boxed<C: Covariance + 'static>(made: Result<C, Error>) -> Made {
    made.map(|c| Box::new(c) as Box<dyn Covariance>)
}

/// Every covariance of `n` components of variance 4 there is a constructor for.
fn every(n: usize) -> Vec<(&'static str, Made)> {
    let places: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let matrix: Vec<f64> = (0..n * n).map(|e| if e % (n + 1) == 0 { 4.0 } else { 0.0 }).collect();
    let kernel = |taper| CovarianceFunction { sigma: 2.0, kernel: Kernel::Gaussian { length: 0.5 }, taper };
    let diagonal = || Diagonal::uniform(n, 2.0);
    let by_grid = || Grid::line(n, 1.0);
    let members: Vec<f64> = [-1.0, 1.0].iter().flat_map(|s| vec![s * 2.0_f64.sqrt(); n]).collect();
    vec![
        ("dense", boxed(Dense::new(n, &matrix))),
        ("diagonal", boxed(diagonal())),
        ("banded", boxed(Banded::new(n, 0, vec![4.0; n]))),
        ("along", boxed(Banded::along(&kernel(Taper::GaspariCohn { support: 0.7 }), &places))),
        (
            "markov",
            boxed(Markov::new(
                &CovarianceFunction {
                    sigma: 2.0,
                    kernel: Kernel::Matern52 { length: 0.5 },
                    taper: Taper::None,
                },
                &places,
                &[],
            )),
        ),
        ("eigen", boxed(Truncated::eigen(n, &matrix, 1e-10))),
        ("kernel", boxed(Truncated::of_kernel(n, &matrix, 1e-10, 4.0))),
        ("pivoted", boxed(Truncated::pivoted_cholesky(n, &matrix, 1e-10))),
        ("interleaved", boxed(diagonal().map(|d| Interleaved::new(d, 1)))),
        ("blocks", boxed(diagonal().map(|d| BlockDiagonal::new(vec![d])))),
        ("sum", boxed(Diagonal::uniform(n, 2.0_f64.sqrt()).and_then(|d| Sum::new(vec![d.clone(), d])))),
        ("scaled", boxed(Diagonal::uniform(n, 1.0).and_then(|d| Scaled::uniform(d, 2.0)))),
        ("kronecker", boxed(diagonal().and_then(|d| Ok(Kronecker::new(Diagonal::uniform(1, 1.0)?, d))))),
        (
            "sparse precision",
            boxed(SparsePrecision::new(
                n,
                Structure::Band { half_bandwidth: 0 },
                vec![0.25; n],
                Ordering::Natural,
            )),
        ),
        ("matern", boxed(by_grid().and_then(|grid| SparsePrecision::matern(grid, 2.0, 1.0, 2)))),
        ("diffusion", boxed(by_grid().and_then(|grid| Diffusion::new(grid, &vec![2.0; n], 1.0, 4)))),
        ("members", boxed(Ensemble::new(&members, Localization::none(n)))),
        ("columns", boxed(Ensemble::from_perturbations(&vec![2.0; n], Localization::none(n)))),
    ]
}

/// Products, roots, variances, draws and the spectrum agree with each other.
fn consistent(name: &str, b: &dyn Covariance, n: usize) {
    assert_eq!(b.dim(), n, "{name}");
    let mut variance = vec![f64::NAN; n];
    b.variance(&mut variance);
    let unit = vec![1.0; n];
    let mut applied = vec![f64::NAN; n];
    b.apply(&unit, &mut applied);
    let mut root = vec![0.0; n];
    let mut squares = vec![0.0; n];
    let mut xi = vec![0.0; b.root_dim()];
    for j in 0..b.root_dim() {
        xi[j] = 1.0;
        b.root(&xi, &mut root);
        xi[j] = 0.0;
        squares.iter_mut().zip(&root).for_each(|(s, r)| *s += r * r);
    }
    for i in 0..n {
        // one component: B is its variance, 4, by one product or another of a few roundings
        let close = |v: f64| (v - variance[i]).abs() <= 1e-12 * variance[i];
        assert!(variance[i] > 0.0 && close(applied[i]) && close(squares[i]), "{name} {i}");
    }
    assert_eq!(sample(b, &mut ChaCha8Rng::seed_from_u64(1)).len(), n, "{name}");
    let spectrum = Spectrum::of(b).unwrap_or_else(|e| panic!("{name}: {e}"));
    let total: f64 = variance.iter().sum();
    assert!((spectrum.total_variance() - total).abs() <= 1e-12 * total, "{name}");
    assert!(!spectrum.effective_rank().is_nan() && !spectrum.explained_variance(1).is_nan(), "{name}");
}

#[test]
fn one_component_has_its_variance() {
    for (name, made) in every(1) {
        let b = made.unwrap_or_else(|e| panic!("{name}: {e}"));
        consistent(name, b.as_ref(), 1);
        let mut variance = [0.0];
        b.variance(&mut variance);
        // Matérn's and diffusion's σ holds away from the ends of a grid, of which one point has none.
        if !["matern", "diffusion"].contains(&name) {
            assert!((variance[0] - 4.0).abs() <= 1e-12, "{name} {}", variance[0]);
        }
    }
}

#[test]
fn no_component_is_an_empty_covariance_or_a_typed_error() {
    for (name, made) in every(0) {
        match made {
            Ok(b) => consistent(name, b.as_ref(), 0),
            Err(error) => assert!(!error.to_string().is_empty(), "{name}"),
        }
    }
}

#[test]
fn no_parts_no_members_no_places() {
    assert!(Ensemble::new(&[], Localization::none(3)).is_err());
    assert!(Ensemble::new(&[1.0, 2.0, 3.0], Localization::none(3)).is_err(), "one member has no spread");
    assert!(Sum::<Diagonal>::new(Vec::new()).is_err());
    assert_eq!(BlockDiagonal::<Diagonal>::new(Vec::new()).dim(), 0);
    let kernel =
        CovarianceFunction { sigma: 1.0, kernel: Kernel::Gaussian { length: 1.0 }, taper: Taper::None };
    assert_eq!(kernel.matrix(&[]).unwrap(), Vec::<f64>::new());
    assert_eq!(kernel.conditioned_matrix(&[], &[0.0]).unwrap(), Vec::<f64>::new());
    assert_eq!(kernel.conditioned_matrix(&[0.0], &[]).unwrap(), [1.0]);
    // on its known point nothing is left to vary
    assert!(kernel.conditioned_matrix(&[0.0], &[0.0]).unwrap()[0].abs() <= 1e-12);
    for periodic in [false, true] {
        for n in [0, 1] {
            let Ok(grid) = Grid::line(n, 1.0) else { continue };
            let grid = if periodic { grid.periodic() } else { grid };
            assert_eq!(grid.dim(), n);
        }
    }
    let none = Spectrum::new(Vec::new());
    assert_eq!((none.total_variance(), none.effective_rank()), (0.0, 0.0));
    assert!(none.reliable_condition_number().is_none_or(|c| c >= 1.0));
}
