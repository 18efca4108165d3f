//! The recording of scene `rope-two-cameras`: how it was made, and what the scene finds of the truth.

use std::fmt::Write;

use varda::outcome::{Experiment, Outcome, Verdict};
use varda::run::{Listener, assimilate, simulate};
use varda::scene::{Observations, SceneFile, shipped_data, shipped_scene};
use varda::setup::Problem;

/// EI of the rope that was recorded \[N m²\].
const TRUE_EI: f64 = 4e-3;
/// The truth has twice the segments and a quarter of the step.
const FINER: usize = 2;
const SHORTER: usize = 4;
/// The model's clock at time 0 of the recording \[s\].
const TIME_ZERO: f64 = 10.7;

fn shipped() -> (SceneFile, &'static str) {
    let text = shipped_scene("rope-two-cameras").unwrap().text;
    (SceneFile::open("rope-two-cameras", &[]).unwrap(), text)
}

/// A twin experiment with the truth: the shipped scene's model and cameras.
fn truth() -> Problem {
    let (file, text) = shipped();
    let Observations::File(recording) = &file.scene.observations else { panic!("a recording") };
    let part = |from: &str, to: &str| {
        let start = text.find(from).unwrap();
        &text[start..start + text[start..].find(to).unwrap()]
    };
    let places: Vec<f64> = recording.markers.iter().map(|m| m.arc_length).collect();
    // 25 Hz, the first at the start of the window
    let frames: Vec<usize> = (0..=20).map(|frame| 4 * SHORTER * frame).collect();
    let twin = format!(
        "seed = 3\n{}\n{}\n[background]\nfrom = \"truth-plus-draw\"\n{}\n[observations]\n\
         kind = \"synthetic\"\nplaces = {places:?}\nsteps = {frames:?}\n{}",
        part("[model]", "[time]"),
        part("[time]", "[background]"),
        part("[background.covariance]", "[estimate]"),
        part("[[observations.cameras]]", "[[observations.markers]]"),
    );
    let time = &file.scene.time;
    let sets = [
        format!("model.segments={}", 20 * FINER),
        format!("model.section.ei=[{TRUE_EI}, {TRUE_EI}]"),
        format!("time.step={}", time.step.unwrap() / SHORTER as f64),
        format!("time.spin_up={}", time.spin_up * SHORTER),
        format!("time.window={}", time.window * SHORTER),
    ];
    Problem::from_scene(&SceneFile::parse("truth", "truth.toml", &twin, None, &sets).unwrap()).unwrap()
}

/// What cameras see of it, with gaps: a stand before one, a person before the other, failed detections.
fn recording(truth: &Problem) -> String {
    let grid = truth.experiment.grid;
    let mut out = String::from("time_s,camera,marker,u_px,v_px\n");
    for (i, seen) in truth.observed.pixels(&grid).iter().enumerate() {
        let marker = (seen.arc_length / 0.12).round() as usize;
        let time = seen.time + TIME_ZERO;
        let behind_a_stand =
            seen.camera == "left" && (4..=6).contains(&marker) && time > 12.7 && time < 12.95;
        let behind_somebody = seen.camera == "right" && marker >= 7 && time > 13.0 && time < 13.2;
        if behind_a_stand || behind_somebody || i * 7919 % 97 < 6 {
            continue;
        }
        let [u, v] = seen.pixel;
        writeln!(out, "{time:.3},{},m{marker:02},{u:.2},{v:.2}", seen.camera).unwrap();
    }
    out
}

/// Set VARDA_WRITE_ROPE to a path to write the file anew.
#[test]
fn the_recording_is_that_of_a_finer_rope() {
    let made = recording(&truth());
    if let Ok(path) = std::env::var("VARDA_WRITE_ROPE") {
        std::fs::write(path, &made).unwrap();
    }
    let (_, text) = shipped();
    let (_, ships) = shipped_data(text).next().unwrap();
    assert_eq!(made.lines().count(), ships.lines().count());
    for (made, ships) in made.lines().zip(ships.lines()).skip(1) {
        let split = |line: &str| {
            let cells: Vec<String> = line.split(',').map(str::to_string).collect();
            (cells[..3].join(","), [cells[3].clone(), cells[4].clone()].map(|p| p.parse::<f64>().unwrap()))
        };
        let ((of, [u, v]), (also, [us, vs])) = (split(made), split(ships));
        // sines of another machine may round a pixel's second decimal the other way
        assert!(of == also && (u - us).abs() < 0.02 && (v - vs).abs() < 0.02, "{made} {ships}");
    }
}

