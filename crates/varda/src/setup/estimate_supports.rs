//! Supports among the unknown constants: directions of clamps, drives, and errors of recorded places.

use std::sync::Arc;

use varda_rod::{Change, Displacement, EllipseDrive, HeldAt, Law, Moved, MovedBy, Parameter, Vector3};

use super::constant::{Constant, Effect, Kind};
use super::motion::{Followed, Turned, drive};
use crate::scene::{Estimate, Motion, RodModel, Unknown};

/// Coefficients of the error of a coordinate at most.
const MOST: usize = 400;

/// The supports of a rod by their names, with their positions and motions.
fn supports(model: &RodModel) -> impl Iterator<Item = (String, HeldAt, [f64; 3], Option<&Motion>)> {
    let clamp = |name: &str, of, clamp: &'_ Option<crate::scene::Clamp>| {
        clamp.as_ref().map(|_| (name.to_string(), of))
    };
    let clamps = [clamp("start", HeldAt::Start, &model.start), clamp("end", HeldAt::End, &model.end)];
    let keys = [&model.start, &model.end];
    let clamps = clamps.into_iter().zip(keys).filter_map(|(named, keys)| {
        let ((name, of), keys) = (named?, keys.as_ref()?);
        Some((name, of, keys.position.unwrap_or_default(), keys.motion.as_ref()))
    });
    let prescribed = model.prescribed.iter().enumerate().map(|(i, p)| {
        let place = p.position.unwrap_or_default();
        (format!("prescribed.{i}"), HeldAt::Vertex(p.vertex), place, p.motion.as_ref())
    });
    clamps.chain(prescribed)
}

/// A support at path `model.{name}`.
fn held_at(model: &RodModel, path: &str) -> Option<HeldAt> {
    supports(model).find(|s| path.strip_prefix("model.") == Some(s.0.as_str())).map(|s| s.1)
}

/// Whether a turn of a clamp about its tangent shows in the places of the centreline.
pub(super) fn turns_show(model: &RodModel, estimate: &Estimate, isotropic: bool) -> bool {
    let curved = model.natural_curvature != [0.0; 2]
        || model.rest_shape.is_some()
        || estimate.natural_curvature.is_some();
    let by_axes = estimate.ei.as_ref().is_some_and(|ei| !ei.together());
    (model.start.is_some() && model.end.is_some()) || curved || by_axes || !isotropic
}

/// The components of a key of supports, in order; none where it is another key.
pub(super) fn kinds(key: &str, model: &RodModel, estimate: &Estimate, isotropic: bool) -> Option<Vec<Kind>> {
    let kind = |name: String, unit, value, of, by| {
        let change = Change { supports: vec![Moved { of, by }], ..Change::default() };
        Kind { name, unit, value, change: Effect::Unit(change) }
    };
    if key == "clamp_direction" {
        let axes = [("m1", Vector3::x()), ("m2", Vector3::y()), ("t", Vector3::z())];
        let count = if turns_show(model, estimate, isotropic) { 3 } else { 2 };
        let clamps = supports(model).filter(|s| !matches!(s.1, HeldAt::Vertex(_)));
        let all = clamps.flat_map(|(clamp, of, ..)| {
            axes.map(|(axis, by)| kind(format!("{key}[{clamp}].{axis}"), "rad", 0.0, of, MovedBy::Turn(by)))
                .into_iter()
                .take(count)
        });
        return Some(all.collect());
    }
    if key == "support_position" {
        let axes = [("x", Vector3::x()), ("y", Vector3::y()), ("z", Vector3::z())];
        let all = supports(model).flat_map(|(support, of, ..)| {
            axes.map(|(axis, by): (&str, Vector3<f64>)| {
                let by = MovedBy::Along(Displacement(Arc::new(by)));
                kind(format!("{key}[{support}].{axis}"), "m", 0.0, of, by)
            })
        });
        return Some(all.collect());
    }
    let drives: Vec<(String, HeldAt, EllipseDrive)> = supports(model)
        .filter_map(|(name, of, position, motion)| Some((name, of, drive(position, motion?)?)))
        .collect();
    let named = |support: &str, rest: &str| match drives.len() {
        1 => format!("{key}{rest}"),
        _ => format!("{key}[{support}]{rest}"),
    };
    let by = |drive: &EllipseDrive, radii, phase| MovedBy::Drive { drive: *drive, radii, phase };
    match key {
        "drive_radii" => Some(
            drives
                .iter()
                .flat_map(|(name, of, drive)| {
                    [[1.0, 0.0], [0.0, 1.0]]
                        .into_iter()
                        .zip(drive.radii)
                        .enumerate()
                        .map(move |(c, (unit, radius))| (name, *of, *drive, c, unit, radius))
                })
                .map(|(name, of, drive, c, unit, radius)| {
                    kind(named(name, &format!("[{c}]")), "m", radius, of, by(&drive, unit, 0.0))
                })
                .collect(),
        ),
        "drive_phase" => Some(
            drives
                .iter()
                .map(|(name, of, drive)| kind(named(name, ""), "rad", 0.0, *of, by(drive, [0.0; 2], 1.0)))
                .collect(),
        ),
        _ => None,
    }
}

