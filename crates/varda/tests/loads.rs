//! Forces, moments and drag of a scene: given, recorded, and refused where they cannot be meant.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::{Folder, NOTHING, ROD, SEEN};
use varda::run::simulate;
use varda::setup::rod_model::RodParts;
use varda::setup::{Inputs, Problem};
use varda_rod::Vector3;

const CLAMP: &str = r#"
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
[time]
integrator = "midpoint"
step = 0.01
window = 20
"#;

const FORCE: &str = "time_s,fx_n,fy_n,fz_n\n10,0,0,0\n10.1,0.02,0,0\n10.5,0.02,0.04,0\n";
const FOLLOWING: &str = "time_s,f1_n,f2_n,ft_n\n-1,0,0,-0.1\n1,0,0,-0.3\n";
const TWIST: &str = "time_s,twist_nm\n0,0.001\n0.2,0.003\n";
const MOMENT: &str = "time_s,mx_nm,my_nm,mz_nm\n0,0.001,0,0\n0.2,0.003,0,0\n";

fn inputs(name: &str, loads: &str) -> Result<Inputs, varda::Error> {
    let folder = Folder::new(&format!("loads-{name}"))
        .with("seen.csv", NOTHING)
        .with("force.csv", FORCE)
        .with("following.csv", FOLLOWING)
        .with("twist.csv", TWIST)
        .with("moment.csv", MOMENT);
    Inputs::read(&folder.scene(&format!("{ROD}{loads}{CLAMP}{SEEN}"), &[])?)
}

fn parts(name: &str, loads: &str) -> RodParts {
    let varda::setup::system::System::Rod(rod) = inputs(name, loads).unwrap().system else { panic!("a rod") };
    rod.parts
}

fn refusal(name: &str, loads: &str) -> String {
    inputs(name, loads).err().expect("cannot be meant").to_string()
}

#[test]
fn forces_are_given_or_recorded_by_two_names() {
    let loads = r#"forces = [{ arc_length = 0.5, force = [0.0, 0.1, 0.0] },
        { arc_length = 0.25, file = "force.csv", time_zero = 10.0,
          frame = { rotation = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] } }]"#;
    for (name, loads) in [("forces", loads.to_string()), ("alias", loads.replace("forces", "point_forces"))] {
        let parts = parts(name, &loads);
        let at = |i: usize, t: f64| parts.loads.point_forces[i].1.at(t);
        assert_eq!(at(0, 0.3), Vector3::new(0.0, 0.1, 0.0));
        // x of the file is −y of the model
        assert!((at(1, 0.05) - Vector3::new(0.0, -0.01, 0.0)).norm() < 1e-15, "{}", at(1, 0.05));
        assert!((parts.pull - 0.1 - 0.02_f64.hypot(0.04)).abs() < 1e-12);
        assert!(parts.dynamics().unwrap().free_angles().is_empty());
    }
}

#[test]
fn followers_and_moments_bring_angles_where_they_need_them() {
    for (name, loads, angles) in [
        ("along", r#"forces = [{ arc_length = 0.5, file = "following.csv", follower = true }]"#, 0),
        ("across", "forces = [{ arc_length = 0.5, force = [0.1, 0.0, 0.0], follower = true }]", 7),
        ("moment", "moments = [{ arc_length = 0.5, moment = [0.0, 0.001, 0.0] }]", 7),
        ("twist", "moments = [{ arc_length = 0.5, twist = 0.001 }]", 7),
        ("moments", r#"moments = [{ arc_length = 0.4, file = "moment.csv" }]"#, 7),
        ("twists", r#"moments = [{ arc_length = 0.4, file = "twist.csv" }]"#, 7),
        ("drag", "drag = { fluid_density = 1000.0, diameter = 0.01, flow = [0.1, 0.0, 0.0] }", 0),
    ] {
        assert_eq!(parts(name, loads).dynamics().unwrap().free_angles().len(), angles, "{name}");
        let problem = Problem::new(inputs(name, loads).unwrap()).unwrap_or_else(|e| panic!("{name}: {e}"));
        simulate(&problem).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

#[test]
fn what_cannot_be_meant_is_named() {
    for (name, loads, expected) in [
        (
            "both",
            r#"forces = [{ arc_length = 0.5, force = [0.0, 0.1, 0.0], file = "force.csv" }]"#,
            "give `force`, or",
        ),
        ("none", "forces = [{ arc_length = 0.5 }]", "give `force` [N], or the `file`"),
        (
            "off",
            "forces = [{ arc_length = 0.6, force = [0.0, 0.1, 0.0] }]",
            "arc length 0.6 m is off the rod",
        ),
        (
            "uncovered",
            r#"forces = [{ arc_length = 0.5, file = "force.csv" }]"#,
            "force.csv has rows from 10 to 10.5 s of the model's clock, and the run needs 0 to 0.2 s: set \
             model.forces.0.time_zero (now 0)",
        ),
        (
            "other columns",
            r#"forces = [{ arc_length = 0.5, file = "force.csv", follower = true }]"#,
            "expected the header time_s,f1_n,f2_n,ft_n",
        ),
        (
            "axes of a follower",
            r#"forces = [{ arc_length = 0.5, file = "following.csv", follower = true,
                frame = { axis = [0.0, 0.0, 1.0], angle = 1.0 } }]"#,
            "in no other axes",
        ),
        (
            "place",
            r#"forces = [{ arc_length = 0.5, file = "force.csv", 
                frame = { translation = [0.0, 1.0, 0.0] } }]"#,
            "only the rotation counts",
        ),
        (
            "clock",
            "forces = [{ arc_length = 0.5, force = [0.0, 0.1, 0.0], time_zero = 1.0 }]",
            "no file whose clock",
        ),
        (
            "two",
            "moments = [{ arc_length = 0.5, moment = [0.0, 0.1, 0.0], twist = 0.1 }]",
            "give one of `moment`",
        ),
        ("no moment", "moments = [{ arc_length = 0.5 }]", "give one of `moment`"),
        ("negative", "drag = { fluid_density = -1.0, diameter = 0.01 }", "`model.drag.fluid_density` = -1"),
        ("incomplete", "drag = { fluid_density = 1.0 }", "needs the key `diameter`"),
        (
            "twice",
            "forces = [{ arc_length = 0.5, force = [0.0, 0.1, 0.0] }]\npoint_forces = []",
            "`model.point_forces` is another name of `model.forces`",
        ),
    ] {
        let found = refusal(name, loads);
        assert!(found.contains(expected), "{name}: {found}");
    }
}
