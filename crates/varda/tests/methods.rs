//! Every method of the family by its name in a scene.

use varda::outcome::{Outcome, Status};
use varda::report::Summary;
use varda::run::{Listener, assimilate};
use varda::scene::{Method, SceneFile};
use varda::setup::Problem;

fn run(scene: &str, sets: &[&str]) -> (Problem, Outcome) {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let file = SceneFile::open(scene, &sets).unwrap();
    let problem = Problem::from_scene(&file).unwrap();
    let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
    (problem, outcome)
}

/// RMSE of the state of background and analysis.
fn rmse(outcome: &Outcome) -> [f64; 2] {
    outcome.rmse.of("state").unwrap().known().unwrap()
}

const Q: [&str; 2] =
    ["algorithm.model_error.covariance.kind=diagonal", "algorithm.model_error.covariance.sigma=0.1"];

fn weak(method: &str, more: &[&str]) -> (Problem, Outcome) {
    let method = format!("algorithm.method={method}");
    run("lorenz63", &[&[method.as_str()], &Q[..], more].concat())
}

fn gap(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |gap, (a, b)| gap.max((a - b).abs()))
}

/// argmin's L-BFGS, chosen in a scene, comes to the minimum of our own: both gradients are 1e-6 of the first,
/// and J is quadratic to second order about the minimum.
#[test]
fn a_scene_runs_with_the_lbfgs_of_argmin() {
    let ended = |name: &str| {
        let minimizer = format!("algorithm.minimizer={name}");
        let (_, outcome) = run("lorenz96", &[minimizer.as_str(), "algorithm.gradient_tolerance=1e-6"]);
        assert_eq!(outcome.status, Status::Converged, "{name}");
        assert_eq!(Summary::new(&outcome).minimizer, name);
        outcome.analysis
    };
    let (ours, theirs) = (ended("lbfgs"), ended("argmin-lbfgs"));
    assert!((ours.value - theirs.value).abs() <= 1e-8 * ours.value, "{} {}", ours.value, theirs.value);
    let gap = gap(&ours.analysis, &theirs.analysis);
    assert!(gap <= 1e-4 * ours.sigma_analysis.iter().fold(0.0, |a: f64, b| a.max(*b)), "{gap}");
}

#[test]
fn every_method_runs_by_its_name() {
    // a shape without times has tests of its own
    for method in Method::ALL.into_iter().filter(|method| *method != Method::Static) {
        let name = format!("algorithm.method={}", method.name());
        let mut sets = vec![name.as_str()];
        if method.is_weak() {
            sets.extend(Q);
        }
        if method.is_of_one_instant() {
            sets.extend(["observations.steps=[0]", "time.window=0"]);
        }
        let text = varda::scene::SHIPPED.iter().find(|s| s.name == "lorenz63").unwrap().text;
        let text = if method.is_of_one_instant() { text.replace("every = 5", "") } else { text.to_string() };
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let file = SceneFile::parse("lorenz63", "lorenz63.toml", &text, None, &sets).unwrap();
        let problem = Problem::from_scene(&file).unwrap();
        let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
        let ended = outcome.status;
        // One linearization converges on linear problems only.
        let expected = match method {
            Method::Blue => Status::MaxIterations,
            Method::HybridFourDEnVar => Status::LinearizedOnce,
            _ => Status::Converged,
        };
        assert_eq!(ended, expected, "{}", method.name());
        assert!(outcome.has_posterior && outcome.analysis.value < outcome.j_background, "{}", method.name());
        assert!(rmse(&outcome)[1] < rmse(&outcome)[0], "{}", method.name());
        let sigma = outcome.analysis.sigma_analysis.iter().zip(&outcome.analysis.sigma_background);
        assert!(sigma.clone().all(|(a, b)| *a > 0.0 && a < b), "{}: {sigma:?}", method.name());
        assert_eq!(Summary::new(&outcome).method, method.name());
    }
}

