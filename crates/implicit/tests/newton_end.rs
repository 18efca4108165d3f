//! Where Newton's method ends.

use varda_implicit::{Equations, NewtonOptions, NewtonReport, NewtonWork, Refusal, Structure, solve};

/// u² = 2, or u = 1 with a slope that is off by a share.
struct Scalar {
    slope_off: Option<f64>,
    converged: f64,
    trusted: f64,
}

impl Equations for Scalar {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let slope = match self.slope_off {
            Some(share) => {
                g[0] = u[0] - 1.0;
                1.0 + share
            }
            None => {
                g[0] = u[0] * u[0] - 2.0;
                2.0 * u[0]
            }
        };
        if let Some(values) = jacobian {
            values[0] = slope;
        }
        Ok(None)
    }
    fn converged_below(&self) -> f64 {
        self.converged
    }
    fn trusted_below(&self) -> f64 {
        self.trusted
    }
}

fn solved(mut equations: Scalar, start: f64) -> (NewtonReport, f64) {
    let mut work = NewtonWork::new(1, &Structure::SymmetricBand { half_bandwidth: 0 });
    let mut u = [start];
    let report = solve(&mut equations, &mut u, &mut work, &NewtonOptions::default()).unwrap();
    (report, u[0])
}

/// Updates from 1.5 are 8.3e-2, 2.5e-3, 2.1e-6 and 1.6e-12: the fourth is foretold by the three.
#[test]
fn an_update_that_is_foretold_below_the_tolerance_is_not_computed() {
    let root = |trusted| solved(Scalar { slope_off: None, converged: 1e-10, trusted }, 1.5);
    let (report, u) = root(1e-4);
    assert_eq!(report.iterations, 3);
    assert!((u - 2.0_f64.sqrt()).abs() < 1e-11 && report.last_update > 1e-6, "{u}, {report:?}");
    // an update that is tested ends nothing
    assert_eq!(root(1e-7).0.iterations, 4);
}

/// Updates that shrink by one share, as with a Jacobian that is off: by 101 they are not foretold.
#[test]
fn updates_that_shrink_slowly_are_computed() {
    let off = |share, converged| {
        let equations = Scalar { slope_off: Some(share), converged, trusted: 1e-2 };
        let (report, u) = solved(equations, 2.0);
        assert!((u - 1.0).abs() <= converged, "{u}");
        report.iterations
    };
    // 0.99, 9.8e-3, 9.7e-5, 9.6e-7
    assert_eq!(off(0.01, 1e-5), 4);
    // 1, 1e-3, 1e-6: the fourth would be 1e-9
    assert_eq!(off(0.001, 2e-9), 3);
    assert_eq!(off(0.001, 0.5e-9), 4);
}
