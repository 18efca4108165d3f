//! What should fail does: wrong derivatives are caught, and a failed row makes the process fail.

use problems::rods::{HangingRod, rod_scale};
use std::path::Path;
use std::process::Command;
use varda_implicit::{
    ControlMap, Equations, Error, ImplicitModel, ImplicitStep, Interval, Model, Multipliers, Refusal,
    SolvedStep, StepEquations, Structure, Work, check,
};
use varda_rod::{Damping, Loads, RodEquations, RodStep};

/// Which entry is wrong, by one part in a thousand.
#[derive(Clone, Copy, PartialEq)]
enum Wrong {
    Nothing,
    /// An entry of ∂G/∂u.
    Jacobian,
    /// An entry of (∂G/∂x_k)ᵀ.
    PreviousTranspose,
    /// A number that a damped step keeps of its strains.
    Kept,
    /// A number that a step keeps of its second derivatives.
    Second,
}

const OFF: f64 = 1e-3;

/// The flagship's step with one wrong entry.
struct Mutated(RodStep, Wrong);

/// Its equations, and where in the Jacobian a wrong entry goes.
struct MutatedEquations<'a> {
    inner: RodEquations<'a>,
    wrong: Option<usize>,
}

impl Equations for MutatedEquations<'_> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let potential = self.inner.assemble(u, g, jacobian.as_deref_mut())?;
        if let (Some(values), Some(place)) = (jacobian, self.wrong) {
            values[place] *= 1.0 + OFF;
        }
        Ok(potential)
    }
    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        self.inner.retract(u, du, alpha, trial);
    }
    fn size(&self, du: &[f64]) -> f64 {
        self.inner.size(du)
    }
    fn converged_below(&self) -> f64 {
        self.inner.converged_below()
    }
    fn longest(&self, du: &[f64]) -> f64 {
        self.inner.longest(du)
    }
    fn trusted_below(&self) -> f64 {
        self.inner.trusted_below()
    }
}

impl StepEquations for MutatedEquations<'_> {
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        self.inner.predict(u)
    }
}

impl ImplicitStep for Mutated {
    type Equations<'a> = MutatedEquations<'a>;

    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn unknowns(&self) -> usize {
        self.0.unknowns()
    }
    fn structure(&self) -> Structure {
        self.0.structure()
    }
    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<MutatedEquations<'a>, Refusal> {
        let Structure::SymmetricBand { half_bandwidth: w } = self.0.structure() else { panic!("a band") };
        // z of a vertex half way down, on the diagonal
        let row = self.0.unknowns() / 2 / 3 * 3 + 2;
        let wrong = (self.1 == Wrong::Jacobian).then_some(row * (w + 1) + w);
        Ok(MutatedEquations { inner: self.0.equations(at, x)?, wrong })
    }
    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        self.0.advance(at, x, u, x_next);
    }
    fn recover(&mut self, at: &Interval, x: &[f64], x_next: &[f64], u: &mut [f64]) {
        self.0.recover(at, x, x_next, u);
    }
    fn control_dim(&self) -> usize {
        self.0.control_dim()
    }
    fn initial_state(&mut self, t: f64, z: &[f64], x: &mut [f64]) -> Result<(), Refusal> {
        self.0.initial_state(t, z, x)
    }
    fn kept(&self) -> usize {
        self.0.kept()
    }
    fn keep(&mut self, at: &Interval, x: &[f64], u: &[f64], kept: &mut [f64]) {
        self.0.keep(at, x, u, kept);
        if self.1 == Wrong::Kept {
            // half way down, in the gradient of a bend
            let i = kept.len() / 4;
            kept[i] *= 1.0 + OFF;
        }
    }
    fn previous(&mut self, of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        self.0.previous(of, dx, dg);
    }
    fn previous_transpose_add(&mut self, of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        self.0.previous_transpose_add(of, mu, dx);
        if self.1 == Wrong::PreviousTranspose {
            let i = dx.len() / 4;
            dx[i] *= 1.0 + OFF;
        }
    }
    fn advance_tangent(&mut self, of: &SolvedStep<'_>, dx: &[f64], du: &[f64], next: &mut [f64]) {
        self.0.advance_tangent(of, dx, du, next);
    }
    fn advance_adjoint(&mut self, of: &SolvedStep<'_>, l: &[f64], dx: &mut [f64], du: &mut [f64]) {
        self.0.advance_adjoint(of, l, dx, du);
    }
    fn second_kept(&self) -> Option<usize> {
        self.0.second_kept()
    }
    fn keep_second(&mut self, of: &SolvedStep<'_>, lambda: &[f64], mu: &[f64], kept: &mut [f64]) {
        self.0.keep_second(of, lambda, mu, kept);
        if self.1 == Wrong::Second {
            // the largest of them
            let i = (0..kept.len()).max_by(|i, j| kept[*i].abs().total_cmp(&kept[*j].abs())).unwrap();
            kept[i] *= 1.0 + OFF;
        }
    }
    fn second_add(
        &mut self,
        of: &SolvedStep<'_>,
        at: &Multipliers<'_>,
        by: [&[f64]; 2],
        to: [&mut [f64]; 2],
    ) {
        self.0.second_add(of, at, by, to);
    }
}

