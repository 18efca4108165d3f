//! Rotations by a vector, and how they change with it.

use nalgebra::{Matrix3, Vector3};

/// exp(\[ρ\]×): the rotation about ρ by |ρ| rad (Rodrigues).
///
/// ```
/// use varda_rod::{Vector3, rotation};
///
/// let quarter = rotation::exponential(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
/// assert!((quarter * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// ```
pub fn exponential(rho: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (rho.norm(), rho.cross_matrix());
    let half = 0.5 * angle;
    let sinc = |x: f64| if x.abs() < 1e-4 { 1.0 - x * x / 6.0 } else { x.sin() / x };
    Matrix3::identity() + cross * sinc(angle) + cross * cross * (0.5 * sinc(half) * sinc(half))
}

/// J with δ(exp(\[ρ\]×) y) = (J δρ) × exp(\[ρ\]×) y:
///
/// ```text
/// J = I + (1 − cos θ)/θ² [ρ]× + (θ − sin θ)/θ³ [ρ]×²,   θ = |ρ|
/// ```
///
/// ```
/// use varda_rod::{Matrix3, Vector3, rotation};
///
/// assert_eq!(rotation::left_jacobian(&Vector3::zeros()), Matrix3::identity());
/// ```
pub fn left_jacobian(rho: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (rho.norm(), rho.cross_matrix());
    let (first, second) = if angle < 1e-2 {
        let square = angle * angle;
        (0.5 - square / 24.0 + square * square / 720.0, 1.0 / 6.0 - square / 120.0 + square * square / 5040.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    };
    Matrix3::identity() + cross * first + cross * cross * second
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_the_rotation_at_small_and_large_angles() {
        let y = Vector3::new(0.3, -0.7, 0.5);
        for size in [1e-6, 9e-3, 1.1e-2, 0.8, 3.0] {
            let (rho, drho) = (Vector3::new(0.6, 0.0, -0.8) * size, Vector3::new(0.2, 0.5, 0.1));
            let turned = |h: f64| exponential(&(rho + drho * h)) * y;
            let central = |h: f64| (turned(h) - turned(-h)) / (2.0 * h);
            let difference = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let tangent = (left_jacobian(&rho) * drho).cross(&turned(0.0));
            // h⁴ of differences, and rounding over h
            assert!((tangent - difference).norm() < 1e-12, "{size}: {}", (tangent - difference).norm());
        }
    }
}
