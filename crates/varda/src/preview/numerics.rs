//! What the numerics do to a rod: damping of the integrator, and the mesh.

use serde::Serialize;
use varda_implicit::Scheme;
use varda_rod::{Rest, Vector3, modes};

use super::finding::Finding;
use crate::Error;
use crate::scene::{Model, Observations, SceneFile};
use crate::setup::files::Files;
use crate::setup::finer::halve;
use crate::setup::rod_model::RodParts;

/// How many modes are looked at.
const MODES: usize = 3;
/// The integrator damps too much where it takes this share of an amplitude within the window.
const TAKES: f64 = 0.2;
/// A mesh is coarse where doubling it moves the rod at rest by this share of its length.
const COARSE: f64 = 0.01;

/// A slow mode of the rod about its shape at rest.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeDamping {
    /// Frequency \[Hz\].
    pub frequency: f64,
    /// Steps to a period.
    pub steps: f64,
    /// Rate at which the integrator damps its amplitude \[1/s\].
    pub numerical: f64,
    /// The share of its frequency that the integrator takes.
    pub slowed: f64,
    /// The most at which the material does \[1/s\]: ½(α + τω²); what gravity holds is not damped.
    pub material: f64,
}

/// What a mesh of half the segments' length does.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshEffect {
    /// How far it moves the rod at rest, at most \[m\].
    pub moves: f64,
    /// Arc length of where that is \[m\].
    pub arc_length: f64,
    /// The same over the length of the rod.
    pub share: f64,
}

/// The rate \[1/s\] at which a scheme damps the amplitude of ẍ = −ω²x with steps Δt: −ln|z|/Δt, z
/// the root of the scheme's polynomial for ẋ = iωx that is near exp(iωΔt). For small ωΔt it is
/// ω²Δt/2 for backward Euler, ω⁴Δt³/4 for BDF2, and nothing for the midpoint rule.
///
/// ```
/// use varda::preview::numerical_damping;
/// use varda_implicit::Scheme;
///
/// let (omega, dt) = (2.0, 0.01);
/// let rate = numerical_damping(Scheme::BackwardEuler, omega, dt);
/// assert!((rate / (0.5 * omega * omega * dt) - 1.0).abs() < 1e-3);
/// ```
pub fn numerical_damping(scheme: Scheme, omega: f64, dt: f64) -> f64 {
    let w = omega * dt;
    match scheme {
        Scheme::BackwardEuler => 0.5 * (w * w).ln_1p() / dt,
        Scheme::Midpoint => 0.0,
        Scheme::Bdf2 => {
            let root = bdf2_root(w);
            let z = (2.0 + root[0]).hypot(root[1]) / 3.0_f64.hypot(2.0 * w);
            -z.ln() / dt
        }
    }
}

/// The share of its frequency that a scheme takes of ẍ = −ω²x with steps Δt: 1 − arg z/(ωΔt), with
/// z of [`numerical_damping`]. For small ωΔt it is (ωΔt)²/3 for backward Euler and BDF2, and
/// (ωΔt)²/12 for the midpoint rule.
///
/// ```
/// use varda::preview::numerical_slowing;
/// use varda_implicit::Scheme;
///
/// let (omega, dt) = (2.0, 0.01);
/// let share = numerical_slowing(Scheme::Bdf2, omega, dt);
/// assert!((share / ((omega * dt).powi(2) / 3.0) - 1.0).abs() < 1e-2);
/// ```
pub fn numerical_slowing(scheme: Scheme, omega: f64, dt: f64) -> f64 {
    let w = omega * dt;
    let turned = match scheme {
        Scheme::BackwardEuler => w.atan(),
        Scheme::Midpoint => 2.0 * (0.5 * w).atan(),
        Scheme::Bdf2 => {
            let root = bdf2_root(w);
            root[1].atan2(2.0 + root[0]) + (2.0 * w).atan2(3.0)
        }
    };
    1.0 - turned / w
}

