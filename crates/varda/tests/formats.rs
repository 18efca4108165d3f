//! Files in other formats, opened by the Python packages that their readers use: NetCDF by xarray, NPZ by
//! NumPy, VTK by meshio. Every number is compared with the tables (`python/check.py`). Scenes are checked by
//! the schema beside them with Taplo, as editors do.
//!
//! The packages are installed into a virtual environment in the target folder, once. Where there is no
//! Python, or the packages cannot be had, the test says so and passes.

#![allow(clippy::print_stdout, clippy::print_stderr)]

mod support {
    pub(crate) mod program;
}

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use support::program::{Folder, text};
use varda::scene::SHIPPED;

const PACKAGES: [&str; 5] = ["numpy", "xarray", "netCDF4", "meshio", "taplo"];

const ALL: &str = "output.formats=[\"netcdf\", \"npz\", \"vtk\"]";

/// A Python with the packages, or why there is none: that is said, once for every test.
fn python() -> Option<PathBuf> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match PYTHON.get_or_init(installed) {
        Ok(python) => Some(python.clone()),
        Err(reason) => {
            // past what the harness captures
            let _ = writeln!(std::io::stderr(), "skipped: files are not opened by other programs, {reason}");
            None
        }
    }
}

fn installed() -> Result<PathBuf, String> {
    let environment = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let python = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let imports = |python: &Path| {
        let code = "import numpy, xarray, netCDF4, meshio";
        let imported = Command::new(python).args(["-c", code]).output();
        let linter = Command::new(python.with_file_name("taplo")).arg("--version").output();
        [imported, linter].into_iter().all(|done| done.is_ok_and(|done| done.status.success()))
    };
    if !imports(&python) {
        let done = |command: &mut Command, what: &str| match command.output() {
            Ok(output) if output.status.success() => Ok(()),
            Ok(output) => {
                let why = String::from_utf8_lossy(&output.stderr);
                Err(format!("{what}: {}", why.lines().last().unwrap_or_default()))
            }
            Err(reason) => Err(format!("{what}: {reason}")),
        };
        let system = if cfg!(windows) { "python" } else { "python3" };
        done(Command::new(system).args(["-m", "venv"]).arg(&environment), "a virtual environment")?;
        let mut pip = Command::new(&python);
        pip.args(["-m", "pip", "install", "--quiet", "--timeout", "10", "--retries", "1"]).args(PACKAGES);
        done(&mut pip, "pip")?;
    }
    imports(&python).then_some(python).ok_or_else(|| "the packages cannot be imported".to_string())
}

