//! Pinhole cameras with lens distortion: where a point in space is in an image, and derivatives of that.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::Error;

/// Why a point is in no image.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OutOfSight {
    /// It is behind the camera, or beside it.
    #[error("it is {depth:.4} m in front of the camera (negative: behind it)")]
    Behind {
        /// Its Z in the camera's axes \[m\].
        depth: f64,
    },
    /// Farther from the optical axis than the lens is described.
    #[error(
        "it is {tangent:.3} (tangent of the angle) off the optical axis, and the distortion grows with \
         that to {widest:.3} only: the point is far outside the image, or k1, k2, k3 are not of this lens"
    )]
    BeyondTheLens {
        /// √(X² + Y²)/Z.
        tangent: f64,
        /// The largest that distortion keeps in order.
        widest: f64,
    },
    /// Its place is not finite.
    #[error("its place is not finite")]
    NonFinite,
}

/// The largest tangent of the angle off the optical axis that is an image: 89.94°.
const WIDEST: f64 = 1e3;

/// A calibrated camera: a point p in space is seen at pixel (u, v),
///
/// ```text
/// (X, Y, Z) = R (p − c)                     x right, y down, z forward
/// x = X/Z,   y = Y/Z,   q = x² + y²,   D = 1 + k₁ q + k₂ q² + k₃ q³
/// u = c_x + f_x (x D + 2 p₁ x y + p₂ (q + 2 x²))
/// v = c_y + f_y (y D + p₁ (q + 2 y²) + 2 p₂ x y)
/// ```
///
/// (Brown 1971, in the form and order k₁, k₂, p₁, p₂, k₃ of OpenCV). R has the camera's axes for
/// rows, c is its centre: of OpenCV's `rvec`, `tvec` R = Rodrigues(rvec) and c = −Rᵀ tvec.
///
/// # Examples
///
/// ```
/// use varda_rod::{Camera, Matrix3, Vector3};
///
/// // At the origin, looking along the model's y, with z upwards in the image.
/// let rotation = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
/// let camera = Camera::new([800.0, 800.0], [320.0, 240.0])?.posed(Vector3::zeros(), rotation)?;
/// let seen = camera.project(&Vector3::new(0.1, 2.0, 0.2))?;
/// assert_eq!(seen, [360.0, 160.0]);
/// assert!(camera.project(&Vector3::new(0.1, -2.0, 0.2)).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    focal: Vector2<f64>,
    center: Vector2<f64>,
    /// k₁, k₂, k₃ and p₁, p₂.
    radial: [f64; 3],
    tangential: [f64; 2],
    position: Vector3<f64>,
    rotation: Matrix3<f64>,
    /// The largest q at which q D² still grows.
    widest: f64,
}

/// A point in the camera's axes, and in those of the image before distortion.
struct Seen {
    x: f64,
    y: f64,
    depth: f64,
}

impl Camera {
    /// Without distortion, at the origin, with the model's axes: f and c in pixels.
    ///
    /// # Errors
    /// [`Error::Value`] for a focal length that is not above 0, [`Error::NonFinite`] for a principal point
    /// that is not finite.
    pub fn new(focal: [f64; 2], principal_point: [f64; 2]) -> Result<Camera, Error> {
        if let Some(value) = focal.into_iter().find(|f| !(*f > 0.0 && f.is_finite())) {
            return Err(Error::Value {
                field: "focal length of the camera [px]",
                value,
                expected: "above 0, finite",
            });
        }
        finite("the principal point of the camera, component", &principal_point)?;
        Ok(Camera {
            focal: focal.into(),
            center: principal_point.into(),
            radial: [0.0; 3],
            tangential: [0.0; 2],
            position: Vector3::zeros(),
            rotation: Matrix3::identity(),
            widest: WIDEST * WIDEST,
        })
    }

    /// With distortion (k₁, k₂, p₁, p₂, k₃), OpenCV's order.
    ///
    /// # Errors
    /// [`Error::NonFinite`].
    pub fn distorted(self, [k1, k2, p1, p2, k3]: [f64; 5]) -> Result<Camera, Error> {
        finite("distortion coefficient", &[k1, k2, p1, p2, k3])?;
        let widest = monotone_to([k1, k2, k3]).min(WIDEST * WIDEST);
        Ok(Camera { radial: [k1, k2, k3], tangential: [p1, p2], widest, ..self })
    }