/// The flagship at the start of its window, with a wrong entry or none.
fn flagship(wrong: Wrong) -> (ImplicitModel<Mutated>, Vec<f64>, Vec<f64>) {
    let (rod, truth) = HangingRod::flagship(2, true).unwrap();
    let model = rod.model(rod.first_step).unwrap();
    let scale = rod_scale(model.step_ref());
    (ImplicitModel::new(Mutated(model.into_inner(), wrong), rod.first_step, rod.dt), truth, scale)
}

/// The same rod with strain-rate damping, which makes ∂G/∂x_k depend on what a solved step keeps.
fn damped(wrong: Wrong) -> (ImplicitModel<Mutated>, Vec<f64>, Vec<f64>) {
    let (rod, truth) = HangingRod::flagship(2, true).unwrap();
    let step = rod.model(rod.first_step).unwrap().into_inner();
    let loads = Loads { gravity: rod.gravity.into(), ..Loads::default() };
    let damping = Damping { stiffness: 0.1, mass: 0.0 };
    let step = RodStep::new(step.rod().clone(), step.supports().clone(), loads, damping).unwrap();
    let scale = rod_scale(&step);
    let mut model = ImplicitModel::new(Mutated(step, wrong), rod.first_step, rod.dt);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&truth, &mut x).unwrap();
    (model, x, scale)
}

#[test]
fn a_mutated_kept_number_is_caught_by_taylor() {
    let passes = |wrong| {
        let (mut model, x, scale) = damped(wrong);
        let slope = check::taylor_step(&mut model, 0, &x, &scale, &scale).unwrap();
        (slope.slope - 2.0).abs() <= 0.05
    };
    assert!(passes(Wrong::Nothing));
    assert!(!passes(Wrong::Kept));
}

#[test]
fn a_mutated_second_derivative_is_caught_by_taylor() {
    let passes = |wrong| {
        let (mut model, x, scale) = flagship(wrong);
        let findings = check::second_order(&mut model, 0, &x, &scale, 1).unwrap();
        assert_eq!(findings.len(), 3);
        findings.iter().all(|f| f.pass)
    };
    assert!(passes(Wrong::Nothing));
    assert!(!passes(Wrong::Second));
}

fn taylor_passes(wrong: Wrong) -> bool {
    let (mut model, x, scale) = flagship(wrong);
    let slope = check::taylor_step(&mut model, 0, &x, &scale, &scale).unwrap();
    (slope.slope - 2.0).abs() <= 0.05
}

fn dot_product_passes(wrong: Wrong) -> bool {
    let (mut model, x, scale) = flagship(wrong);
    check::window(&mut model, &x, 10, &scale, 1).unwrap().value <= 1e-12
}

#[test]
fn a_mutated_jacobian_entry_is_caught_by_taylor() {
    assert!(taylor_passes(Wrong::Nothing));
    assert!(!taylor_passes(Wrong::Jacobian));
    // Tangent and adjoint come from the same wrong factor: transposes of each other, as this test sees it.
    assert!(dot_product_passes(Wrong::Jacobian));
}

#[test]
fn a_mutated_adjoint_entry_is_caught_by_the_dot_product() {
    assert!(dot_product_passes(Wrong::Nothing));
    assert!(!dot_product_passes(Wrong::PreviousTranspose));
}

/// Any model whose tangent has one wrong entry.
struct WrongTangent<M>(M);

impl<M: Model> Model for WrongTangent<M> {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        self.0.step(k, x, x_next)
    }
    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        self.0.linearize(slot, k, x, x_next)
    }
    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        for dx in dx.chunks_exact_mut(self.0.dim()) {
            let extra = OFF * dx[2];
            self.0.tangent(slot, dx);
            dx[1] += extra;
        }
    }
    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.0.adjoint(slot, lambda);
    }
    fn release(&mut self, from_slot: usize) {
        self.0.release(from_slot);
    }
    fn slot_bytes(&self) -> usize {
        self.0.slot_bytes()
    }
    fn bytes(&self) -> usize {
        self.0.bytes()
    }
    fn rate(&self) -> Option<Box<dyn varda_implicit::Rate>> {
        self.0.rate()
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        self.0.control_map()
    }
}

