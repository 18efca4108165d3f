//! The check of an observation operator: every single fault is found.

use varda_implicit::{At, Error, ObservationOperator, Refusal, check};

/// y = (x₀ / x₁, x₁ x₂ + t, 10⁶ x₂) with a mistake.
struct Mutant {
    fault: &'static str,
    /// What a careless operator remembers of the last state observed.
    kept: [f64; 3],
    calls: usize,
}

impl Mutant {
    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    /// The rows of H′.
    fn derivative(&self, x: &[f64]) -> [[f64; 3]; 3] {
        let x = if self.is("tangent of the state last observed") { &self.kept } else { x };
        [[1.0 / x[1], -x[0] / (x[1] * x[1]), 0.0], [0.0, x[2], x[1]], [0.0, 0.0, 1e6]]
    }
}

impl ObservationOperator for Mutant {
    fn dim(&self) -> usize {
        if self.is("no rows") { 0 } else { 3 }
    }
    fn state_dim(&self) -> usize {
        3
    }
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        if self.is("refusal") {
            return Err(Refusal::new("not today"));
        }
        self.kept.copy_from_slice(x);
        self.calls += 1;
        y[0] = x[0] / x[1];
        y[1] = x[1] * x[2] + at.time;
        if self.is("calls") {
            y[1] *= 1.0 + f64::EPSILON * self.calls as f64;
        }
        if !self.is("y unwritten") {
            y[2] = 1e6 * x[2];
        }
        Ok(())
    }
    fn tangent(&mut self, _: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        for (row, dy) in self.derivative(x).iter().zip(&mut *dy) {
            *dy = row.iter().zip(dx).map(|(h, dx)| h * dx).sum();
        }
        match self.fault {
            "tangent: a factor" => dy[0] *= 1.001,
            "tangent: not linear" => dy[1] += 1e-6 * dx[0].abs(),
            "tangent: not zero" => dy[1] += 1e-3,
            "tangent: NaN" => dy[0] = f64::NAN,
            "tangent is zero" => dy.fill(0.0),
            _ => {}
        }
    }
    fn adjoint_add(&mut self, _: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        if self.is("adjoint overwrites") {
            dx.fill(0.0);
        }
        for (row, dy) in self.derivative(x).iter().zip(dy) {
            row.iter().zip(&mut *dx).for_each(|(h, dx)| *dx += h * dy);
        }
        if self.is("adjoint: an entry") {
            dx[2] += 1e-6 * dy[1];
        }
    }
}

fn report(fault: &'static str) -> Result<check::Report, Error> {
    let mut mutant = Mutant { fault, kept: [1.0; 3], calls: 0 };
    check::operator(&mut mutant, At { step: 3, time: 0.7 }, &[2.0, 0.9, -0.4], &[0.1, 0.1, 1e-3], 11)
}

#[test]
fn every_single_fault_is_found_and_named() {
    let sound = report("").unwrap();
    assert!(sound.passed(), "{sound}");
    for (fault, finding) in [
        ("no rows", "sizes"),
        ("calls", "observe: values that differ when run again"),
        ("y unwritten", "values that are not written"),
        ("tangent of the state last observed", "tangent: values that differ after another state"),
        ("tangent of the state last observed", "adjoint: values that differ after another state"),
        ("tangent: a factor", "tangent: 2 − Taylor slope"),
        ("tangent: a factor", "adjoint: dot product"),
        ("tangent: not linear", "tangent: departure from linearity"),
        ("tangent: not zero", "tangent: values of H′ 0 that are not zero"),
        ("tangent: NaN", "values that are not written, or not finite"),
        ("adjoint overwrites", "adjoint: difference where dx is not zero before"),
        ("adjoint: an entry", "adjoint: dot product"),
    ] {
        let report = report(fault).unwrap();
        assert!(report.failed().any(|f| f.what.starts_with(finding)), "{fault}:\n{report}");
    }
}

#[test]
fn what_cannot_be_judged_is_an_error() {
    assert!(matches!(report("tangent is zero"), Err(Error::EmptyTest { .. })));
    let refused = report("refusal").unwrap_err();
    assert_eq!(refused.to_string(), "step 3: not today");
}
