//! Rotations of a rigid body from markers on it.

use varda_rod::{Matrix3, UnitQuaternion, Vector3};

/// Markers of a rigid body, in axes of its own: the origin is their centroid.
pub(super) struct Body {
    pub(super) markers: Vec<Vector3<f64>>,
    /// RMS of what a coordinate is off the rigid body \[m\].
    pub(super) off: f64,
}

impl Body {
    /// The mean shape of frames that have every marker, each laid on the first: `None` where there is none.
    pub(super) fn of(frames: &[Vec<Option<Vector3<f64>>>]) -> Option<Body> {
        let whole: Vec<Vec<Vector3<f64>>> =
            frames.iter().filter_map(|seen| seen.iter().copied().collect()).collect();
        let mut markers = centred(whole.first()?);
        let mut off = 0.0;
        // The mean changes little once the frames lie on each other.
        for _ in 0..3 {
            let mut sum = vec![Vector3::zeros(); markers.len()];
            let mut squares = 0.0;
            for frame in &whole {
                let frame = centred(frame);
                let back = rotation(markers.iter().zip(&frame)).inverse();
                for ((sum, marker), seen) in sum.iter_mut().zip(&markers).zip(&frame) {
                    let seen = back * seen;
                    squares += (seen - marker).norm_squared();
                    *sum += seen / whole.len() as f64;
                }
            }
            off = (squares / (3 * whole.len() * markers.len()) as f64).sqrt();
            markers = centred(&sum);
        }
        Some(Body { markers, off })
    }

    /// Root of the mean squared distance from the centroid \[m\].
    pub(super) fn size(&self) -> f64 {
        (self.markers.iter().map(|m| m.norm_squared()).sum::<f64>() / self.markers.len() as f64).sqrt()
    }

    /// The second largest extent over the largest, by singular values: 0 for markers on a line.
    pub(super) fn breadth(&self) -> f64 {
        let spread: Matrix3<f64> = self.markers.iter().map(|m| m * m.transpose()).sum();
        let mut values = <[f64; 3]>::from(spread.symmetric_eigenvalues());
        values.sort_by(f64::total_cmp);
        (values[1].max(0.0) / values[2]).sqrt()
    }

    /// Where the body is: its rotation, and the place of its centroid. `None` with fewer than three markers.
    pub(super) fn pose(&self, seen: &[Option<Vector3<f64>>]) -> Option<(UnitQuaternion<f64>, Vector3<f64>)> {
        let pairs: Vec<_> =
            self.markers.iter().zip(seen).filter_map(|(own, seen)| Some((*own, (*seen)?))).collect();
        if pairs.len() < 3 {
            return None;
        }
        let mean = |of: fn(&(Vector3<f64>, Vector3<f64>)) -> Vector3<f64>| {
            pairs.iter().map(of).sum::<Vector3<f64>>() / pairs.len() as f64
        };
        let (own, place) = (mean(|p| p.0), mean(|p| p.1));
        let from: Vec<_> = pairs.iter().map(|p| (p.0 - own, p.1 - place)).collect();
        let rotation = rotation(from.iter().map(|(a, b)| (a, b)));
        Some((rotation, place - rotation * own))
    }

    /// σ of the rotation about an axis, averaged over axes, where a coordinate of a marker has the given σ:
    /// σ² tr(A⁻¹)/3 with A = Σ (|r|² I − r rᵀ).
    pub(super) fn sigma_angle(&self, sigma: f64) -> Option<f64> {
        let one = |r: &Vector3<f64>| Matrix3::identity() * r.norm_squared() - r * r.transpose();
        let inverse = self.markers.iter().map(one).sum::<Matrix3<f64>>().try_inverse()?;
        let angle = sigma * (inverse.trace() / 3.0).sqrt();
        (angle > 0.0 && angle.is_finite()).then_some(angle)
    }
}

fn centred(places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mean = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    places.iter().map(|p| p - mean).collect()
}

/// The rotation that brings vectors nearest to others, by the singular values of Σ b aᵀ (Kabsch 1976).
fn rotation<'a>(pairs: impl Iterator<Item = (&'a Vector3<f64>, &'a Vector3<f64>)>) -> UnitQuaternion<f64> {
    let covariance: Matrix3<f64> = pairs.map(|(a, b)| b * a.transpose()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return UnitQuaternion::identity() };
    let mirror = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    UnitQuaternion::from_matrix(&(u * Matrix3::from_diagonal(&mirror) * v_t))
}

/// The rotations of a direction that never spins about itself: each the smallest from the one before. The
/// first is none.
pub(super) fn without_spin(directions: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let mut all = vec![UnitQuaternion::identity(); directions.len().min(1)];
    for pair in directions.windows(2) {
        let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let step = UnitQuaternion::rotation_between(&pair[0], &pair[1]).unwrap_or_else(half_turn);
        all.push(step * all[all.len() - 1]);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape() -> Vec<Vector3<f64>> {
        [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.01, 0.04, 0.0], [0.02, 0.01, 0.03]].map(Vector3::from).to_vec()
    }

    #[test]
    fn a_moved_body_is_found_and_a_lost_marker_changes_nothing() {
        let turn = |k: f64| UnitQuaternion::new(Vector3::new(0.3 * k, -0.2 * k, 0.5));
        let shift = |k: f64| Vector3::new(k, 2.0 - k, 0.1 * k);
        let frames: Vec<Vec<Option<Vector3<f64>>>> = (0..8)
            .map(|k| shape().iter().map(|m| Some(turn(k.into()) * m + shift(k.into()))).collect())
            .collect();
        let body = Body::of(&frames).unwrap();
        assert!(body.off < 1e-15 && body.breadth() > 0.3, "{}", body.off);
        let (first, _) = body.pose(&frames[0]).unwrap();
        for (k, frame) in frames.iter().enumerate() {
            for lost in 0..=4 {
                let mut seen = frame.clone();
                if lost < 4 {
                    seen[lost] = None;
                }
                let (rotation, place) = body.pose(&seen).unwrap();
                let expected = turn(k as f64) * turn(0.0).inverse();
                assert!((rotation * first.inverse()).angle_to(&expected) < 1e-7);
                assert!((place + rotation * body.markers[1] - frame[1].unwrap()).norm() < 1e-14);
            }
        }
        let two = [frames[0][0], frames[0][1], None, None];
        assert!(body.pose(&two).is_none() && Body::of(&[two.to_vec()]).is_none());
        // Two markers 2 r apart about an axis across: σ/(√2 r).
        let dumbbell =
            Body { markers: vec![Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()], off: 0.0 };
        let expected = 1e-3 * ((0.5 + 0.5 + 0.25) / 3.0_f64).sqrt();
        assert!((dumbbell.sigma_angle(1e-3).unwrap() - expected).abs() < 1e-15);
    }

    #[test]
    fn a_direction_is_carried_without_spin() {
        let directions: Vec<_> = (0..50)
            .map(|k| Vector3::new((0.05 * f64::from(k)).cos(), (0.05 * f64::from(k)).sin(), 0.0))
            .collect();
        let turns = without_spin(&directions);
        let expected = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.05 * 49.0);
        assert!(turns[49].angle_to(&expected) < 1e-7);
    }
}