/// √(1 + 2iw), with which the root of (3 − 2iw) z² − 4z + 1 = 0 is z = (2 + √(1 + 2iw))/(3 − 2iw).
fn bdf2_root(w: f64) -> [f64; 2] {
    let size = 1.0_f64.hypot(2.0 * w);
    [(0.5 * (size + 1.0)).sqrt(), (0.5 * (size - 1.0)).sqrt()]
}

/// The slowest modes, and what is damped; none where the rod has no natural modes (loads without potential).
pub(super) fn damping(parts: &RodParts, rest: &Rest, t: f64, dt: f64) -> Vec<ModeDamping> {
    let Ok(found) = modes(&parts.rod, &parts.supports, &parts.loads, t, rest, MODES) else {
        return Vec::new();
    };
    let of = |omega_squared: f64| {
        let omega = omega_squared.sqrt();
        ModeDamping {
            frequency: omega / std::f64::consts::TAU,
            steps: std::f64::consts::TAU / (omega * dt),
            numerical: numerical_damping(parts.scheme, omega, dt),
            slowed: numerical_slowing(parts.scheme, omega, dt),
            material: 0.5 * (parts.damping.mass + parts.damping.stiffness * omega_squared),
        }
    };
    found.modes.iter().filter(|mode| mode.omega_squared > 0.0).map(|mode| of(mode.omega_squared)).collect()
}

/// What the integrator takes of the slowest mode in a window \[s\], where that is much beside the material.
pub(super) fn too_much(modes: &[ModeDamping], window: f64) -> Option<Finding> {
    let slowest = modes.first()?;
    let taken = 1.0 - (-slowest.numerical * window).exp();
    if slowest.steps < 8.0 {
        return Some(Finding::warning(
            "time.step",
            format!(
                "the slowest mode, {:.3} Hz, has {:.1} steps to a period: its motion is not followed",
                slowest.frequency, slowest.steps
            ),
        ));
    }
    (taken > TAKES && slowest.numerical > slowest.material).then(|| {
        Finding::warning(
            "time.integrator",
            format!(
                "it damps the slowest mode, {:.3} Hz, by {:.3} 1/s: {:.0} % of its amplitude in the window, \
                 where the material takes {:.3} 1/s at most; \"bdf2\", or a shorter step",
                slowest.frequency,
                slowest.numerical,
                100.0 * taken,
                slowest.material
            ),
        )
    })
}

/// The rod at rest with every segment halved, beside the one it has.
pub(super) fn halved(file: &SceneFile, parts: &RodParts, rest: &Rest, t: f64) -> Result<MeshEffect, Error> {
    let mut finer = file.clone();
    let Model::Rod(model) = &mut finer.scene.model else { unreachable!("the parts are those of a rod") };
    file.checked(halve(model))?;
    let model = model.clone();
    let mut fine = RodParts::read(&Files::of(&finer), &model)?;
    // the same branch, where there are several
    let shape = Rest::through_at(&fine.rod, &parts.rod.arc_lengths(), &rest.vertices);
    if let Ok(shape) = shape {
        fine.search.initial_shape = Some(shape);
    }
    let finer = fine.at_rest(t)?;
    let apart = |(i, x): (usize, &Vector3<f64>)| (i, (finer.vertices[2 * i] - x).norm());
    let most = rest.vertices.iter().enumerate().map(apart).max_by(|a, b| a.1.total_cmp(&b.1));
    let (vertex, moves) = most.expect("a rod has vertices");
    let arc_length = parts.rod.arc_lengths()[vertex];
    Ok(MeshEffect { moves, arc_length, share: moves / parts.rod.length() })
}

/// Segments of a rod at which twice as many move it at rest by less than σ of its recording, from those of
/// the scene up to `most`; `None` where that cannot be said.
pub fn enough_segments(file: &SceneFile, most: usize) -> Option<usize> {
    let Observations::File(recording) = &file.scene.observations else { return None };
    let (sigma, t) = (recording.sigma?, file.grid().ok()?.start);
    let mut file = file.clone();
    loop {
        let Model::Rod(model) = &mut file.scene.model else { return None };
        let segments = model.segments?;
        let model = model.clone();
        let parts = RodParts::read(&Files::of(&file), &model).ok()?;
        let rest = parts.at_rest(t).ok()?;
        let moves = halved(&file, &parts, &rest, t).ok()?.moves;
        if moves <= sigma || segments >= most {
            return Some(segments);
        }
        // the error falls with the square of a segment's length
        let wanted = (segments as f64 * (moves / sigma).sqrt()).ceil() as usize;
        if let Model::Rod(model) = &mut file.scene.model {
            model.segments = Some(wanted.next_multiple_of(4).clamp(segments + 4, most.max(segments + 4)));
        }
    }
}

