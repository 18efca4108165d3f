//! `cargo xtask gallery`: pages about shipped scenes, with pictures and numbers of their runs.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::{release_binary, root};

/// A scene of the gallery: its name, the figure that stands for it, and what fits, what does not, and why.
struct Exhibit {
    scene: &'static str,
    figure: &'static str,
    words: &'static str,
}

const EXHIBITS: &[Exhibit] = &[
    Exhibit {
        scene: "hose",
        figure: "snapshots",
        words: "Everything fits: the constants are those that the recording was made with, and the two \
                programs agree. What remains of the forecast's error is the noise of the markers. With \
                other constants it does not fit: 3 % in EI is seen at once; let them be estimated \
                (`[estimate]`) where they are not known.",
    },
    Exhibit {
        scene: "soft-arm",
        figure: "snapshots",
        words: "The modulus comes to 0.1 % from a guess 40 % too low, damping to 1 % from one 67 % too \
                high, both within their σ, which counts what the mesh does: the same estimate is made with \
                forty segments and half the step.",
    },
    Exhibit {
        scene: "cable-between-posts",
        figure: "snapshots",
        words: "Damping and the shape in the wind are found, and the lost marker does not disturb. \
                Stiffness is not estimated here: a cable that hangs by its ends moves by its tension, and \
                bending shows in short waves only. Steps of 10 ms slow those, and the estimate makes up for \
                it by stiffness. With `--set estimate.ei={sigma=\"50%\",together=true}` and \
                `--set report.mesh=true` it finds EI 0.0026 ± 0.0006 N m² (it was made with 0.002) and \
                says that the mesh is what limits it; with steps of 2.5 ms (`time.step`, `time.window`) and \
                no allowance it finds 0.00210 ± 0.00003. The minimizer ends as stalled at 10 ms: places at \
                the start that stretch this cable by more than it can make the first step violent, and J is \
                not smooth there.",
    },
    Exhibit {
        scene: "tether-on-base",
        figure: "snapshots",
        words: "Stiffness comes to 0.1 % and a marker that was kept back to its noise. Damping is 4 % low, \
                1.6 of its σ: at 5 ms a step BDF2 damps a little of its own, which the estimate takes off. \
                The noise of the poses is taken out by a smooth curve; `[estimate] base` would make it part \
                of the estimate instead.",
    },
    Exhibit {
        scene: "rope-two-cameras",
        figure: "snapshots",
        words: "Pixels of two calibrated cameras place the rope to half a millimetre though no marker is \
                seen in space, and the background is 7 cm off. Every marker is hidden from one camera for a \
                while. Stiffness comes within its σ, which is mostly the mesh's: a rope that hangs moves by \
                its weight. One camera alone leaves depth to the model, and σ along its axis says so.",
    },
    Exhibit {
        scene: "twisted-rod",
        figure: "snapshots",
        words: "Twist is not seen, only the places of the centreline; but a rod with turns in it leaves its \
                plane, and how far tells GJ within a hundredth. Without the turns (`model.end.turns = 0`) \
                the same rod says nothing of GJ.",
    },
    Exhibit {
        scene: "beam-release",
        figure: "tracks",
        words: "A real recording, and a beam that is not quite a rod: it is short and thick, so that shear \
                and a clamp that gives way change its frequency by per cents. σ of the markers stands for \
                that misfit, a hundred times their noise.",
    },
    Exhibit {
        scene: "wire",
        figure: "snapshots",
        words: "A shape without times, from points picked by hand in a depth image, some millimetres off. \
                The stiffness that explains it agrees with what its makers list within its σ, which is \
                large: the wire's own set is not part of the scene.",
    },
    Exhibit {
        scene: "wires",
        figure: "",
        words: "Two shapes of another wire in one estimate. Each alone gives a stiffness, and together they \
                agree within their σ, but all are above the listed value: this wire keeps a set from its \
                coil, which the scene does not know.",
    },
    Exhibit {
        scene: "tether-in-current",
        figure: "snapshots",
        words: "A twin experiment with drag, a sinker and a recorded pull. Velocities gain little: four \
                places seen with σ = 1 cm over a second say little of errors as rough as those drawn here.",
    },
    Exhibit {
        scene: "hanging-rod-case1",
        figure: "snapshots",
        words: "The paper's rod. Its background is drawn from a smoother covariance than the one assumed, \
                as in the paper, so σ of velocities is too large: their errors are about two thirds of it.",
    },
    Exhibit {
        scene: "lorenz63",
        figure: "components",
        words: "A short window: the posterior is Gaussian and σ can be believed. Over windows beyond three \
                time units J has several minima; see the scene `lorenz63-window`.",
    },
    Exhibit {
        scene: "lorenz96",
        figure: "field",
        words: "Half of the variables are seen; the others are known from the model alone, and their σ is \
         larger.",
    },
    Exhibit {
        scene: "burgers",
        figure: "field",
        words: "The front is where σ is largest: its place is known less well than its height.",
    },
    Exhibit {
        scene: "linear-advection",
        figure: "field",
        words: "A linear model: J is a quadratic, one outer iteration is enough, and the posterior is exact.",
    },
    Exhibit {
        scene: "lorenz96-cycling-4dvar",
        figure: "errors",
        words: "Windows in turn with a static B. B is too large for what is left after some cycles, and the \
         report says by how much.",
    },
];

