//! Rotations that a sensor read over time, and how far a rod is turned from them.

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use crate::rotation::{left_jacobian_derivative, left_jacobian_inverse, logarithm};

/// Rotations Q that a sensor read at times \[s\], from the axes of its body to those of the model; of a
/// sensor of directions any whose third axis is that which it read.
///
/// ```
/// use varda_rod::{ReadRotations, UnitQuaternion, Vector3};
///
/// let about = |angle: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
/// let read = ReadRotations::new(vec![(0.0, about(0.1)), (1.0, about(0.2))]);
/// assert_eq!(read.nearest(0.6), about(0.2));
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReadRotations(Vec<(f64, UnitQuaternion<f64>)>);

impl ReadRotations {
    /// Of these, in any order.
    pub fn new(mut rows: Vec<(f64, UnitQuaternion<f64>)>) -> ReadRotations {
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        ReadRotations(rows)
    }

    /// The one that is nearest in time; the axes of the model where there is none.
    pub fn nearest(&self, t: f64) -> UnitQuaternion<f64> {
        let after = self.0.partition_point(|(time, _)| *time < t);
        let near = self.0[..after].last().into_iter().chain(self.0.get(after));
        let nearest = near.min_by(|a, b| (a.0 - t).abs().total_cmp(&(b.0 - t).abs()));
        nearest.map_or_else(UnitQuaternion::identity, |(_, q)| *q)
    }

    pub(crate) fn matrix(&self, t: f64) -> Matrix3<f64> {
        self.nearest(t).to_rotation_matrix().into_inner()
    }
}

/// ρ = log(Qᵀ S Cᵀ), by which a body is turned from its orientation Q that was read, along its own axes:
/// the rows of C along those of its section, the columns of S.
pub(crate) fn turn(read: &Matrix3<f64>, section: &Matrix3<f64>, axes: &Matrix3<f64>) -> Vector3<f64> {
    logarithm(&(read.tr_mul(section) * axes.transpose()))
}

/// The rows of ∂ρ/∂w as columns, w a small rotation of the section along its axes:
/// δρ = J(−ρ)⁻¹ C w.
pub(crate) fn turn_by_section(turn: &Vector3<f64>, axes: &Matrix3<f64>) -> Matrix3<f64> {
    // J(−ρ) = J(ρ)ᵀ
    axes.transpose() * left_jacobian_inverse(turn)
}

/// How Σ dy_i ∂ρ_i/∂w changes as the section turns by w: with δρ = J(−ρ)⁻¹ C w,
///
/// ```text
/// δ(Cᵀ J⁻¹ dy) = −Cᵀ J⁻¹ δJ J⁻¹ dy
/// ```
pub(crate) fn turn_second(
    turn: &Vector3<f64>,
    axes: &Matrix3<f64>,
    dy: &Vector3<f64>,
    w: &Vector3<f64>,
) -> Vector3<f64> {
    let by_section = turn_by_section(turn, axes);
    let change = left_jacobian_derivative(turn, &by_section.tr_mul(w));
    -(by_section * (change * (left_jacobian_inverse(turn) * dy)))
}

/// By what angles \[rad\] a tangent is turned from the third axis of Q that was read, towards its first
/// and second: θ (t₁, t₂)/sin θ with t₁, t₂, cos θ along the axes of Q. Opposite to it every way
/// is as near, and one is taken.
///
/// ```
/// use varda_rod::{Matrix3, Vector3, tilt};
///
/// let tilted = tilt(&Matrix3::identity(), &Vector3::new(0.2_f64.sin(), 0.0, 0.2_f64.cos()));
/// assert!((tilted.x - 0.2).abs() < 1e-15 && tilted.y == 0.0);
/// ```
pub fn tilt(read: &Matrix3<f64>, tangent: &Vector3<f64>) -> Vector2<f64> {
    let t = read.tr_mul(tangent);
    if t.z < 0.0 && t.xy() == Vector2::zeros() {
        return Vector2::new(std::f64::consts::PI, 0.0);
    }
    t.xy() * tilt_factors(&t)[0]
}

