//! A scene on a finer mesh in space and time.

use crate::scene::{ClampAt, Estimate, Integrator, Invalid, Model, Prescribed, RodModel, Scene, SceneFile};

/// What says how far the mesh moves estimated constants.
#[derive(Debug, Clone)]
pub(crate) enum Finer {
    /// There is nothing to allow for, or the scene does not want it.
    Unwanted,
    /// There is no finer mesh, for this reason.
    Without(&'static str),
    /// A scene on the finer mesh.
    Scene(Box<FinerScene>),
}

/// A scene with half the step and, of a rod, twice the segments; without posterior and forecast.
#[derive(Debug, Clone)]
pub(crate) struct FinerScene {
    pub file: SceneFile,
    /// The error of the coarse mesh, as a multiple of the difference between both.
    pub of_difference: f64,
    /// What was changed, in words.
    pub change: &'static str,
    /// Its work as a multiple of the scene's own.
    pub work: f64,
}

impl Finer {
    /// With this many bytes for its limit of memory.
    pub(crate) fn within(mut self, bytes: usize) -> Finer {
        if let Finer::Scene(finer) = &mut self {
            finer.file.scene.limits.memory = format!("{} B", bytes.max(1));
        }
        self
    }
}

/// Errors fall with h² (clamps at their faces) and Δt²: 1/(1 − ¼) of the difference.
const SECOND_ORDER: f64 = 4.0 / 3.0;
/// A held edge makes the rod half a segment too short, an error that falls with h; that of backward Euler
/// falls with Δt.
const FIRST_ORDER: f64 = 2.0;

/// The scene with half the step and twice the segments, where constants are estimated.
///
/// # Errors
/// [`Invalid`] where the lengths of segments are.
pub(crate) fn finer(file: &SceneFile) -> Result<Finer, Invalid> {
    let mut file = file.clone();
    let scene = &mut file.scene;
    if !scene.report.mesh || scene.estimate.given().is_empty() {
        return Ok(Finer::Unwanted);
    }
    if !scene.algorithm.method.is_strong() {
        return Ok(Finer::Without("it takes a method with a strong constraint"));
    }
    let has_steps = scene.time.window > 0 && scene.time.integrator != Integrator::QuasiStatic;
    let mut first_order = has_steps && scene.time.integrator == Integrator::BackwardEuler;
    let (change, work) = match (&mut scene.model, has_steps) {
        (Model::Rod(rod), _) => {
            first_order |= holds_an_edge(rod);
            double(rod)?;
            match has_steps {
                true => ("twice the segments and half the step", 4.0),
                false => ("twice the segments", 2.0),
            }
        }
        (model, _) if model.line().is_some() => {
            return Ok(Finer::Without("only a rod is given a finer mesh"));
        }
        (_, true) => ("half the step", 2.0),
        (_, false) => return Ok(Finer::Unwanted),
    };
    if has_steps {
        halve_step(scene);
    }
    scene.report.mesh = false;
    scene.report.posterior = false;
    scene.report.forecast = 0.0;
    scene.consider = Estimate::default();
    let of_difference = if first_order { FIRST_ORDER } else { SECOND_ORDER };
    Ok(Finer::Scene(Box::new(FinerScene { file, of_difference, change, work })))
}

/// Whether two neighbouring vertices are held, as by the paper's clamp.
fn holds_an_edge(rod: &RodModel) -> bool {
    let by_clamps = rod.clamp == ClampAt::Edge && (rod.start.is_some() || rod.end.is_some());
    let neighbours = |p: &Prescribed| rod.prescribed.iter().any(|q| p.vertex + 1 == q.vertex);
    by_clamps || rod.prescribed.iter().any(neighbours)
}

/// The same time in twice as many steps. Where steps are divided by a tolerance, each part is halved: the
/// error of one falls with the cube of its length, with the square of it by backward Euler.
fn halve_step(scene: &mut Scene) {
    let time = &mut scene.time;
    match (&mut time.step, &mut time.steps_per_period, &mut time.tolerance) {
        (_, _, Some(tolerance)) => {
            *tolerance /= if time.integrator == Integrator::BackwardEuler { 4.0 } else { 8.0 };
            return;
        }
        (Some(step), _, None) => *step /= 2.0,
        (None, Some(steps), None) => *steps *= 2,
        (None, None, None) => {}
    }
    time.window *= 2;
    time.spin_up *= 2;
    scene.algorithm.window_growth.iter_mut().for_each(|end| *end *= 2);
}

/// Twice the segments, equal ones where no held vertex is moved by that.
fn double(rod: &mut RodModel) -> Result<(), Invalid> {
    let last = rod.segments.unwrap_or(0);
    // with a clamp at its face only the ends of equal segments are at the same place in both meshes
    let stays = |vertex: usize| vertex == 0 || vertex == last;
    let faces = rod.faces() != [false; 2];
    match &mut rod.segments {
        Some(segments) if !faces || rod.prescribed.iter().all(|p| stays(p.vertex)) => {
            *segments *= 2;
            rod.prescribed.iter_mut().for_each(|p| p.vertex *= 2);
        }
        _ => halve(rod)?,
    }
    Ok(())
}

/// Halves every segment: every vertex keeps its place.
///
/// # Errors
/// [`Invalid`] where the lengths of segments are.
pub(crate) fn halve(rod: &mut RodModel) -> Result<(), Invalid> {
    let halves = rod.rest_lengths()?.iter().flat_map(|l| [0.5 * l; 2]).collect();
    (rod.length, rod.segments, rod.segment_lengths) = (None, None, Some(halves));
    rod.prescribed.iter_mut().for_each(|p| p.vertex *= 2);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rod of five segments, 1 m long, whose section is of no account.
    fn rod(more: &str) -> RodModel {
        let section = "section = { kind = \"stiffness\", ea = 1.0, ei = [1.0, 1.0], gj = 1.0, \
                       mass_per_length = 1.0 }";
        toml::from_str(&format!("length = 1.0\nsegments = 5\n{section}\n{more}")).unwrap()
    }

    fn places(rod: &RodModel) -> Vec<f64> {
        let s: Vec<f64> = rod
            .rest_lengths()
            .unwrap()
            .iter()
            .scan(0.0, |s, l| {
                *s += l;
                Some(*s)
            })
            .collect();
        rod.prescribed.iter().map(|p| if p.vertex == 0 { 0.0 } else { s[p.vertex - 1] }).collect()
    }

    #[test]
    fn what_is_held_keeps_its_place() {
        let start = "[start]\nposition = [0.0, 0.0, 0.0]\ntangent = [0.0, 0.0, -1.0]\n";
        let end = "[end]\nposition = [0.5, 0.0, 0.0]\ntangent = [0.0, 0.0, 1.0]\n";
        let hook = |vertex: usize| format!("[[prescribed]]\nvertex = {vertex}\nposition = [0.5, 0.0, 0.0]\n");
        let edge = "clamp = \"edge\"\n";
        for (name, more, equal) in [
            ("a clamp", start.to_string(), true),
            ("a clamp and a hook at the end", format!("{start}{}", hook(5)), true),
            ("a hook at the start and a clamp", format!("{end}{}", hook(0)), true),
            ("two clamps", format!("{start}{end}"), true),
            ("two hooks", hook(0) + &hook(5), true),
            ("two hooks and one between", hook(0) + &hook(2) + &hook(5), true),
            ("held edges and a hook between", format!("{edge}{start}{end}{}", hook(3)), true),
            ("a clamp and a hook between", format!("{start}{}", hook(3)), false),
            ("two clamps and a hook between", format!("{start}{end}{}", hook(2)), false),
        ] {
            let (coarse, mut fine) = (rod(&more), rod(&more));
            double(&mut fine).unwrap();
            assert_eq!(fine.segments.is_some(), equal, "{name}");
            assert_eq!(fine.rest_lengths().unwrap().len(), 10, "{name}");
            for (a, b) in places(&coarse).iter().zip(places(&fine)) {
                assert!((a - b).abs() < 1e-14, "{name}: held at {a} and {b} m");
            }
        }
    }
}
