//! Views of points: as places in space, or as pixels of cameras.

use nalgebra::{Matrix3, Vector3};
use varda_implicit::{At, ObservationOperator, Refusal};

use crate::Error;
use crate::camera::{Camera, OutOfSight};
use crate::rotation::{exponential, left_jacobian, left_jacobian_derivative};

/// How a point is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// Its three coordinates \[m\].
    Place {
        /// The point.
        point: usize,
    },
    /// The pixel (u, v) of a camera.
    Pixels {
        /// The camera.
        camera: usize,
        /// The point.
        point: usize,
    },
}

impl View {
    /// Number of its values.
    pub fn rows(&self) -> usize {
        match self {
            View::Place { .. } => 3,
            View::Pixels { .. } => 2,
        }
    }

    /// The point.
    pub fn point(&self) -> usize {
        match *self {
            View::Place { point } | View::Pixels { point, .. } => point,
        }
    }
}

/// A point that should have been seen and is in no image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name} cannot be seen at t = {time} s: {why}")]
pub struct NotSeen {
    /// The name of the view.
    pub name: String,
    /// Time of the model \[s\].
    pub time: f64,
    /// The reason.
    pub why: OutOfSight,
}

/// H = (π_1(p), π_2(p), …): views of points p = P(t, x), which another operator gives, three rows a point
/// (as [`Markers`](crate::Markers) does), with tangent, adjoint and second derivatives.
///
/// ```text
/// dy = π' P' dx,   dx += P'ᵀ π'ᵀ dy,   out += (π'ᵀ dy)·P'' dx + P'ᵀ (dy·π'') P' dx
/// ```
///
/// The pose of a camera may be part of the state ([`with_poses`](Self::with_poses)).
///
/// A point that a camera cannot have in its image ([`OutOfSight`]) is an error where it must be seen, and
/// elsewhere a zero without derivatives.
///
/// # Examples
///
/// ```
/// use varda_implicit::{At, ObservationOperator, Refusal};
/// use varda_rod::{Camera, View, Views};
///
/// /// One point, which is the state.
/// struct Point;
///
/// impl ObservationOperator for Point {
///     fn dim(&self) -> usize {
///         3
///     }
///     fn state_dim(&self) -> usize {
///         3
///     }
///     fn observe(&mut self, _: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
///         y.copy_from_slice(x);
///         Ok(())
///     }
///     fn tangent(&mut self, _: At, _: &[f64], dx: &[f64], dy: &mut [f64]) {
///         dy.copy_from_slice(dx);
///     }
///     fn adjoint_add(&mut self, _: At, _: &[f64], dy: &[f64], dx: &mut [f64]) {
///         dx.iter_mut().zip(dy).for_each(|(dx, dy)| *dx += dy);
///     }
/// }
///
/// let cameras = vec![Camera::new([500.0, 500.0], [320.0, 240.0])?];
/// let view = ("tip in the camera".to_string(), View::Pixels { camera: 0, point: 0 });
/// let mut views = Views::new(Box::new(Point), cameras, vec![view])?;
/// let mut y = [0.0; 2];
/// views.observe(At { step: 0, time: 0.0 }, &[0.1, 0.2, 1.0], &mut y)?;
/// assert_eq!(y, [370.0, 340.0]);
/// let behind = views.observe(At { step: 0, time: 0.0 }, &[0.1, 0.2, -1.0], &mut y).unwrap_err();
/// assert!(behind.to_string().starts_with("tip in the camera cannot be seen at t = 0 s"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Views {
    points: Box<dyn ObservationOperator>,
    cameras: Vec<Camera>,
    views: Vec<(String, View)>,
    /// Where in the state the rotation and the displacement of each camera are.
    poses: Vec<[Option<usize>; 2]>,
    must_be_seen: MustBeSeen,
    rows: usize,
    /// Places of the points, their increments, and what acts on them.
    places: Vec<f64>,
    moved: Vec<f64>,
    acting: Vec<f64>,
}

/// Whether a view, by its index, is needed there.
type MustBeSeen = Box<dyn Fn(At, usize) -> bool>;

impl Views {
    /// Views of the points of an operator, with names for errors; everything must be seen at all times.
    ///
    /// # Errors
    /// [`Error::Value`] for a camera or a point that is not there.
    pub fn new(
        points: Box<dyn ObservationOperator>,
        cameras: Vec<Camera>,
        views: Vec<(String, View)>,
    ) -> Result<Views, Error> {
        let dim = points.dim();
        for (_, view) in &views {
            let there = |field, index: usize, count: usize| match index < count {
                true => Ok(()),
                false => Err(Error::Value { field, value: index as f64, expected: "one that is there" }),
            };
            there("point of a view", view.point(), dim / 3)?;
            if let View::Pixels { camera, .. } = view {
                there("camera of a view", *camera, cameras.len())?;
            }
        }
        let rows = views.iter().map(|(_, view)| view.rows()).sum();
        let (places, moved, acting) = (vec![0.0; dim], vec![0.0; dim], vec![0.0; dim]);
        let poses = vec![[None; 2]; cameras.len()];
        let must_be_seen: MustBeSeen = Box::new(|_, _| true);
        Ok(Views { points, cameras, views, poses, must_be_seen, rows, places, moved, acting })
    }