/// Errors of recorded places as a stationary cubic spline in time, knots h apart:
///
/// ```text
/// e(t) = Σ_j c_j B((t − t_j)/h),   c_j ~ N(0, σ_c²) independent,   σ_c² = σ_e² / 0.4799
/// ```
///
/// Σ B² is between 0.46 and 0.5, 0.4799 in the mean, so that e has the variance σ_e² within 4 %. With a
/// `correlation_time` that is h, and σ_e what is given. Without, errors of rows are independent with the σ
/// given, Δt apart; smoothing by third differences with the cut-off f leaves of it
///
/// ```text
/// σ_e² = σ² 2Δt ∫ (1 + (ν/f)⁶)⁻² dν = 1.745 f Δt σ²
/// ```
///
/// with the spectral density σ² Δt well below f and a quarter of that at f. That of e is
/// σ_c² h sinc⁸(νh): with h = 1/4f, 0.91 and 0.39 times σ² Δt. Where every row is followed, f is half
/// of their rate.
///
/// # Errors
/// What is wrong with the key.
pub(super) fn of_base(
    unknown: &Unknown,
    sigma: f64,
    model: &RodModel,
    followed: &[Followed],
    [first, last]: [f64; 2],
) -> Result<Vec<(Constant, Parameter)>, String> {
    let mut all = Vec::new();
    for Followed { path, interval, cut_off, .. } in followed {
        let Some(of) = held_at(model, path) else { continue };
        let name = path.strip_prefix("model.").unwrap_or(path);
        let spline = Spline::of(unknown, sigma, (path, *interval, *cut_off), [first, last])?;
        for (c, axis) in ["x", "y", "z"].into_iter().enumerate() {
            spline.add(&format!("base[{name}].{axis}"), "m", c, &mut all, |along| Moved {
                of,
                by: MovedBy::Along(along),
            });
        }
    }
    Ok(all)
}

/// Errors of recorded rotations in the same way, each a rotation vector in the clamp's own axes, about the
/// origin of the body; about the tangent where that shows.
///
/// # Errors
/// What is wrong with the key.
pub(super) fn of_base_rotation(
    unknown: &Unknown,
    sigma: f64,
    model: &RodModel,
    followed: &[Followed],
    (run, about_t): ([f64; 2], bool),
) -> Result<Vec<(Constant, Parameter)>, String> {
    let mut all = Vec::new();
    for Followed { path, interval, turned, .. } in followed {
        let (Some(of), Some(Turned { cut_off, arm })) = (held_at(model, path), *turned) else { continue };
        let name = path.strip_prefix("model.").unwrap_or(path);
        let spline = Spline::of(unknown, sigma, (path, *interval, cut_off), run)?;
        // with an arm a turn about the tangent moves the clamp
        let axes = if about_t || arm.x != 0.0 || arm.y != 0.0 { 3 } else { 2 };
        for (c, axis) in ["m1", "m2", "t"].into_iter().enumerate().take(axes) {
            spline.add(&format!("base_rotation[{name}].{axis}"), "rad", c, &mut all, |along| Moved {
                of,
                by: MovedBy::TurnAlong { along, arm },
            });
        }
    }
    match all.is_empty() {
        true => Err("needs a clamp whose rotation is recorded: motion.kind = \"pose\", or \"markers\" with \
                     two names or more"
            .into()),
        false => Ok(all),
    }
}