#[test]
fn other_programs_read_the_same_numbers() {
    let Some(python) = python() else { return };
    let folder = Folder::new("formats");
    let check = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/check.py");
    for (scene, model, formats, sets) in [
        ("hanging-rod", "rod", r#"["csv", "netcdf", "npz", "vtk"]"#, "time.window=20"),
        ("hanging-rod-weak", "rod", r#"["netcdf", "npz", "vtk"]"#, "report.posterior=true"),
        ("wire", "rod", r#"["netcdf", "npz", "vtk"]"#, "seed=1"),
        ("lorenz63", "components", r#"["netcdf", "npz"]"#, "seed=1"),
    ] {
        let formats = format!("output.formats={formats}");
        text(&folder.varda(&["run", scene, "--quiet", "--out", scene, "--set", &formats, "--set", sets]));
        let mut command = Command::new(&python);
        let output = command.arg(&check).arg(folder.0.join(scene)).arg(model).output().unwrap();
        assert!(output.status.success(), "{scene}: {}", String::from_utf8_lossy(&output.stderr));
        print!("{scene}: {}", String::from_utf8_lossy(&output.stdout));
    }
}

/// Members of the analysis of ensembles, with and without localization, of a field and of a rod; of the last
/// window of a sequence.
#[test]
fn members_of_an_ensemble_are_in_the_files() {
    let Some(python) = python() else { return };
    let folder = Folder::new("formats-members");
    let check = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/check.py");
    let local = SHIPPED.iter().find(|s| s.name == "lorenz96-4denvar").unwrap().text;
    let whole: String = local
        .lines()
        .filter(|l| !l.starts_with("localization"))
        .fold(String::new(), |all, line| all + line + "\n");
    std::fs::write(folder.0.join("whole.toml"), whole).unwrap();
    let of_rod = "algorithm={ method = \"4denvar\", ensemble = { members = 12 } }";
    let hybrid = "algorithm.method=hybrid-4denvar";
    let two = "output.formats=[\"netcdf\", \"npz\"]";
    for (out, scene, model, sets) in [
        ("local", "lorenz96-4denvar", "components", [two, "seed=1"]),
        ("whole", "whole.toml", "components", [two, "seed=1"]),
        ("hybrid", "lorenz96-4denvar", "components", [two, hybrid]),
        ("rod", "hanging-rod", "rod", [ALL, of_rod]),
    ] {
        let output =
            folder.varda(&["run", scene, "--quiet", "--out", out, "--set", sets[0], "--set", sets[1]]);
        // an ensemble of a few members need not fit
        assert!(matches!(output.status.code(), Some(0 | 3 | 4)), "{out}: {output:?}");
        let output = Command::new(&python).arg(&check).arg(folder.0.join(out)).arg(model).output().unwrap();
        assert!(output.status.success(), "{out}: {}", String::from_utf8_lossy(&output.stderr));
        let names = "import sys, numpy; print(*numpy.load(sys.argv[1]).files)";
        let listed = folder.0.join(out).join("result.npz");
        let output = Command::new(&python).args(["-c", names]).arg(listed).output().unwrap();
        assert!(text(&output).contains("_members"), "{out}");
    }
    let few = ["--set", "algorithm.cycles.count=3", "--set", "algorithm.cycles.spin_up=1"];
    let small = ["--set", "background.covariance.steps=3000", "--set", two];
    let cycles = ["run", "lorenz96-cycling-4denvar", "--quiet", "--out", "c"];
    folder.varda(&[&cycles[..], &few, &small].concat());
    let code = "import xarray\nd = xarray.open_dataset('c/result.nc')\n\
                last = d.state_members.isel(member_time=-1).std('member', ddof=1)\n\
                assert abs(last - d.state_sigma.isel(time=-1)).max() < 1e-12 * last.max()\n\
                assert (d.member_time.values == d.time.values[8:]).all() and d.sizes['member_time'] == 5";
    let output = Command::new(&python).args(["-c", code]).current_dir(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // nobody runs members who does not ask for a format that has them, or for no posterior
    let none = ["--set", "report.posterior=false", "--set", two, "--out", "none"];
    folder.varda(&[&["run", "lorenz96-4denvar", "--quiet"], &none[..]].concat());
    let code = "import xarray; assert 'member' not in xarray.open_dataset('none/result.nc').sizes";
    let output = Command::new(&python).args(["-c", code]).current_dir(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_python_of_the_guide_runs() {
    let Some(python) = python() else { return };
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guide/output-files.md");
    let page = std::fs::read_to_string(page).unwrap();
    let folder = Folder::new("formats-guide");
    text(&folder.varda(&["run", "hanging-rod", "--quiet", "--set", ALL]));
    let blocks = page.split("```python\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    // PyVista needs VTK, hundreds of megabytes, and opens a window
    let blocks: Vec<&str> = blocks.filter(|block| !block.contains("import pyvista")).collect();
    assert_eq!(blocks.len(), 3);
    for block in blocks {
        let output = Command::new(&python).args(["-c", block]).current_dir(&folder.0).output().unwrap();
        assert!(output.status.success(), "{block}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(!output.stdout.is_empty(), "{block}");
    }
}

#[test]
fn an_editor_checks_scenes_by_the_schema_beside_them() {
    let Some(python) = python() else { return };
    let folder = Folder::new("editor");
    let lint = |scene: &str| {
        let mut taplo = Command::new(python.with_file_name("taplo"));
        let output = taplo.args(["lint", scene]).current_dir(&folder.0).output().unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for (name, from) in [("starter", None), ("rod", Some("hanging-rod-case4")), ("field", Some("burgers"))] {
        let from = from.map_or(Vec::new(), |scene| vec!["--from", scene]);
        text(&folder.varda(&[&["new", name], &from[..]].concat()));
        let (fits, said) = lint(&format!("{name}.toml"));
        assert!(fits, "{name}: {said}");
    }
    let scene = folder.read("field.toml");
    std::fs::write(folder.0.join("odd.toml"), scene.replacen("window = ", "windo = ", 1)).unwrap();
    let (fits, said) = lint("odd.toml");
    assert!(!fits && said.contains("windo"), "{said}");
}

#[test]
fn formats_are_of_every_command_that_leaves_a_result() {
    let folder = Folder::new("formats-commands");
    let short = "time.window=20";
    text(&folder.varda(&["simulate", "hanging-rod", "--quiet", "--out", "s", "--set", ALL, "--set", short]));
    let pvd = folder.read("s/result.pvd");
    assert_eq!(pvd.matches("<DataSet").count(), 21, "{pvd}");
    let components = "output.formats=[\"netcdf\", \"npz\"]";
    let cycles = ["run", "lorenz96-cycling-3dvar", "--quiet", "--out", "c", "--set", components];
    let few = ["--set", "algorithm.cycles.count=3", "--set", "algorithm.cycles.spin_up=1"];
    folder.varda(&[&cycles[..], &few].concat());
    for file in ["s/result.nc", "s/result.npz", "s/vtk/step-000020.vtu", "c/result.nc", "c/result.npz"] {
        assert!(folder.0.join(file).metadata().is_ok_and(|m| m.len() > 500), "{file}");
    }
    // without the key there is none of it
    text(&folder.varda(&["simulate", "hanging-rod", "--quiet", "--out", "t", "--set", short]));
    assert!(!folder.0.join("t/result.nc").exists() && !folder.0.join("t/vtk").exists());
}

#[test]
fn a_format_that_a_model_has_not_is_refused_before_the_run() {
    let folder = Folder::new("formats-refused");
    let message = folder.refusal(&["run", "lorenz63", "--set", "output.formats=[\"vtk\"]"]);
    assert!(message.contains("output.formats") && message.contains("netcdf"), "{message}");
    let message = folder.refusal(&["check", "hanging-rod", "--set", "output.formats=[\"xlsx\"]"]);
    assert!(message.contains("csv, netcdf, npz, vtk"), "{message}");
}