    /// At a place, with its axes (right, down, forward) for the rows of a matrix. Of a matrix that is a
    /// rotation to some digits the nearest rotation is taken.
    ///
    /// # Errors
    /// [`Error::Value`] where it is none to 1e-3, [`Error::NonFinite`] for a place that is not finite.
    pub fn posed(self, position: Vector3<f64>, rotation: Matrix3<f64>) -> Result<Camera, Error> {
        finite("the place of the camera, component", position.as_slice())?;
        let skew = (rotation.tr_mul(&rotation) - Matrix3::identity()).abs().max();
        if !(skew <= 1e-3 && rotation.determinant() > 0.0) {
            return Err(Error::Value {
                field: "rotation of the camera",
                value: skew,
                expected: "a rotation: RᵀR = I, det R > 0",
            });
        }
        // Newton's iteration for the polar factor: 1e-3 becomes 1e-6, 1e-12 and rounding
        let nearest = (0..3).try_fold(rotation, |r, _| Some((r + r.try_inverse()?.transpose()) * 0.5));
        Ok(Camera { position, rotation: nearest.unwrap_or(rotation), ..self })
    }

    /// Its centre \[m\].
    pub fn position(&self) -> Vector3<f64> {
        self.position
    }

    /// Its axes (right, down, forward), by rows.
    pub fn rotation(&self) -> Matrix3<f64> {
        self.rotation
    }

    /// The same camera with its centre elsewhere by d \[m\].
    #[must_use]
    pub fn moved(self, d: Vector3<f64>) -> Camera {
        Camera { position: self.position + d, ..self }
    }

