//! Scenes: those that ship, and what is said about wrong ones.

use varda::scene::{SHIPPED, STARTER, Scene, SceneFile};
use varda::setup::{Plan, Recordings};

fn parse(text: &str, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    SceneFile::parse("test", "test.toml", text, None, &sets)
}

fn message(text: &str, sets: &[&str]) -> String {
    parse(text, sets).expect_err("this scene is wrong").to_string()
}

/// `STARTER` with one piece of text replaced, and the line on which that is.
fn starter_with(old: &str, new: &str) -> (String, usize) {
    assert!(STARTER.contains(old), "the starter scene no longer has {old:?}");
    let line = STARTER[..STARTER.find(old).unwrap()].matches('\n').count() + 1;
    (STARTER.replacen(old, new, 1), line)
}

#[test]
fn every_shipped_scene_parses_and_survives_being_written_and_read() {
    for shipped in SHIPPED {
        let file = SceneFile::open(shipped.name, &[]).unwrap_or_else(|e| panic!("{}: {e}", shipped.name));
        let text = toml::to_string(&file.scene).unwrap();
        let again = parse(&text, &[]).unwrap_or_else(|e| panic!("{} rewritten: {e}\n{text}", shipped.name));
        assert_eq!(file.scene, again.scene, "{}", shipped.name);
        let planned = match file.has_recordings() {
            true => {
                Recordings::inputs(&file).map(|all| all.iter().map(Plan::of).collect::<Vec<_>>()).map(drop)
            }
            false => Plan::new(&file).map(drop),
        };
        planned.unwrap_or_else(|e| panic!("{}: {e}", shipped.name));
    }
    assert_eq!(SceneFile::open("hanging-rod", &[]).unwrap().name, "hanging-rod-case1");
}

#[test]
fn the_starter_scene_is_right() {
    let plan = Plan::new(&parse(STARTER, &[]).unwrap()).unwrap();
    assert_eq!((plan.n_control, plan.n_obs), (6 * 19, 2 * 3 * 12));
}

#[test]
fn errors_name_file_line_and_column_and_say_what_was_meant() {
    let cases: &[(&str, &str, &[&str])] = &[
        (
            "youngs_modulus = 1e6",
            "youngs_modulos = 1e6",
            &["unknown key `youngs_modulos`", "did you mean `youngs_modulus` (Young's modulus E [Pa])"],
        ),
        ("length = 0.5 ", "length_mm = 500", &["unknown key `length_mm`", "did you mean `length`"]),
        ("length = 0.5 ", "length = -0.5", &["`model.length` = -0.5 is impossible", "greater than 0 [m]"]),
        ("length = 0.5 ", "length = nan", &["must be finite"]),
        (
            "length = 0.5 ",
            "length = \"0.5 m\"",
            &["`model.length` must be a number [m]", "plain number in that SI unit"],
        ),
        ("radius = 0.005", "radius = 5", &["lengths are in metres, was another unit meant?"]),
        ("segments = 20", "segments = 20.5", &["must be a whole number"]),
        (
            "\"auto\"",
            "\"trust-regoin\"",
            &["`algorithm.minimizer` = \"trust-regoin\"", "did you mean \"trust-region\""],
        ),
        ("\"circle\"", "\"circel\"", &["did you mean \"circle\"", "ellipse, rectangle, stiffness"]),
        ("kind = \"rod\" ", "", &["[model] needs the key `kind`"]),
        ("density = 1100.0 ", "", &["needs the key `density` (Density ρ [kg/m³])"]),
        ("poisson_ratio = 0.5 ", "poisson_ratio = 0.6", &["at most 0.5"]),
        ("places = [0.25, 0.5]", "places = [0.25, 0.75]", &["arc length 0.75 m is off the rod (0 to 0.5"]),
        ("every = 5 ", "every = 61", &["no observation falls in the window"]),
        ("prior = \"clamp\"", "taper = \"gaspari-cohn\"", &["a taper needs `localization_length`"]),
        ("tangent = [0.0, 0.0, -1.0]", "tangent = [0.0, -1.0]", &["has 2 entries, expected 3"]),
        ("seed = 0", "seed = = 0", &["not TOML"]),
        (
            "step = 0.01 ",
            "step = 0.01\nsteps_per_period = 50 #",
            &["give `step` or `steps_per_period`, not both"],
        ),
    ];
    for (old, new, expected) in cases {
        let (text, line) = starter_with(old, new);
        let message = message(&text, &[]);
        assert!(message.starts_with("test.toml:"), "{message}");
        for piece in *expected {
            assert!(message.contains(piece), "{new:?}: {message}");
        }
        let found: usize = message.split(':').nth(1).unwrap().parse().unwrap();
        // A missing key is reported at its table's header, at most a dozen lines above.
        assert!(found <= line + 1 && found + 12 >= line, "line {found}, expected about {line}: {message}");
    }
    let (text, line) = starter_with("length = 0.5 ", "length = -0.5");
    assert!(message(&text, &[]).starts_with(&format!("test.toml:{line}:10: ")), "columns count from 1");
}