/// The rows of its derivative by the tangent as columns.
pub(crate) fn tilt_by_tangent(read: &Matrix3<f64>, tangent: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let t = read.tr_mul(tangent);
    let [factor, slope] = tilt_factors(&t);
    [0, 1].map(|i| read * (Vector3::ith(i, factor) + Vector3::z() * (slope * t[i])))
}

/// The change of Σ dy_i ∂y_i/∂t as the tangent moves by δt.
pub(crate) fn tilt_second(
    read: &Matrix3<f64>,
    tangent: &Vector3<f64>,
    dy: &Vector2<f64>,
    moved: &Vector3<f64>,
) -> Vector3<f64> {
    let (t, d) = (read.tr_mul(tangent), read.tr_mul(moved));
    let factors = tilt_factors(&t);
    let slope = factors[1];
    let along = slope * dy.dot(&d.xy()) + tilt_curvature(&t, factors) * dy.dot(&t.xy()) * d.z;
    read * Vector3::new(slope * dy.x * d.z, slope * dy.y * d.z, along)
}

/// d²f/d(cos θ)² of f = θ/sin θ, these two being f and its slope: (f + 3 cos θ df/d(cos θ))/sin² θ.
fn tilt_curvature(t: &Vector3<f64>, [factor, slope]: [f64; 2]) -> f64 {
    let square = t.xy().norm_squared();
    if t.z > 0.0 && square < 0.1 {
        // of F(s²) = arcsin s/s = Σ a_k s²ᵏ, s = sin θ, it is 4 cos² θ F'' − 2 F', and a₁ = 1/6,
        // a_{k+1}/a_k = (2k + 1)²/((2k + 2) (2k + 3))
        let (mut first, mut second, mut power, mut a) = (0.0, 0.0, 1.0, 1.0 / 6.0);
        for k in (1..17).map(f64::from) {
            first += k * a * power;
            a *= (2.0 * k + 1.0).powi(2) / ((2.0 * k + 2.0) * (2.0 * k + 3.0));
            second += k * (k + 1.0) * a * power;
            power *= square;
        }
        return 4.0 * t.z * t.z * second - 2.0 * first;
    }
    (factor + 3.0 * t.z * slope) / square.max(1e-24)
}