    /// Cameras whose pose is in the state: where there are the three numbers of a rotation ρ \[rad\] of each
    /// camera about its own axes (right, down, forward), and of a displacement δ of its centre \[m\].
    ///
    /// ```text
    /// (X, Y, Z) = exp(−[ρ]×) R (p − c − δ)
    /// ```
    ///
    /// # Errors
    /// [`Error::Count`] where there is not one for every camera, [`Error::Value`] for numbers that are not in
    /// the state.
    pub fn with_poses(self, poses: Vec<[Option<usize>; 2]>) -> Result<Views, Error> {
        let (found, expected, dim) = (poses.len(), self.cameras.len(), self.points.state_dim());
        if found != expected {
            return Err(Error::Count { field: "poses of cameras", found, expected });
        }
        if let Some(first) = poses.iter().flatten().flatten().find(|first| **first + 3 > dim) {
            let expected = "three numbers of the state";
            return Err(Error::Value { field: "pose of a camera", value: *first as f64, expected });
        }
        Ok(Views { poses, ..self })
    }

    /// Only where this says so, by step and time and the index of the view, must a point be seen.
    #[must_use]
    pub fn seen_where(self, must_be_seen: impl Fn(At, usize) -> bool + 'static) -> Views {
        Views { must_be_seen: Box::new(must_be_seen), ..self }
    }

    fn locate(&mut self, at: At, x: &[f64]) {
        self.points.observe(at, x, &mut self.places).expect("this state was observed before");
    }

    /// Index, first row and view of all.
    fn each(&self) -> impl Iterator<Item = (usize, View)> + '_ {
        self.views.iter().scan(0, |row, (_, view)| {
            let first = *row;
            *row += view.rows();
            Some((first, *view))
        })
    }

    /// A point as a camera with its pose in a state has it.
    fn posed(&self, camera: usize, x: &[f64], point: usize) -> Posed {
        let p = place(&self.places, point);
        let [rotation, displacement] = self.poses[camera];
        if rotation.is_none() && displacement.is_none() {
            let (zero, turn, by_rotation) = (Vector3::zeros(), Matrix3::identity(), Matrix3::zeros());
            return Posed { point: p, about: zero, arm: zero, turn, by_rotation };
        }
        let camera = &self.cameras[camera];
        // Rᵀ exp(−[ρ]×) R = exp(−[Rᵀ ρ]×)
        let about = -(camera.rotation().tr_mul(&three(x, rotation)));
        let turn = exponential(&about);
        let arm = turn * (p - camera.position() - three(x, displacement));
        let by_rotation = arm.cross_matrix() * left_jacobian(&about) * camera.rotation().transpose();
        Posed { point: camera.position() + arm, about, arm, turn, by_rotation }
    }

    /// `acting` = π'ᵀ dy on the places, at `places`; adds what it is on poses, where these are asked for.
    fn act(&mut self, x: &[f64], dy: &[f64], mut dx: Option<&mut [f64]>) {
        let mut acting = std::mem::take(&mut self.acting);
        acting.fill(0.0);
        for (row, view) in self.each() {
            let into = &mut acting[3 * view.point()..][..3];
            match view {
                View::Place { .. } => into.iter_mut().zip(&dy[row..]).for_each(|(a, dy)| *a += dy),
                View::Pixels { camera, point } => {
                    let posed = self.posed(camera, x, point);
                    let Ok(j) = self.cameras[camera].jacobian(&posed.point) else { continue };
                    let force = j[0] * dy[row] + j[1] * dy[row + 1];
                    let on_place = posed.turn.tr_mul(&force);
                    let on_pose = [posed.by_rotation.tr_mul(&force), -on_place];
                    if let Some(dx) = dx.as_deref_mut() {
                        self.on_pose_add(camera, on_pose, dx);
                    }
                    add(into, &on_place);
                }
            }
        }
        self.acting = acting;
    }

    /// Adds what acts on the rotation and the displacement of a camera.
    fn on_pose_add(&self, camera: usize, on_pose: [Vector3<f64>; 2], dx: &mut [f64]) {
        for (first, on) in self.poses[camera].into_iter().zip(on_pose) {
            let Some(first) = first else { continue };
            add(&mut dx[first..first + 3], &on);
        }
    }

    /// δp* and δρ, in the model's axes and with its sign, of an increment of a point and of the state.
    fn moved(&self, posed: &Posed, camera: usize, d: Vector3<f64>, dx: &[f64]) -> [Vector3<f64>; 2] {
        let [rotation, displacement] = self.poses[camera].map(|first| three(dx, first));
        let about = -(self.cameras[camera].rotation().tr_mul(&rotation));
        [posed.turn * (d - displacement) + posed.by_rotation * rotation, about]
    }
}