#[test]
fn the_weak_forms_agree_and_their_trajectory_is_the_analysis() {
    let (problem, forcing) = weak("weak-forcing", &["algorithm.model_error.every=5"]);
    let (_, state) = weak("weak-state", &["algorithm.model_error.every=5"]);
    // Both end at a gradient 1e-8 of the first: J is then its minimum to far better than this.
    assert!((forcing.analysis.value / state.analysis.value - 1.0).abs() < 1e-9);
    assert!(gap(&forcing.trajectories.analysis, &state.trajectories.analysis) < 1e-5);
    assert!(gap(&forcing.analysis.sigma_analysis, &state.analysis.sigma_analysis) < 1e-5);
    assert!(forcing.analysis.terms.model_error > 0.0);
    let summary = Summary::new(&forcing);
    assert_eq!(summary.j_terms.model_error, forcing.convergence.last().unwrap().j_q);

    // J_o is that of the trajectory reported; a run of the model from x_a has another one.
    let of =
        |runs: &Outcome| -> f64 { runs.fit.iter().map(|f| 0.5 * f.count as f64 * f.ratio * f.ratio).sum() };
    let terms = forcing.analysis.terms;
    assert!((of(&forcing) / terms.observation - 1.0).abs() < 1e-12, "{} {terms:?}", of(&forcing));
    let mut model = (problem.make_model)(0);
    let (n, mut jumps) = (3, Vec::new());
    for k in 0..50 {
        let mut next = [0.0; 3];
        model.step(k, &forcing.trajectories.analysis[k * n..(k + 1) * n], &mut next).unwrap();
        if gap(&next, &forcing.trajectories.analysis[(k + 1) * n..(k + 2) * n]) > 1e-9 {
            jumps.push(k + 1);
        }
    }
    assert_eq!(jumps, [5, 10, 15, 20, 25, 30, 35, 40, 45, 50], "the model errs where a sub-window ends");
}

#[test]
fn weak_constraint_becomes_strong_with_a_vanishing_q() {
    let strong = run("lorenz63", &[]).1;
    let weak = weak("weak-forcing", &["algorithm.model_error.covariance.sigma=1e-6"]).1;
    // The analysis differs by a multiple of Q/B = 1e-12, stretched by the window's growth squared (< 1e5).
    assert!(gap(&strong.analysis.analysis, &weak.analysis.analysis) < 1e-6);
    assert!(gap(&strong.analysis.sigma_analysis, &weak.analysis.sigma_analysis) < 1e-6);
}

#[test]
fn an_ensemble_calls_no_tangent_and_no_adjoint() {
    for scene in ["lorenz96-4denvar", "lorenz63"] {
        let sets = [
            "algorithm.method=hybrid-4denvar",
            "algorithm.background_check=6.0",
            "algorithm.ensemble.ensemble_weight=0.8",
        ];
        for sets in [&["algorithm.method=4denvar"][..], &sets] {
            let outcome = run(scene, sets).1;
            assert_eq!((outcome.counts.tangent_steps, outcome.counts.adjoint_steps), (0, 0));
            assert_eq!((outcome.seconds.tangent, outcome.seconds.adjoint), (0.0, 0.0));
            assert!(outcome.counts.model_steps > 41 && outcome.has_posterior);
        }
    }
}

#[test]
fn a_large_ensemble_finds_what_4dvar_finds() {
    let strong = run("lorenz63", &[]).1;
    let sets = ["algorithm.method=4denvar", "algorithm.ensemble.members=2000"];
    let ensemble = run("lorenz63", &sets).1;
    assert_eq!(ensemble.status, Status::Converged);
    // B of 2000 members is off by √(2/2000) = 3 %; the analysis moves by that part of the increment, of
    // size σ_b = 1.
    assert!(gap(&strong.analysis.analysis, &ensemble.analysis.analysis) < 0.1);
    assert!(gap(&strong.analysis.sigma_analysis, &ensemble.analysis.sigma_analysis) < 0.1 * 0.3);
    let again = run("lorenz63", &sets).1;
    assert_eq!(ensemble.analysis, again.analysis, "the same bits, whoever ran which member");
}