/// Where the mesh is too coarse: for the rod, or for a recording with values of this σ \[m\].
pub(super) fn too_coarse(mesh: &MeshEffect, segments: usize, sigma: Option<f64>) -> Option<Finding> {
    let seen = sigma.filter(|sigma| mesh.moves > *sigma);
    (mesh.share > COARSE || seen.is_some()).then(|| {
        let above = seen.map_or(String::new(), |sigma| {
            format!(", more than σ = {sigma:.2e} m of what was seen: take more segments")
        });
        Finding::warning(
            "model.segments",
            format!(
                "twice as many as {segments} move the rod at rest by {:.4} m at s = {:.4} m, {:.1} % of its \
                 length{above}",
                mesh.moves,
                mesh.arc_length,
                100.0 * mesh.share
            ),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_that_moves_the_rod_by_more_than_what_was_seen_is_named() {
        let mesh = MeshEffect { moves: 3e-3, arc_length: 0.25, share: 0.003 };
        let said = too_coarse(&mesh, 20, Some(1e-3)).expect("three σ").to_string();
        assert!(said.contains("model.segments") && said.contains("1.00e-3 m of what was seen"), "{said}");
        assert!(too_coarse(&mesh, 20, Some(4e-3)).is_none());
        assert!(too_coarse(&mesh, 20, None).is_none());
        assert!(too_coarse(&MeshEffect { share: 0.02, ..mesh }, 20, None).is_some());
    }

    /// Beside what running the schemes gives.
    #[test]
    fn rates_are_those_of_the_schemes() {
        let (omega, dt, steps) = (5.0_f64, 0.02, 400);
        let w = omega * dt;
        // z² (3 − 2iw) = 4z − z₋: by complex arithmetic in pairs
        let divide = |a: [f64; 2], b: [f64; 2]| {
            let n = b[0] * b[0] + b[1] * b[1];
            [(a[0] * b[0] + a[1] * b[1]) / n, (a[1] * b[0] - a[0] * b[1]) / n]
        };
        let mut z = vec![[1.0, 0.0], [w.cos(), w.sin()]];
        for k in 1..steps {
            let sum = [4.0 * z[k][0] - z[k - 1][0], 4.0 * z[k][1] - z[k - 1][1]];
            z.push(divide(sum, [3.0, -2.0 * w]));
        }
        let size = |k: usize| z[k][0].hypot(z[k][1]);
        let rate = -(size(steps) / size(steps / 2)).ln() / (dt * (steps / 2) as f64);
        assert!((numerical_damping(Scheme::Bdf2, omega, dt) / rate - 1.0).abs() < 1e-9);
        assert!((rate / (0.25 * omega.powi(4) * dt.powi(3)) - 1.0).abs() < 0.05);
        let step = divide(z[steps], z[steps - 1]);
        let slowed = 1.0 - step[1].atan2(step[0]) / w;
        assert!((numerical_slowing(Scheme::Bdf2, omega, dt) / slowed - 1.0).abs() < 1e-9);
        for (scheme, of_square) in [(Scheme::BackwardEuler, 3.0), (Scheme::Midpoint, 12.0)] {
            let expected = w * w / of_square;
            assert!((numerical_slowing(scheme, omega, dt) / expected - 1.0).abs() < 0.01, "{scheme:?}");
        }
        let euler = numerical_damping(Scheme::BackwardEuler, omega, dt);
        assert!((euler * dt - 1.0_f64.hypot(w).ln()).abs() < 1e-15);
        assert_eq!(numerical_damping(Scheme::Midpoint, omega, dt), 0.0);
    }
}