/// f = θ/sin θ and df/d(cos θ) = (f cos θ − 1)/sin² θ; without bound as θ approaches π, and that
/// of a picoradian beside it there.
fn tilt_factors(t: &Vector3<f64>) -> [f64; 2] {
    let sine = t.xy().norm();
    if t.z > 0.0 && sine < 1e-2 {
        // f = 1 + s²/6 + 3s⁴/40 + …, and the slope is −df/ds · cos θ/s
        let square = sine * sine;
        let factor = 1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * 5.0 / 112.0));
        let slope = 1.0 / 3.0 + square * (3.0 / 10.0 + square * (15.0 / 56.0 + square * 35.0 / 144.0));
        return [factor, -slope * t.z];
    }
    let sine = sine.max(1e-12);
    let factor = sine.atan2(t.z) / sine;
    [factor, (factor * t.z - 1.0) / (sine * sine)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotation::exponential;

    const AXES: [Vector3<f64>; 3] =
        [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)];
    const DY: Vector3<f64> = Vector3::new(0.4, -1.1, 0.7);

    /// The derivative along a direction by Richardson's differences of f(h).
    fn derivative<const N: usize>(f: impl Fn(f64) -> nalgebra::SVector<f64, N>) -> nalgebra::SVector<f64, N> {
        let central = |h: f64| (f(h) - f(-h)) / (2.0 * h);
        (central(1e-3) * 4.0 - central(2e-3)) / 3.0
    }

    #[test]
    fn a_turn_and_its_derivative_at_small_and_large_angles() {
        let read = exponential(&Vector3::new(0.3, -1.0, 0.4));
        let axes = exponential(&Vector3::new(-0.8, 0.2, 0.5));
        for size in [0.0, 1e-6, 9e-3, 1.1e-2, 0.8, 2.0, 3.1] {
            let rho = Vector3::new(0.6, 0.48, -0.64) * size;
            let section = read * exponential(&rho) * axes;
            let found = turn(&read, &section, &axes);
            // rounding of a rotation near π, where the axis is a difference of its numbers
            assert!((found - rho).norm() < 1e-13, "{size}: {found}");
            let rows = turn_by_section(&found, &axes);
            for w in AXES {
                let by_difference = derivative(|h| turn(&read, &(section * exponential(&(w * h))), &axes));
                // h⁴ of differences over (π − θ)
                let error = (rows.tr_mul(&w) - by_difference).norm();
                assert!(error < 1e-9, "{size}: {error:e}");
                let (second, dy) = (turn_second(&found, &axes, &DY, &w), DY);
                let rows = |h: f64| {
                    turn_by_section(&turn(&read, &(section * exponential(&(w * h))), &axes), &axes) * dy
                };
                // the same
                let error = (second - derivative(rows)).norm();
                assert!(error < 1e-9, "{size}: second derivatives off by {error:e}");
            }
        }
    }

    #[test]
    fn a_tilt_and_its_derivative_at_small_and_large_angles() {
        let read = exponential(&Vector3::new(0.3, -1.0, 0.4));
        for size in [0.0, 1e-6, 9e-3, 1.1e-2, 0.3, 0.34, 0.8, 2.0, 3.1] {
            let tangent = read * exponential(&(Vector3::new(-0.6, 0.8, 0.0) * size)) * Vector3::z();
            let found = tilt(&read, &tangent);
            // about (−0.6, 0.8) the third axis turns towards (0.8, 0.6); rounding of sin θ near π
            assert!((found - Vector2::new(0.8, 0.6) * size).norm() < 1e-13, "{size}: {found}");
            let rows = tilt_by_tangent(&read, &tangent);
            for w in AXES {
                let by_difference = derivative(|h| tilt(&read, &(exponential(&(w * h)) * tangent)));
                let change = w.cross(&tangent);
                let error = (Vector2::from(rows.map(|row| row.dot(&change))) - by_difference).norm();
                // h⁴ of differences over (π − θ)⁵, 1e7
                assert!(error < if size > 3.0 { 1e-4 } else { 1e-10 }, "{size}: {error:e}");
                let second = tilt_second(&read, &tangent, &DY.xy(), &change);
                let by_difference = derivative(|h| {
                    let [a, b] = tilt_by_tangent(&read, &(exponential(&(w * h)) * tangent));
                    a * DY.x + b * DY.y
                });
                // and over (π − θ)⁷; a 1e-16 of the first derivatives in h, of numbers of 1e2 at 2 rad
                let bound = if size > 3.0 { 1e-3 * second.norm().max(1.0) } else { 1e-9 };
                let error = (second - by_difference).norm();
                assert!(error < bound, "{size}: second derivatives off by {error:e}");
            }
        }
        assert_eq!(tilt(&Matrix3::identity(), &-Vector3::z()), Vector2::new(std::f64::consts::PI, 0.0));
        let opposite = tilt_by_tangent(&Matrix3::identity(), &-Vector3::z());
        assert!(opposite.iter().all(|row| row.iter().all(|v| v.is_finite())), "{opposite:?}");
    }

    #[test]
    fn the_nearest_reading_is_taken() {
        let about = |angle| UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
        let read = ReadRotations::new(vec![(2.0, about(0.2)), (1.0, about(0.1))]);
        for (t, angle) in [(0.0, 0.1), (1.0, 0.1), (1.4, 0.1), (1.6, 0.2), (2.0, 0.2), (9.0, 0.2)] {
            assert!((read.nearest(t).scaled_axis().z - angle).abs() < 1e-15, "{t}");
        }
        assert_eq!(ReadRotations::default().matrix(1.0), Matrix3::identity());
    }
}