#[test]
fn overrides_set_any_key_and_are_named_when_wrong() {
    let file = parse(
        STARTER,
        &["model.length=0.25", "model.segments=10", "observations.places=[0.25]", "title=a new title"],
    )
    .unwrap();
    assert_eq!(file.scene.title, "a new title");
    assert_eq!(Plan::new(&file).unwrap().n_obs, 3 * 12);
    for (set, expected) in [
        ("model.lenght=1", "unknown key `lenght` in [model]; did you mean `length`"),
        ("model.length=-1", "`model.length` = -1 is impossible"),
        ("algorithm.minimizer=newtn", "did you mean \"newton\""),
        ("observations.places.7=0.1", "not an index of a list of 2"),
        ("model.length", "expected key=value"),
        ("model..length=1", "not a dotted key"),
        ("model.length.x=1", "no key \"x\" below a plain value"),
    ] {
        let message = message(STARTER, &[set]);
        assert!(message.starts_with(&format!("--set {set}: ")) && message.contains(expected), "{message}");
    }
}

#[test]
fn files_of_a_scene_are_relative_to_it_and_those_of_set_to_the_current_folder() {
    let folder = std::env::temp_dir().join(format!("varda-scenes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let scene = SHIPPED.iter().find(|s| s.name == "hanging-rod-csv").unwrap().text.replace("data/", "");
    std::fs::write(folder.join("mine.toml"), scene).unwrap();
    let path = folder.join("mine.toml").display().to_string();
    let data = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/data");
    for name in ["hanging-rod-background.csv", "hanging-rod-observations.csv"] {
        std::fs::copy(data.join(name), folder.join(name)).unwrap();
    }
    Plan::new(&SceneFile::open(&path, &[]).unwrap()).expect("files beside the scene are found");
    let set = ["observations.file=hanging-rod-observations.csv".to_string()];
    let message = Plan::new(&SceneFile::open(&path, &set).unwrap()).unwrap_err().to_string();
    assert!(message.contains("--set observations.file=") && message.contains("cannot read"), "{message}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn an_unknown_scene_gets_a_suggestion() {
    let message = SceneFile::open("hanging-rod-case5", &[]).unwrap_err().to_string();
    assert!(message.contains("did you mean \"hanging-rod-case"), "{message}");
}

#[test]
fn a_smooth_kernel_without_taper_or_truncation_is_refused_with_the_remedy() {
    let smooth = ["background.covariance.kernel=gaussian", "model.segments=60"];
    let sets = [&smooth[..], &["background.covariance.root=cholesky"]].concat();
    let message = Plan::new(&parse(STARTER, &sets).unwrap()).unwrap_err().to_string();
    assert!(message.contains("root = \"truncated\""), "{message}");
    let sets = [&smooth[..], &["background.covariance.root=truncated"]].concat();
    Plan::new(&parse(STARTER, &sets).unwrap()).expect("a truncated root exists");
    Plan::new(&parse(STARTER, &smooth).unwrap()).expect("a root that is not written is one that exists");
    // A Matern kernel on a fine mesh has no Cholesky root in double precision.
    let fine = ["model.segments=800", "background.covariance.correlation_length_x=0.5"];
    Plan::new(&parse(STARTER, &fine).unwrap()).expect("a root that exists");
}

#[test]
fn the_schema_describes_every_key_and_has_no_loose_ends() {
    let schema: serde_json::Value = serde_json::from_str(&Scene::schema()).unwrap();
    assert!(schema["$schema"].as_str().unwrap().starts_with("https://json-schema.org/"));
    let mut keys = 0;
    walk(&schema, &schema, "", &mut keys);
    assert!(keys > 80, "{keys} keys were looked at");
}

fn walk(node: &serde_json::Value, root: &serde_json::Value, path: &str, keys: &mut usize) {
    if let Some(reference) = node["$ref"].as_str() {
        let name = reference.strip_prefix("#/$defs/").expect("references are local");
        assert!(root["$defs"][name].is_object(), "{path}: {reference} is not there");
    }
    if let Some(properties) = node["properties"].as_object() {
        assert_eq!(node["additionalProperties"], false, "{path} lets unknown keys pass");
        for (key, property) in properties {
            *keys += 1;
            let text = property["description"].as_str().unwrap_or("");
            assert!(property["const"].is_string() || !text.is_empty(), "{path}.{key} has no description");
        }
    }
    match node {
        serde_json::Value::Object(map) => {
            map.iter().for_each(|(k, v)| walk(v, root, &format!("{path}.{k}"), keys))
        }
        serde_json::Value::Array(all) => all.iter().for_each(|v| walk(v, root, path, keys)),
        _ => {}
    }
}

#[test]
fn a_key_that_is_not_the_methods_is_named_with_its_place() {
    let (text, line) = starter_with("method = \"4dvar\" ", "method = \"4d-psas\"\nrobust = 1.5 #");
    let said = message(&text, &[]);
    assert!(
        said.starts_with(&format!("test.toml:{}:10: method \"4d-psas\" has no `robust`", line + 1)),
        "{said}"
    );
    let said = message(STARTER, &["algorithm.method=blue", "algorithm.minimizer=lbfgs"]);
    assert!(said.contains("method \"blue\" has no `minimizer`"), "{said}");
    let said = message(STARTER, &["algorithm.method=3dvar"]);
    assert!(said.contains("takes observations at step 0 only"), "{said}");
    let said = message(STARTER, &["algorithm.method=4d-pasas"]);
    assert!(said.contains("did you mean \"4d-psas\"?"), "{said}");
}

#[test]
fn keys_of_the_new_methods_are_checked() {
    let q = ["algorithm.model_error.covariance.kind=diagonal", "algorithm.model_error.covariance.sigma=0.1"];
    let weak = |method: &'static str, more: &[&'static str]| -> Vec<&'static str> {
        [&[method], &q[..], more].concat()
    };
    let lorenz = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        SceneFile::open("lorenz63", &sets).expect_err("this scene is wrong").to_string()
    };
    let growth = "algorithm.window_growth";
    let cases: &[(Vec<&str>, &str)] = &[
        (vec!["algorithm.method=weak-forcing"], "method \"weak-forcing\" needs [algorithm.model_error]"),
        (
            weak("algorithm.method=4dvar", &[]),
            "has no `model_error`; it belongs to \"weak-forcing\", \"weak-state\"",
        ),
        (weak("algorithm.method=weak-state", &["algorithm.minimizer=lbfgs"]), "has no `minimizer`"),
        (weak("algorithm.method=weak-forcing", &["algorithm.robust=1.5"]), "has no `robust`"),
        (
            weak("algorithm.method=weak-forcing", &["algorithm.model_error.every=51"]),
            "no sub-window of 51 steps",
        ),
        (weak("algorithm.method=weak-forcing", &["algorithm.model_error.every=0"]), "at least 1"),
        (
            weak("algorithm.method=weak-state", &["algorithm.model_error.held=true"]),
            "belongs to method \"weak-forcing\"",
        ),
        (
            vec!["algorithm.method=weak-forcing", "algorithm.model_error.covariance.kind=kernel"],
            "needs the key",
        ),
        (
            vec!["algorithm.method=weak-forcing", q[0], "algorithm.model_error.covariance.sigma=-1"],
            "greater than 0",
        ),
        (
            vec!["algorithm.ensemble.members=20"],
            "has no `ensemble`; it belongs to \"4denvar\", \"hybrid-4denvar\"",
        ),
        (vec!["algorithm.method=4denvar", "algorithm.ensemble.members=1"], "at least 2"),
        (vec!["algorithm.method=4denvar", "algorithm.ensemble.membrs=9"], "did you mean `members`"),
        (
            vec!["algorithm.method=4denvar", "algorithm.ensemble.static_weight=0.5"],
            "belongs to \"hybrid-4denvar\"",
        ),
        (vec!["algorithm.method=4denvar", "algorithm.ensemble.localization_length=1"], "have no distances"),
        (
            vec!["algorithm.method=4denvar", "algorithm.ensemble.taper=triangle"],
            "a taper needs `localization_length`",
        ),
        (
            vec!["algorithm.method=4denvar", "algorithm.gradient_tolerance=1e-6"],
            "has no `gradient_tolerance`",
        ),
        (
            vec![
                "algorithm.method=hybrid-4denvar",
                "algorithm.ensemble.static_weight=0",
                "algorithm.ensemble.ensemble_weight=0",
            ],
            "both weights are 0",
        ),
        (vec!["algorithm.background_check=0"], "greater than 0"),
        (vec!["algorithm.method=blue", "algorithm.window_growth=[50]"], "has no `window_growth`"),
        (vec!["algorithm.window_growth=[20, 40]"], "it must be the whole window of 50 steps"),
        (vec!["algorithm.window_growth=[30, 20, 50]"], "20 does not come after 30"),
        (vec!["algorithm.window_growth=[0, 50]"], "at least 1 step"),
    ];
    for (sets, expected) in cases {
        let said = lorenz(sets);
        assert!(said.starts_with("--set ") || said.starts_with("lorenz63.toml"), "{said}");
        assert!(said.contains(expected), "{sets:?}: {said}");
    }
    let (text, line) = starter_with("window = 60 ", "window = 50 ");
    let text = text.replace("# window_growth = [20, 40, 60] ", "window_growth = [20, 40, 60] ");
    let said = message(&text, &[]);
    assert!(
        said.starts_with("test.toml:") && said.contains("it must be the whole window of 50 steps"),
        "{line}: {said}"
    );
    assert!(!lorenz(&[&format!("{growth}=50")]).is_empty());
}