/// Coefficients of an error in time of one coordinate.
struct Spline {
    /// Time between knots \[s\], the first knot, and how many.
    h: f64,
    first: f64,
    count: usize,
    /// σ of a coefficient.
    sigma: f64,
}

impl Spline {
    /// Of what was recorded at these intervals \[s\] and smoothed from this frequency \[Hz\] on.
    fn of(
        unknown: &Unknown,
        sigma: f64,
        (path, interval, cut_off): (&str, f64, Option<f64>),
        [first, last]: [f64; 2],
    ) -> Result<Spline, String> {
        let Unknown::Every(prior) = unknown else { unreachable!("the scene was checked") };
        let f = cut_off.unwrap_or(f64::INFINITY).min(0.5 / interval);
        let (h, sigma) = match prior.correlation_time {
            Some(time) => (time, sigma),
            None => (0.25 / f, sigma * (LEFT * f * interval).sqrt()),
        };
        let count = ((last - first) / h).ceil() + 3.0;
        if !(count <= MOST as f64) {
            return Err(format!(
                "errors of {path} would be {count:.0} numbers for each coordinate (knots {h:.3e} s apart), \
                 more than {MOST}: smooth the motion (its `cutoff` or `sigma`), or give `correlation_time`"
            ));
        }
        Ok(Spline { h, first, count: count as usize, sigma: sigma / MEAN_SQUARES.sqrt() })
    }

    /// Adds the coefficients of component c.
    fn add(
        &self,
        name: &str,
        unit: &'static str,
        c: usize,
        all: &mut Vec<(Constant, Parameter)>,
        moved: impl Fn(Displacement) -> Moved,
    ) {
        for j in 0..self.count {
            let (h, knot) = (self.h, self.first + (j as f64 - 1.0) * self.h);
            let along = move |t: f64| {
                let mut moved = Vector3::zeros();
                moved[c] = bump((t - knot) / h);
                moved
            };
            let supports = vec![moved(Displacement(Arc::new(along)))];
            let change = Change { supports, ..Change::default() };
            let name = format!("{name}(t = {knot:.4} s)");
            all.push((
                Constant { name, unit, value: 0.0, law: Law::Linear, sigma: self.sigma },
                Parameter { change, law: Law::Linear },
            ));
        }
    }
}

/// 2 ∫₀^∞ (1 + u⁶)⁻² du = (5/3) (π/6)/sin(π/6).
const LEFT: f64 = 5.0 * std::f64::consts::PI / 9.0;
/// ∫ B² over its support, the mean of Σ_j B²(t − j): 151/315.
const MEAN_SQUARES: f64 = 151.0 / 315.0;

/// The cubic B-spline with knots at the whole numbers from −2 to 2.
fn bump(t: f64) -> f64 {
    let t = t.abs();
    match t {
        _ if t < 1.0 => 2.0 / 3.0 + t * t * (0.5 * t - 1.0),
        _ if t < 2.0 => (2.0 - t).powi(3) / 6.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bumps_add_up_to_one_and_their_squares_to_the_mean() {
        let (mut squares, points) = (0.0, 1000);
        for k in 0..points {
            let t = k as f64 / points as f64;
            let all: Vec<f64> = (-3..4).map(|j| bump(t - f64::from(j))).collect();
            assert!((all.iter().sum::<f64>() - 1.0).abs() < 1e-14, "{t}");
            let square = all.iter().map(|b| b * b).sum::<f64>();
            assert!((0.46..=0.5001).contains(&square), "{t}: {square}");
            squares += square / f64::from(points);
        }
        // a mean of 1000 points of a smooth periodic function
        assert!((squares - MEAN_SQUARES).abs() < 1e-10, "{squares}");
    }

    #[test]
    fn smoothing_leaves_what_its_transfer_function_lets_through() {
        let (n, top) = (200_000, 60.0);
        let du = top / f64::from(n);
        let let_through = |u: f64| 1.0 / (1.0 + u.powi(6)).powi(2);
        let sum: f64 = (0..n).map(|k| let_through((f64::from(k) + 0.5) * du) * du).sum();
        // beyond 60 the integrand is below 1e-21
        assert!((2.0 * sum - LEFT).abs() < 1e-8, "{sum}");
    }
}