#[test]
fn a_growing_window_finds_the_lower_minimum() {
    let grown = run("lorenz63-window", &[]).1;
    let straight = run("lorenz63-window", &["algorithm.window_growth=[200]"]).1;
    assert_eq!(grown.status, Status::Converged);
    assert!(grown.analysis.value < 0.1 * straight.analysis.value);
    // 2J is about χ² of 60 values.
    assert!(grown.analysis.chi2 < 2.0, "{}", grown.analysis.chi2);
    let windows: Vec<usize> = grown.convergence.iter().map(|r| r.window).collect();
    assert!(windows.is_sorted() && windows[0] == 20 && windows.last() == Some(&200));
    assert!(grown.convergence.is_sorted_by_key(|r| r.iteration));
    assert!(grown.convergence.is_sorted_by_key(|r| r.counts.model_steps), "work is that of all sub-windows");
    // Every other 4D method grows too.
    for method in ["4dvar-incremental", "4d-psas", "weak-forcing", "weak-state", "4denvar"] {
        let name = format!("algorithm.method={method}");
        let growth = "algorithm.window_growth=[10,30,50]";
        let sets =
            if method.starts_with("weak") { vec![&*name, growth, Q[0], Q[1]] } else { vec![&*name, growth] };
        let outcome = run("lorenz63", &sets).1;
        assert_eq!(outcome.status, Status::Converged, "{method}");
        assert!((outcome.j_background - 64.437526).abs() < 1e-5, "{method}: J of the whole window");
    }
}

#[test]
fn the_background_check_refuses_a_gross_error_and_lists_it() {
    let data =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/data/hanging-rod-observations.csv");
    let text = std::fs::read_to_string(data).unwrap();
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    let mut cells: Vec<String> = lines[5].split(',').map(String::from).collect();
    cells[3] = format!("{}", cells[3].parse::<f64>().unwrap() - 0.2);
    lines[5] = cells.join(",");
    let path = std::env::temp_dir().join(format!("varda-gross-{}.csv", std::process::id()));
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    let file = format!("observations.file={}", path.display());
    let checked = run("hanging-rod-csv", &[&file, "algorithm.background_check=5.0"]);
    std::fs::remove_file(path).unwrap();
    // The whole sighting: its other two coordinates are not believed either.
    let [_, gross, _] = checked.1.rejected.as_slice() else { panic!("{:?}", checked.1.rejected) };
    assert!((gross.departure + 0.2).abs() < 0.1 && gross.departure < -5.0 * gross.expected);
    assert!(
        checked.1.warnings.iter().any(|w| w.contains("refused 3 of 120 observed values: s = 0.25 m at 1.78"))
    );
    let summary = Summary::new(&checked.1);
    assert_eq!((summary.n_obs, summary.rejected.len()), (117, 3));
    // Without it the rest of the scene is as it was: J per value about ½, where the gross error alone is
    // worth (0.2/0.023)²/2.
    assert!(checked.1.analysis.chi2 < 1.7, "{}", checked.1.analysis.chi2);
}

#[test]
fn fields_along_a_line_are_assimilated_by_any_step() {
    for integrator in ["midpoint", "backward-euler", "rk4"] {
        let integrator = format!("time.integrator={integrator}");
        let linear = run("linear-advection", &[&integrator]).1;
        assert_eq!(linear.status, Status::Converged);
        assert!(rmse(&linear)[1] < 0.5 * rmse(&linear)[0]);
        // An explicit step is held to ν Δt/h² < 0.69.
        let burgers = run("burgers", &[&integrator, "time.step=0.005"]).1;
        assert_eq!(burgers.status, Status::Converged);
        assert!(rmse(&burgers)[1] < 0.6 * rmse(&burgers)[0]);
    }
    // On the attractor of a chaotic field; Δt/h⁴ = 0.67. Over 50 steps backward Euler has a second
    // minimum.
    let model = "model={ kind = \"kuramoto-sivashinsky\", points = 96, length = 75.0 }";
    let prior = "background.covariance.correlation_length=2.0";
    for integrator in ["midpoint", "backward-euler"] {
        let integrator = format!("time.integrator={integrator}");
        let time = ["time.step=0.25", "time.spin_up=400", "time.window=20"];
        let fronts = run("burgers", &[&[model, &integrator, prior][..], &time].concat()).1;
        assert_eq!(fronts.status, Status::Converged);
        assert!(rmse(&fronts)[1] < 0.6 * rmse(&fronts)[0]);
    }
}