#[test]
fn a_mutated_tangent_entry_is_caught_by_both() {
    let model = varda_implicit::Rk4::new(varda_implicit::lorenz::Lorenz63::default(), 0, 0.01);
    let mut model = WrongTangent(model);
    let outcomes = check::conformance(&mut model, 0, &[1.2, -0.7, 10.3], &[1.0; 3], 1).unwrap();
    let failed: Vec<&str> = outcomes.iter().filter(|o| !o.pass).map(|o| o.what.as_str()).collect();
    assert!(failed.iter().any(|w| w.contains("dot product")), "{failed:?}");
    assert!(failed.iter().any(|w| w.contains("Taylor")), "{failed:?}");
}

/// Runs the golden suite on a folder; whether it succeeded, its rows, and what it printed.
fn golden(folder: &Path) -> (bool, serde_json::Value, String) {
    let json = folder.join("rows.json");
    let output = Command::new(env!("CARGO_BIN_EXE_tests"))
        .args(["golden", "--fixtures"])
        .arg(folder)
        .arg("--json")
        .arg(&json)
        .output()
        .unwrap();
    let rows = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    (output.status.success(), rows, String::from_utf8(output.stdout).unwrap())
}

/// An empty folder of its own for a test.
fn folder(name: &str) -> std::path::PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn fixture(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(path)).unwrap()
}

#[test]
fn a_fixture_that_disagrees_fails_the_process() {
    let folder = folder("disagrees");
    std::fs::create_dir(folder.join("twin")).unwrap();
    let right = fixture("twin/l63.json");
    std::fs::write(folder.join("twin/right.json"), &right).unwrap();
    let (success, rows, _) = golden(&folder);
    assert!(success, "{rows:#}");

    let mut wrong: serde_json::Value = serde_json::from_str(&right).unwrap();
    wrong["trPa"] = (wrong["trPa"].as_f64().unwrap() * 1.00001).into();
    std::fs::write(folder.join("twin/wrong.json"), wrong.to_string()).unwrap();
    let (success, rows, text) = golden(&folder);
    assert!(!success);
    let failed: Vec<_> = rows.as_array().unwrap().iter().filter(|r| r["pass"] == false).collect();
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert_eq!((&failed[0]["case"], &failed[0]["what"]), (&"wrong".into(), &"posterior_trace".into()));
    assert!(text.contains("1 failed"));
}

#[test]
fn fixtures_that_cannot_be_read_are_failed_rows_with_a_reason() {
    let folder = folder("unreadable");
    for kind in ["der", "twin", "hanging-rod/empty", "hanging-rod/short"] {
        std::fs::create_dir_all(folder.join(kind)).unwrap();
    }
    std::fs::write(folder.join("der/cut.json"), &fixture("der/curved_iso_5.json")[..500]).unwrap();
    let unknown = fixture("twin/l63.json").replace("lorenz63", "lorenz84");
    std::fs::write(folder.join("twin/unknown.json"), unknown).unwrap();
    for file in ["problem.json", "reference.json", "observations.csv"] {
        let text = fixture(&format!("hanging-rod/case2-clamp-seed0/{file}"));
        let text = if file == "observations.csv" { text.replacen("10,0,", "10,zero,", 1) } else { text };
        std::fs::write(folder.join("hanging-rod/short").join(file), text).unwrap();
    }
    let (success, rows, _) = golden(&folder);
    assert!(!success);
    let expected = [
        ("cut", "cut.json: EOF"),
        ("unknown", "unknown model \"lorenz84\""),
        ("empty", "problem.json"),
        ("short", "observations.csv"),
    ];
    for (case, reason) in expected {
        let row = rows.as_array().unwrap().iter().find(|r| r["case"] == case).unwrap();
        assert_eq!(row["pass"], false);
        assert!(row["note"].as_str().unwrap().contains(reason), "{row}");
    }
}

#[test]
fn an_empty_folder_is_not_a_success() {
    let (success, rows, _) = golden(&folder("nothing"));
    assert!(!success);
    assert!(rows[0]["note"].as_str().unwrap().contains("no fixtures"));
}

#[test]
fn unknown_suites_and_folders_are_refused() {
    for arguments in [&["gold"][..], &["golden", "--fixtures", "no/such/folder"], &["--json"]] {
        let output = Command::new(env!("CARGO_BIN_EXE_tests")).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(String::from_utf8(output.stderr).unwrap().starts_with("error: "));
    }
}
