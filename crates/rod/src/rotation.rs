//! Rotations by a vector, and how they change with it.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

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
    let (first, second) = left_jacobian_factors(angle);
    Matrix3::identity() + cross * first + cross * cross * second
}

/// (1 − cos θ)/θ² and (θ − sin θ)/θ³.
fn left_jacobian_factors(angle: f64) -> (f64, f64) {
    if angle < 1e-2 {
        let square = angle * angle;
        (0.5 - square / 24.0 + square * square / 720.0, 1.0 / 6.0 - square / 120.0 + square * square / 5040.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    }
}

/// log R: the vector ρ, of at most π rad, with exp(\[ρ\]×) = R.
///
/// ```
/// use varda_rod::{Vector3, rotation};
///
/// let rho = Vector3::new(0.3, -2.0, 1.1);
/// assert!((rotation::logarithm(&rotation::exponential(&rho)) - rho).norm() < 1e-14);
/// ```
pub fn logarithm(rotation: &Matrix3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation)).scaled_axis()
}

/// J⁻¹ of [`left_jacobian`], for |ρ| below 2π:
///
/// ```text
/// J⁻¹ = I − ½ [ρ]× + (1 − (θ/2) cot(θ/2))/θ² [ρ]×²,   θ = |ρ|
/// ```
///
/// ```
/// use varda_rod::{Matrix3, Vector3, rotation};
///
/// let rho = Vector3::new(0.3, -2.0, 1.1);
/// let product = rotation::left_jacobian(&rho) * rotation::left_jacobian_inverse(&rho);
/// assert!((product - Matrix3::identity()).norm() < 1e-14);
/// ```
pub fn left_jacobian_inverse(rho: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (rho.norm(), rho.cross_matrix());
    let square = angle * angle;
    let factor = if angle < 1e-1 {
        1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30_240.0 + square / 1_209_600.0))
    } else {
        (1.0 - 0.5 * angle / (0.5 * angle).tan()) / square
    };
    Matrix3::identity() - cross * 0.5 + cross * cross * factor
}

/// ∂J/∂ρ ψ of [`left_jacobian`].
///
/// ```
/// use varda_rod::{Vector3, rotation};
///
/// // to first order J = I + ½ [ρ]×
/// let (zero, psi) = (Vector3::zeros(), Vector3::new(0.1, -0.2, 0.3));
/// let difference = rotation::left_jacobian_derivative(&zero, &psi) - psi.cross_matrix() * 0.5;
/// assert!(difference.norm() < 1e-16);
/// ```
pub fn left_jacobian_derivative(rho: &Vector3<f64>, psi: &Vector3<f64>) -> Matrix3<f64> {
    let (square, by) = (rho.norm_squared(), rho.dot(psi));
    let (first, second) = left_jacobian_factors(square.sqrt());
    // their derivatives by θ, over θ
    let (by_first, by_second) = if square < 1e-2 {
        let power = |i: i32| square.powi(i);
        (
            -1.0 / 12.0 + square / 180.0 - power(2) / 6720.0 + power(3) / 453_600.0,
            -1.0 / 60.0 + square / 1260.0 - power(2) / 60_480.0 + power(3) / 4_989_600.0,
        )
    } else {
        let angle = square.sqrt();
        let (sine, rest) = (angle.sin(), 1.0 - angle.cos());
        (
            (angle * sine - 2.0 * rest) / (square * square),
            (angle * rest - 3.0 * (angle - sine)) / (square * square * angle),
        )
    };
    let (r, p) = (rho.cross_matrix(), psi.cross_matrix());
    r * (by_first * by) + p * first + r * r * (by_second * by) + (p * r + r * p) * second
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_of_the_jacobian_is_that_of_differences() {
        for size in [1e-6, 9e-2, 1.1e-1, 0.8, 3.0] {
            let (rho, psi) = (Vector3::new(0.6, 0.0, -0.8) * size, Vector3::new(0.2, 0.5, 0.1));
            let central =
                |h: f64| (left_jacobian(&(rho + psi * h)) - left_jacobian(&(rho - psi * h))) / (2.0 * h);
            let difference = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let error = (left_jacobian_derivative(&rho, &psi) - difference).norm();
            // h⁴ of differences, and the rounding of J over h
            assert!(error < 1e-11, "{size}: {error}");
        }
    }

    #[test]
    fn the_jacobian_is_that_of_the_rotation_at_small_and_large_angles() {
        let y = Vector3::new(0.3, -0.7, 0.5);
        for size in [1e-6, 9e-3, 1.1e-2, 9e-2, 1.1e-1, 0.8, 3.0] {
            let (rho, drho) = (Vector3::new(0.6, 0.0, -0.8) * size, Vector3::new(0.2, 0.5, 0.1));
            let turned = |h: f64| exponential(&(rho + drho * h)) * y;
            let central = |h: f64| (turned(h) - turned(-h)) / (2.0 * h);
            let difference = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let tangent = (left_jacobian(&rho) * drho).cross(&turned(0.0));
            // h⁴ of differences, and rounding over h
            assert!((tangent - difference).norm() < 1e-12, "{size}: {}", (tangent - difference).norm());
            let inverse = left_jacobian_inverse(&rho) * left_jacobian(&rho);
            // roundings of numbers of 1
            assert!((inverse - Matrix3::identity()).norm() < 1e-14, "{size}: {inverse}");
        }
    }
}
