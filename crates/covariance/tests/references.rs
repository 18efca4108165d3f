//! Against numbers from elsewhere: independent NumPy computations of a twin problem and of the hanging rod's
//! prior, and what is known of singular kernels.

use varda_covariance::{
    Covariance, CovarianceFunction, Dense, Error, Interleaved, Kernel, Precision, Spectrum, Taper, Truncated,
};

fn relative(value: f64, expected: f64) -> f64 {
    (value - expected).abs() / expected.abs()
}

fn even_places(n: usize) -> Vec<f64> {
    (0..n).map(|i| i as f64 / (n - 1) as f64).collect()
}

/// The linear 3D-Var twin: its B (a symmetric Toeplitz matrix, of which the first row is kept here) and
/// condition number.
#[test]
fn b_of_the_linear_twin() {
    let row: Vec<f64> =
        include_str!("data/lin3dvar-b-first-row.txt").lines().map(|x| x.parse().unwrap()).collect();
    let n = 100;
    assert_eq!(row.len(), n);
    let function = CovarianceFunction {
        sigma: 0.5,
        kernel: Kernel::Gaussian { length: 0.1 },
        taper: Taper::Triangle { support: 1.0 },
    };
    let matrix = function.matrix(&even_places(n)).unwrap();
    for i in 0..n {
        for j in 0..n {
            // Differences of places carry an ε, worth up to d/L² ε = 100 ε of the kernel.
            assert!((matrix[i * n + j] - row[i.abs_diff(j)]).abs() <= 100.0 * f64::EPSILON * 0.25);
        }
    }

    let b = Dense::new(n, &matrix).unwrap();
    // An ε of the largest eigenvalue is cond ε of the smallest: n ε cond = 1e-10.
    assert!(relative(Spectrum::of(&b).unwrap().condition_number(), 4350.786829883308) <= 1e-10);

    // tr(B − B Hᵀ (H B Hᵀ + R)⁻¹ H B), every fourth point observed with σ = 0.05: the twin's
    // posterior trace.
    let observed: Vec<usize> = (0..n).step_by(4).collect();
    let m = observed.len();
    let mut hbht: Vec<f64> = observed
        .iter()
        .flat_map(|&i| observed.iter().map(move |&j| (i, j)))
        .map(|(i, j)| matrix[i * n + j])
        .collect();
    for k in 0..m {
        hbht[k * m + k] += 0.05 * 0.05;
    }
    let innovation = Dense::new(m, &hbht).unwrap();
    let mut trace = 0.0;
    let mut white = vec![0.0; m];
    for i in 0..n {
        let covariances: Vec<f64> = observed.iter().map(|&j| matrix[i * n + j]).collect();
        innovation.whiten(&covariances, &mut white);
        trace += matrix[i * n + i] - white.iter().map(|w| w * w).sum::<f64>();
    }
    assert!(relative(trace, 0.5301318564552225) <= 1e-11, "{trace}");
}

/// The hanging rod, 25 segments over 1 m, vertices 0 and 1 clamped: prior variances of the free vertices'
/// positions (σ = 0.05 m).
#[test]
fn prior_of_the_clamped_rod() {
    const VARIANCE: [f64; 24] = [
        2.0284505799328391e-07,
        1.7947946267923846e-06,
        6.9986820760117875e-06,
        1.879424961002102e-05,
        4.0544964777690094e-05,
        7.557913725342785e-05,
        0.00012677757861932122,
        0.00019621714665258197,
        0.00028491006170608017,
        0.0003926646253042965,
        0.0005180762860695717,
        0.0006586414525378674,
        0.0008109723696266256,
        0.0009710814817736824,
        0.001134698915280128,
        0.0012975870748112791,
        0.0014558211498838178,
        0.001606012303660502,
        0.0017454599338119707,
        0.0018722291264296922,
        0.0019851579819816167,
        0.0020838059835108294,
        0.002168358563112257,
        0.002239504496285266,
    ];
    let place = |i: usize| i as f64 / 25.0;
    let function = CovarianceFunction {
        sigma: 0.05,
        kernel: Kernel::Gaussian { length: 0.5 },
        taper: Taper::Triangle { support: 1.0 },
    };
    let free: Vec<f64> = (2..26).map(place).collect();
    let matrix = function.conditioned_matrix(&free, &[place(0), place(1)]).unwrap();
    let b = Interleaved::new(Dense::new(24, &matrix).unwrap(), 3);
    let mut variance = vec![0.0; 72];
    b.variance(&mut variance);
    for (i, value) in variance.iter().enumerate() {
        // cond(k_cc) = 624 times ε, of a variance that conditioning leaves at 8e-5 of what it was.
        assert!(relative(*value, VARIANCE[i / 3]) <= 2e-9, "{i}: {value}");
    }
    // n ε cond = 6e-9 for the smallest eigenvalue, and the same cancellation in the entries.
    assert!(relative(Spectrum::of(&b).unwrap().condition_number(), 1177661.1386432357) <= 1e-7);

    // Taken the other way round, taper before conditioning, the numbers differ: the order matters and is
    // checked above.
    let all: Vec<f64> = (0..26).map(place).collect();
    let full = function.matrix(&all).unwrap();
    let known = Dense::new(2, &[full[0], full[1], full[26], full[27]]).unwrap();
    let mut white = [0.0; 2];
    known.whiten(&[full[2 * 26], full[2 * 26 + 1]], &mut white);
    let tapered_first = full[2 * 26 + 2] - white.iter().map(|w| w * w).sum::<f64>();
    assert!(relative(tapered_first, VARIANCE[0]) > 0.1);
}