    /// The pixel at which a point is seen.
    ///
    /// # Errors
    /// [`OutOfSight`]: behind the camera, or where the distortion does not grow any more.
    pub fn project(&self, p: &Vector3<f64>) -> Result<[f64; 2], OutOfSight> {
        let Seen { x, y, .. } = self.seen(p)?;
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let q = x * x + y * y;
        let d = 1.0 + q * (k1 + q * (k2 + q * k3));
        let distorted = Vector2::new(
            x * d + 2.0 * p1 * x * y + p2 * (q + 2.0 * x * x),
            y * d + p1 * (q + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        Ok((self.center + self.focal.component_mul(&distorted)).into())
    }

    /// ∂(u, v)/∂p, by rows \[px/m\].
    ///
    /// # Errors
    /// As [`project`](Self::project).
    pub fn jacobian(&self, p: &Vector3<f64>) -> Result<[Vector3<f64>; 2], OutOfSight> {
        let seen = self.seen(p)?;
        let lens = self.lens(&seen);
        let row = |i: usize| {
            let (a, b) = (self.focal[i] * lens[(i, 0)], self.focal[i] * lens[(i, 1)]);
            self.rotation.tr_mul(&seen.perspective_transpose(a, b))
        };
        Ok([row(0), row(1)])
    }

    /// (a_u ∂²u/∂p² + a_v ∂²v/∂p²) dp.
    ///
    /// # Errors
    /// As [`project`](Self::project).
    pub fn second(
        &self,
        p: &Vector3<f64>,
        dp: &Vector3<f64>,
        a: [f64; 2],
    ) -> Result<Vector3<f64>, OutOfSight> {
        let seen = self.seen(p)?;
        let w = Vector2::from(a).component_mul(&self.focal);
        let by = self.rotation * dp;
        let d = Vector2::new(by.x - seen.x * by.z, by.y - seen.y * by.z) / seen.depth;
        // what acts on (x, y), and its change as the lens is passed elsewhere
        let acting = self.lens(&seen).tr_mul(&w);
        let change = self.lens_second(&seen, &w) * d;
        let change = change - acting * (by.z / seen.depth);
        let mut force = seen.perspective_transpose(change.x, change.y);
        force.z -= acting.dot(&d) / seen.depth;
        Ok(self.rotation.tr_mul(&force))
    }

    fn seen(&self, p: &Vector3<f64>) -> Result<Seen, OutOfSight> {
        let at = self.rotation * (p - self.position);
        if !at.iter().all(|c| c.is_finite()) {
            return Err(OutOfSight::NonFinite);
        }
        if !(at.z > 0.0) {
            return Err(OutOfSight::Behind { depth: at.z });
        }
        let seen = Seen { x: at.x / at.z, y: at.y / at.z, depth: at.z };
        let q = seen.x * seen.x + seen.y * seen.y;
        if !(q < self.widest) {
            return Err(OutOfSight::BeyondTheLens { tangent: q.sqrt(), widest: self.widest.sqrt() });
        }
        Ok(seen)
    }

    /// The derivative of what the lens does to (x, y).
    fn lens(&self, &Seen { x, y, .. }: &Seen) -> Matrix2<f64> {
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let q = x * x + y * y;
        let d = 1.0 + q * (k1 + q * (k2 + q * k3));
        let d1 = k1 + q * (2.0 * k2 + 3.0 * k3 * q);
        let mixed = 2.0 * (x * y * d1 + p1 * x + p2 * y);
        Matrix2::new(
            d + 2.0 * (x * x * d1 + p1 * y + 3.0 * p2 * x),
            mixed,
            mixed,
            d + 2.0 * (y * y * d1 + 3.0 * p1 * y + p2 * x),
        )
    }

    /// Σ w_i times the second derivative of its component i.
    fn lens_second(&self, &Seen { x, y, .. }: &Seen, w: &Vector2<f64>) -> Matrix2<f64> {
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let q = x * x + y * y;
        let d1 = k1 + q * (2.0 * k2 + 3.0 * k3 * q);
        let d2 = 2.0 * k2 + 6.0 * k3 * q;
        // ∂²/∂x² of the first, ∂²/∂x∂y of the first and ∂²/∂x² of the second, and so on
        let xxx = 6.0 * x * d1 + 4.0 * x.powi(3) * d2 + 6.0 * p2;
        let xxy = 2.0 * y * d1 + 4.0 * x * x * y * d2 + 2.0 * p1;
        let xyy = 2.0 * x * d1 + 4.0 * x * y * y * d2 + 2.0 * p2;
        let yyy = 6.0 * y * d1 + 4.0 * y.powi(3) * d2 + 6.0 * p1;
        Matrix2::new(xxx, xxy, xxy, xyy) * w.x + Matrix2::new(xxy, xyy, xyy, yyy) * w.y
    }
}

impl Seen {
    /// The transpose of ∂(x, y)/∂(X, Y, Z) times (a, b).
    fn perspective_transpose(&self, a: f64, b: f64) -> Vector3<f64> {
        Vector3::new(a, b, -(self.x * a + self.y * b)) / self.depth
    }
}

fn finite(what: &'static str, values: &[f64]) -> Result<(), Error> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(Error::NonFinite { what, index }),
        None => Ok(()),
    }
}

/// The largest q up to which r D(r²) grows with r = √q: the first positive zero of its derivative,
///
/// ```text
/// g(q) = 1 + 3 k₁ q + 5 k₂ q² + 7 k₃ q³
/// ```
///
/// found between the extrema of g; infinity where there is none.
fn monotone_to([k1, k2, k3]: [f64; 3]) -> f64 {
    let g = |q: f64| 1.0 + q * (3.0 * k1 + q * (5.0 * k2 + q * 7.0 * k3));
    // g' = 3 k₁ + 10 k₂ q + 21 k₃ q²
    let (a, b, c) = (21.0 * k3, 10.0 * k2, 3.0 * k1);
    let mut ends = vec![WIDEST * WIDEST];
    let root = (b * b - 4.0 * a * c).sqrt();
    if root.is_finite() {
        // without cancellation, a = 0 included
        let s = -0.5 * (b + root.copysign(b));
        ends.extend([s / a, c / s].into_iter().filter(|q| *q > 0.0 && *q < WIDEST * WIDEST));
    }
    ends.sort_by(f64::total_cmp);
    let mut from = 0.0;
    for to in ends {
        if !(g(to) > 0.0) {
            let (mut low, mut high) = (from, to);
            // halved until neighbours: 64 bits at most from 1e6 down to its ulp
            for _ in 0..100 {
                let middle = 0.5 * (low + high);
                *(if g(middle) > 0.0 { &mut low } else { &mut high }) = middle;
            }
            return low;
        }
        from = to;
    }
    f64::INFINITY
}