#[test]
fn the_scene_fits_and_has_the_truth_within_its_sigma() {
    let (file, _) = shipped();
    let outcome = assimilate(&Problem::from_scene(&file).unwrap(), &mut Listener::silent()).unwrap();
    assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{}", outcome.judgement.text);
    let ei = outcome.estimates.iter().find(|e| e.name == "ei").unwrap();
    let sigma = ei.sigma.unwrap();
    // a number of one seed
    assert!((ei.value - TRUE_EI).abs() < 2.0 * sigma && sigma < 6e-4, "{} ± {sigma}", ei.value);

    // At the start of the window: the vertices of the scene's rope on the truth's.
    let truth = simulate(&truth()).unwrap();
    let arc_lengths =
        |experiment: &Experiment| experiment.state.geometry.as_ref().unwrap().arc_lengths.clone();
    let (coarse, fine) = (arc_lengths(&outcome.experiment), arc_lengths(&truth.experiment));
    let (analysis, truth) = (outcome.shapes.as_ref().unwrap(), truth.shapes.unwrap());
    let truth: Vec<Vec<[f64; 3]>> = truth
        .analysis
        .iter()
        .step_by(SHORTER)
        .map(|shape| coarse.iter().map(|s| on_polygon(&fine, shape, *s)).collect())
        .collect();
    let free = &outcome.experiment.state.geometry.as_ref().unwrap().free;
    let deviation = |i: usize| {
        let (v, c) = (free[i / 3], i % 3);
        (analysis.analysis[0][v][c] - truth[0][v][c]) / outcome.analysis.sigma_analysis[i]
    };
    let deviations: Vec<f64> = (0..3 * free.len()).map(deviation).collect();
    let rms = (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt();
    let largest = deviations.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    // 57 numbers, of which neighbours go together
    assert!(rms < 1.5 && largest < 4.0, "{rms} {largest}");

    // Along the window the analysis is about a pixel off, and the background a hundred.
    let [before, after] = [&analysis.background, &analysis.analysis].map(|run| distance(run, &truth));
    assert!(before > 0.03 && after < 2e-3, "{before} {after}");
    in_pixels(&outcome);
}

/// The point at an arc length of a polygon whose vertices have these.
fn on_polygon(arc_lengths: &[f64], shape: &[[f64; 3]], s: f64) -> [f64; 3] {
    let edge = arc_lengths.partition_point(|a| *a <= s).clamp(1, shape.len() - 1) - 1;
    let w = (s - arc_lengths[edge]) / (arc_lengths[edge + 1] - arc_lengths[edge]);
    std::array::from_fn(|c| (1.0 - w) * shape[edge][c] + w * shape[edge + 1][c])
}

/// Root mean square distance of the vertices of two runs.
fn distance(run: &[Vec<[f64; 3]>], truth: &[Vec<[f64; 3]>]) -> f64 {
    let pairs = || run.iter().zip(truth).flat_map(|(a, b)| a.iter().zip(b));
    let square = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>();
    (pairs().map(square).sum::<f64>() / pairs().count() as f64).sqrt()
}

/// Values have the unit of pixels in every table.
fn in_pixels(outcome: &Outcome) {
    assert_eq!(outcome.fit.len(), 20, "ten markers in two cameras");
    for fit in &outcome.fit {
        assert!(fit.quantity.unit() == "px" && fit.sigma == 0.5 && fit.label.contains(" in camera "));
        assert!((0.6..1.5).contains(&fit.ratio), "{fit:?}");
    }
    assert!(outcome.observed.iter().all(|o| o.unit == "px" && ["u", "v"].contains(&o.axis)));
    assert!(outcome.shapes.as_ref().unwrap().seen.is_empty(), "no place was seen");
}