/// The Gaussian kernel at L/5 over a hundred points: condition number 1e25 in exact arithmetic.
#[test]
fn a_smooth_kernel_is_singular() {
    let n = 100;
    let smooth =
        CovarianceFunction { sigma: 1.0, kernel: Kernel::Gaussian { length: 0.2 }, taper: Taper::None };
    let matrix = smooth.matrix(&even_places(n)).unwrap();
    let error = Dense::new(n, &matrix).unwrap_err();
    assert!(matches!(error, Error::Singular { pivot, .. } if pivot > 5), "{error:?}");
    let text = error.to_string();
    assert!(text.contains("singular") && text.contains("taper") && text.contains("truncated root"), "{text}");

    let tolerance = 1e-10;
    let eigen = Truncated::eigen(n, &matrix, tolerance).unwrap();
    let pivoted = Truncated::pivoted_cholesky(n, &matrix, tolerance).unwrap();
    let largest = eigen.spectrum().unwrap().eigenvalues[0];
    for (b, bound) in [(&eigen, tolerance * largest), (&pivoted, tolerance)] {
        assert!(b.root_dim() < 25, "{}", b.root_dim());
        assert!(b.explained_variance() > 1.0 - 1e-9 && b.explained_variance() < 1.0 + 1e-14);
        let (mut unit, mut column) = (vec![0.0; n], vec![0.0; n]);
        for j in 0..n {
            unit[j] = 1.0;
            b.apply(&unit, &mut column);
            unit[j] = 0.0;
            for i in 0..n {
                assert!((column[i] - matrix[i * n + j]).abs() <= bound + 1e-13);
            }
        }
    }
    assert!(eigen.spectrum().unwrap().condition_number().is_infinite());
    assert!(eigen.spectrum().unwrap().effective_rank() < 10.0);

    // The paper's taper is enough for a Cholesky root.
    let localized = CovarianceFunction { taper: Taper::Triangle { support: 1.0 }, ..smooth };
    let b = Dense::new(n, &localized.matrix(&even_places(n)).unwrap()).unwrap();
    assert!(Spectrum::of(&b).unwrap().condition_number() < 1e5);
}

/// The triangle is a covariance along a line only: on a square lattice it is found out, where Gaspari–Cohn
/// is not.
#[test]
fn the_triangle_fails_in_two_dimensions() {
    let m = 12;
    let distance = |i: usize, j: usize| {
        let (x, y) = ((i / m).abs_diff(j / m) as f64, (i % m).abs_diff(j % m) as f64);
        x.hypot(y)
    };
    let function =
        |taper| CovarianceFunction { sigma: 1.0, kernel: Kernel::Gaussian { length: 100.0 }, taper };
    let root = |taper| Truncated::eigen(m * m, &function(taper).matrix_by(m * m, distance).unwrap(), 1e-10);
    let triangle = root(Taper::Triangle { support: 2.0 });
    assert!(
        matches!(triangle, Err(Error::NotPositiveSemidefinite { value, .. }) if value < -1e-3),
        "{triangle:?}"
    );
    assert!(root(Taper::GaspariCohn { support: 2.0 }).is_ok());
}

/// Distances other than along a line go through the same conditioning.
#[test]
fn any_distance_gives_the_same_matrix() {
    let function = CovarianceFunction {
        sigma: 2.0,
        kernel: Kernel::Matern52 { length: 0.3 },
        taper: Taper::GaspariCohn { support: 0.8 },
    };
    let places = [0.1_f64, 0.4, 0.5, 0.9, 0.0];
    let distance = |i: usize, j: usize| (places[i] - places[j]).abs();
    assert_eq!(function.matrix(&places).unwrap(), function.matrix_by(5, distance).unwrap());
    assert_eq!(
        function.conditioned_matrix(&places[..3], &places[3..]).unwrap(),
        function.conditioned_matrix_by(3, 2, distance).unwrap()
    );
}