/// `cargo xtask gallery [VARDA]`: runs the scenes of the gallery and writes docs/guide/gallery and
/// docs/figures/gallery.
pub(crate) fn write(arguments: &[&str]) -> Result<(), String> {
    let varda = match arguments {
        [] => release_binary("varda")?,
        [binary] => Path::new(binary).to_path_buf(),
        other => return Err(format!("unknown arguments of gallery: {}", other.join(" "))),
    };
    let (pages, pictures) = (root().join("docs/guide/gallery"), root().join("docs/figures/gallery"));
    for folder in [&pages, &pictures] {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    let mut index = String::from(HEAD);
    for exhibit in EXHIBITS {
        let result = root().join("target/gallery").join(exhibit.scene);
        let mut run = Command::new(&varda);
        run.args(["run", exhibit.scene, "--quiet", "--out"]).arg(&result);
        let code = run.status().map_err(|e| format!("{run:?}: {e}"))?.code();
        if code != Some(0) {
            return Err(format!("{} does not fit: exit code {code:?}", exhibit.scene));
        }
        let shown = Command::new(&varda).args(["show", exhibit.scene]).output().map_err(|e| e.to_string())?;
        let scene = String::from_utf8_lossy(&shown.stdout).into_owned();
        let summary: Value =
            serde_json::from_str(&read(&result.join("summary.json"))?).map_err(|e| e.to_string())?;
        let title = title(&scene);
        store(&pages.join(format!("{}.md", exhibit.scene)), &page(exhibit, &scene, title, &summary))?;
        if !exhibit.figure.is_empty() {
            let svg = read(&result.join("figures").join(format!("{}.svg", exhibit.figure)))?;
            store(&pictures.join(format!("{}.svg", exhibit.scene)), &svg)?;
        }
        let _ = writeln!(index, "| [{title}]({0}.md) | `{0}` | {1} |", exhibit.scene, verdict(&summary));
        println!("{}: {}", exhibit.scene, verdict(&summary));
    }
    store(&pages.join("README.md"), &index)
}

const HEAD: &str = "\
# Gallery

Scenes that come with the program and run without a network, each with its picture, its numbers, and what
fits and what does not. `varda run NAME` runs one; `varda new my-scene --from NAME` copies it with its data to
start from. The pages are written by `cargo xtask gallery` from runs of the scenes.

| what | scene | verdict |
|---|---|---|
";

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

fn store(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))
}

fn title(scene: &str) -> &str {
    let line = scene.lines().find_map(|line| line.strip_prefix("title = "));
    line.map_or("", |line| line.trim_matches('"'))
}

/// The comment at the head of a scene, without what was measured: that is in the table.
fn introduction(scene: &str) -> String {
    let lines = scene.lines().map_while(|line| line.strip_prefix('#')).map(str::trim);
    let kept: Vec<&str> = lines.take_while(|line| !line.starts_with("Measured")).collect();
    // A table of a scene in brackets is code, not a link.
    let word = |word: &str| match word.find(']').filter(|_| word.starts_with('[')) {
        Some(_) => {
            let end = word.rfind(']').map_or(word.len(), |at| at + 1);
            format!("`{}`{}", &word[..end], &word[end..])
        }
        None => word.to_string(),
    };
    let line = |line: &&str| line.split(' ').map(word).collect::<Vec<_>>().join(" ");
    kept.iter().map(line).collect::<Vec<_>>().join("\n").trim().to_string()
}