/// J_b of the summary and J_o from its root mean square innovations: J of the run that is written.
fn cost_of_run(outcome: &Outcome) -> f64 {
    let summary = Summary::new(outcome);
    let squares =
        summary.innovations.iter().map(|i| 0.5 * i.count as f64 * (i.rms_analysis / i.sigma).powi(2));
    outcome.analysis.terms.background + squares.sum::<f64>()
}

/// Lorenz-63 over 150 steps: the quadratic of one linearization promises J = 20, and a run of its minimum has
/// 89 where the background has 71.
#[test]
fn the_cost_of_an_ensemble_is_that_of_the_run_that_is_written() {
    let text = "seed = 7\n[model]\nkind = \"lorenz63\"\n\
        [time]\nintegrator = \"rk4\"\nstep = 0.01\nspin_up = 1000\nwindow = 150\n\
        [background]\nfrom = \"truth-plus-draw\"\ncovariance = { kind = \"diagonal\", sigma = 1.0 }\n\
        [observations]\nkind = \"synthetic\"\nevery = 10\nsigma = 1.0\n\
        [algorithm]\nmethod = \"4denvar\"\nmax_iterations = 1\n[algorithm.ensemble]\nmembers = 10\n";
    let run = |sets: &[String]| {
        let file = SceneFile::parse("chaos", "chaos.toml", text, None, sets).unwrap();
        assimilate(&Problem::from_scene(&file).unwrap(), &mut Listener::silent()).unwrap()
    };
    let told = |outcome: &Outcome| {
        let (told, of_run) = (outcome.analysis.value, cost_of_run(outcome));
        // Sums in another order.
        assert!((told - of_run).abs() <= 1e-9 * of_run, "{told} {of_run}");
        assert!(told <= outcome.j_background, "{told} {}", outcome.j_background);
        outcome.status
    };
    let once = run(&[]);
    assert!((once.j_background - 70.74).abs() < 0.01, "another problem: {}", once.j_background);
    assert_eq!(told(&once), Status::LinearizedOnce);
    // Half the step, or less: its run is better than the background, and no minimum.
    assert!(once.analysis.value > 25.0, "{}", once.analysis.value);
    assert!(once.warnings.iter().any(|w| w.contains("linearized once")), "{:?}", once.warnings);
    assert_ne!(told(&run(&["algorithm.max_iterations=10".into()])), Status::LinearizedOnce);
    for window in [20, 40] {
        let sets = [
            "algorithm.method=hybrid-4denvar".to_string(),
            format!("time.window={window}"),
            "algorithm.ensemble.static_weight=0.5".into(),
        ];
        let text = text.replace("max_iterations = 1\n", "");
        let file = SceneFile::parse("chaos", "chaos.toml", &text, None, &sets).unwrap();
        let hybrid = assimilate(&Problem::from_scene(&file).unwrap(), &mut Listener::silent()).unwrap();
        assert_eq!(told(&hybrid), Status::LinearizedOnce, "{window}");
    }
    // A linear problem says nothing of the kind.
    let (_, linear) =
        self::run("linear-advection", &["algorithm.method=4denvar", "algorithm.max_iterations=1"]);
    assert_eq!(told(&linear), Status::Converged);
}