#[test]
fn fields_along_a_line_refuse_what_they_cannot_do() {
    for (scene, set, expected) in [
        ("linear-advection", "model.points=2", "at least 3"),
        ("linear-advection", "model.speed=nan", "finite"),
        ("burgers", "model.viscosity=0", "greater than 0"),
        ("burgers", "time.integrator=bdf2", "integrated with \"backward-euler\" or \"midpoint\" or \"rk4\""),
        ("burgers", "model={ kind = \"kuramoto-sivashinsky\", points = 4 }", "at least 5"),
        ("burgers", "model.visocsity=0.1", "did you mean `viscosity`"),
        ("linear-advection", "background.covariance.taper=triangle", "needs `localization_length`"),
        (
            "lorenz96",
            "background.covariance={ kind = \"line\", sigma = 1, correlation_length = 1 }",
            "Lorenz models take",
        ),
    ] {
        let said = SceneFile::open(scene, &[set.to_string()]).expect_err(set).to_string();
        assert!(said.contains(expected), "{set}: {said}");
    }
    let sets = ["time.integrator=rk4", "time.step=0.1"].map(String::from);
    let said = SceneFile::open("burgers", &sets).unwrap_err().to_string();
    assert!(said.contains("ν Δt/h²") && said.contains("\"midpoint\""), "{said}");
}

#[test]
fn check_says_what_the_new_methods_take() {
    let plan = |scene: &str| Plan::new(&SceneFile::open(scene, &[]).unwrap()).unwrap();
    let ensemble = plan("lorenz96-4denvar");
    assert_eq!(ensemble.members, 40);
    assert!(ensemble.left_out.iter().any(|l| l.contains("tangent and adjoint")));
    let weak = plan("hanging-rod-weak");
    assert_eq!(weak.n_errors, 4 * weak.n_control);
}