fn verdict(summary: &Value) -> String {
    let name = summary["verdict"].as_str().unwrap_or_default().replace('_', " ");
    format!("{}: {}", name, summary["verdict_text"].as_str().unwrap_or_default()).replace('|', "\\|")
}

fn page(exhibit: &Exhibit, scene: &str, title: &str, summary: &Value) -> String {
    let name = exhibit.scene;
    let mut page = format!("# {title}\n\n{}\n", introduction(scene));
    if !exhibit.figure.is_empty() {
        let _ = writeln!(page, "\n![{title}](../../figures/gallery/{name}.svg)");
    }
    let _ = writeln!(page, "\n**{}**\n\n| | |\n|---|---|", verdict(summary));
    for (name, value) in rows(summary) {
        let _ = writeln!(page, "| {name} | {value} |");
    }
    let _ = write!(
        page,
        "\n## What fits, what does not\n\n{}\n\n## To run it\n\n```sh\nvarda run {name}\nvarda show {name}  \
            # the scene\nvarda new mine --from {name}     # a copy to start from, with its data\n```\n",
        exhibit.words
    );
    page
}

/// The numbers of a run that its page shows.
fn rows(summary: &Value) -> Vec<(String, String)> {
    let number = |value: &Value| value.as_f64().map_or("–".to_string(), short);
    let mut rows = vec![("observed values".to_string(), number(&summary["n_obs"]))];
    if summary["j_background"].is_number() {
        let [before, after] = [&summary["j_background"], &summary["j_analysis"]].map(number);
        rows.push(("J".into(), format!("{before} → {after}")));
    }
    for group in ["position", "velocity", "state"] {
        let [before, after] = ["background", "analysis"].map(|of| &summary["rmse"][format!("{group}_{of}")]);
        if before.is_number() {
            rows.push((format!("RMSE of {group}"), format!("{} → {}", number(before), number(after))));
        }
    }
    let all = |key: &str| summary[key].as_array().cloned().unwrap_or_default();
    for e in all("estimates").iter().filter(|e| !e["name"].as_str().unwrap_or_default().contains('(')).take(6)
    {
        let unit = e["unit"].as_str().filter(|u| *u != "1").map_or(String::new(), |u| format!(" {u}"));
        let with = |value: &str, sigma: &str| format!("{} ± {}", number(&e[value]), number(&e[sigma]));
        let mut text = format!("{}{unit} (prior {})", with("value", "sigma"), with("prior", "prior_sigma"));
        if e["identifiable"] == false {
            text = format!("not identifiable (prior {}{unit})", with("prior", "prior_sigma"));
        }
        if e["truth"].is_number() {
            let _ = write!(text, ", truth {}", number(&e["truth"]));
        }
        rows.push((format!("`{}`", e["name"].as_str().unwrap_or_default()), text));
    }
    let millimetres =
        |value: &Value| value.as_f64().map_or("–".to_string(), |v| format!("{:.2} mm", 1e3 * v));
    let label = |value: &Value| value["label"].as_str().unwrap_or_default().to_string();
    for w in all("withheld") {
        let pair = [&w["rms_background"], &w["rms_analysis"]].map(millimetres).join(" → ");
        rows.push((format!("kept back, {}: rms", label(&w)), pair));
    }
    if let Some(f) = all("forecast").last() {
        let text = format!("{}, persistence {}", millimetres(&f["analysis"]), millimetres(&f["persistence"]));
        rows.push((format!("forecast, {}: rms", label(f)), text));
    }
    if summary["cycles"].is_object() {
        let cycles = &summary["cycles"];
        rows.push(("cycles".into(), number(&cycles["count"])));
        let [background, end] = [&cycles["rmse_background"], &cycles["rmse_end"]].map(number);
        rows.push(("RMSE of background and analysis".into(), format!("{background}, {end}")));
    }
    rows
}

/// Four digits.
fn short(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e6).contains(&size) {
        return format!("{value:.3e}");
    }
    let digits =
        if size == 0.0 || value.fract() == 0.0 { 0 } else { (3.0 - size.log10().floor()).max(0.0) as usize };
    format!("{value:.digits$}")
}