impl ObservationOperator for Views {
    fn dim(&self) -> usize {
        self.rows
    }

    fn state_dim(&self) -> usize {
        self.points.state_dim()
    }

    /// # Errors
    /// [`NotSeen`] for a point that must be seen and is not; those of the points' operator.
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        assert_eq!(y.len(), self.rows, "a number for every row");
        self.points.observe(at, x, &mut self.places)?;
        let mut row = 0;
        for (i, (name, view)) in self.views.iter().enumerate() {
            let out = &mut y[row..row + view.rows()];
            row += view.rows();
            match *view {
                View::Place { point } => out.copy_from_slice(&self.places[3 * point..][..3]),
                View::Pixels { camera, point } => {
                    match self.cameras[camera].project(&self.posed(camera, x, point).point) {
                        Ok(seen) => out.copy_from_slice(&seen),
                        Err(why) if (self.must_be_seen)(at, i) => {
                            let not_seen = NotSeen { name: name.clone(), time: at.time, why };
                            return Err(not_seen.into());
                        }
                        Err(_) => out.fill(0.0),
                    }
                }
            }
        }
        Ok(())
    }

    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.locate(at, x);
        self.points.tangent(at, x, dx, &mut self.moved);
        for (row, view) in self.each() {
            let d = place(&self.moved, view.point());
            let out = &mut dy[row..row + view.rows()];
            match view {
                View::Place { .. } => out.copy_from_slice(d.as_slice()),
                View::Pixels { camera, point } => {
                    let posed = self.posed(camera, x, point);
                    let [d, _] = self.moved(&posed, camera, d, dx);
                    match self.cameras[camera].jacobian(&posed.point) {
                        Ok(j) => out.copy_from_slice(&[j[0].dot(&d), j[1].dot(&d)]),
                        Err(_) => out.fill(0.0),
                    }
                }
            }
        }
    }

    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.locate(at, x);
        self.act(x, dy, Some(dx));
        self.points.adjoint_add(at, x, &self.acting, dx);
    }

    fn has_second_derivatives(&self) -> bool {
        self.points.has_second_derivatives()
    }

    /// With f = π'ᵀ dy on p*, a = −Rᵀ ρ, E = exp(\[a\]×), r = E (p − c − δ) and b = J δa:
    ///
    /// ```text
    /// δf = (dy·π'') δp*
    /// p, −δ: Eᵀ (δf + f × b)
    /// ρ:     R (δJᵀ (f × r) + Jᵀ (δf × r + f × δp*))
    /// ```
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.locate(at, x);
        self.act(x, dy, None);
        self.points.second_adjoint_add(at, x, dx, &self.acting, out);
        self.points.tangent(at, x, dx, &mut self.moved);
        let mut acting = std::mem::take(&mut self.acting);
        acting.fill(0.0);
        for (row, view) in self.each() {
            let View::Pixels { camera, point } = view else { continue };
            let (posed, seen) = (self.posed(camera, x, point), &self.cameras[camera]);
            let [d, da] = self.moved(&posed, camera, place(&self.moved, point), dx);
            let dy = [dy[row], dy[row + 1]];
            let (Ok(j), Ok(change)) = (seen.jacobian(&posed.point), seen.second(&posed.point, &d, dy)) else {
                continue;
            };
            let (force, jacobian) = (j[0] * dy[0] + j[1] * dy[1], left_jacobian(&posed.about));
            let on_place = posed.turn.tr_mul(&(change + force.cross(&(jacobian * da))));
            let turned = left_jacobian_derivative(&posed.about, &da).tr_mul(&force.cross(&posed.arm));
            let again = jacobian.tr_mul(&(change.cross(&posed.arm) + force.cross(&d)));
            self.on_pose_add(camera, [seen.rotation() * (turned + again), -on_place], out);
            add(&mut acting[3 * point..][..3], &on_place);
        }
        self.points.adjoint_add(at, x, &acting, out);
        self.acting = acting;
    }
}

/// A point p where a camera without its pose would see it at the same pixel, p* = c + exp(−[Rᵀρ]×)
/// (p − c − δ), with ∂p*/∂p and ∂p*/∂ρ.
struct Posed {
    point: Vector3<f64>,
    /// −Rᵀρ, and p* − c.
    about: Vector3<f64>,
    arm: Vector3<f64>,
    turn: Matrix3<f64>,
    by_rotation: Matrix3<f64>,
}

fn place(places: &[f64], point: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&places[3 * point..][..3])
}

/// Three numbers of a state; zero where there are none.
fn three(x: &[f64], first: Option<usize>) -> Vector3<f64> {
    first.map_or_else(Vector3::zeros, |i| Vector3::from_column_slice(&x[i..i + 3]))
}

fn add(into: &mut [f64], value: &Vector3<f64>) {
    into.iter_mut().zip(value.iter()).for_each(|(into, v)| *into += v);
}
