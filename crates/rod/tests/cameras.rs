//! Cameras beside OpenCV and beside dual numbers, and views of markers.

use nalgebra::SVector;
use num_dual::{Dual2SVec64, DualNum};
use varda_implicit::{At, ImplicitStep, ObservationOperator, Refusal, check};
use varda_rod::{
    Camera, Clamp, ClampAt, Damping, Error, Loads, Marker, Markers, Material, Matrix3, OutOfSight, Rod,
    RodStep, Section, Supports, Vector3, View, Views, rotation,
};

const FOCAL: [f64; 2] = [812.5, 805.0];
const CENTER: [f64; 2] = [331.25, 242.5];
/// k₁, k₂, p₁, p₂, k₃.
const LENS: [f64; 5] = [-0.28, 0.09, 1.2e-3, -7e-4, -0.011];

/// Rodrigues((0.3, −0.4, 1.1)), by OpenCV 5.0.0.
fn rotation() -> Matrix3<f64> {
    Matrix3::new(
        0.39438975366415885,
        -0.9042535092178294,
        -0.16365302707852672,
        0.7981612032903829,
        0.42533334289299746,
        -0.4266500216635599,
        0.455406868379005,
        0.03764489992958889,
        0.8894871813255765,
    )
}

/// −Rᵀ t for t = (0.05, −0.12, 1.9).
const POSITION: [f64; 3] = [-0.7892131932084715, 0.024727366741832277, -1.733040995764296];

fn camera() -> Camera {
    Camera::new(FOCAL, CENTER).unwrap().distorted(LENS).unwrap().posed(POSITION.into(), rotation()).unwrap()
}

/// Point, pixel and ∂(u, v)/∂p of `cv2.projectPoints` (opencv-python-headless 5.0.0) for these rvec,
/// tvec, camera matrix and coefficients; the derivative from its columns of tvec, times R.
const OPENCV: [([f64; 3], [f64; 2], [[f64; 3]; 2]); 5] = [
    (
        [0.1, 0.2, 0.3],
        [279.8982443842207, 212.41213694003045],
        [
            [153.92107066240501, -329.1323684097787, -38.946951885905094],
            [294.6673276237921, 154.83023037765736, -142.2300770713745],
        ],
    ),
    (
        [-0.35, 0.15, -0.2],
        [233.42933188876907, 115.56077640932894],
        [
            [223.7791187074009, -459.5670282114324, -26.55869584092864],
            [432.887183737238, 220.56584122957264, -142.04488112682319],
        ],
    ),
    (
        [0.4, -0.45, 0.6],
        [490.44377867596313, 166.7601653077842],
        [
            [94.46416682318119, -273.3424889805935, -103.77065551935448],
            [256.6859376830105, 127.21232078622769, -104.95449243468788],
        ],
    ),
    (
        [0.0, 0.0, 0.0],
        [352.59690274327426, 191.7385405067902],
        [
            [163.59022948576907, -386.15574095464353, -80.00744492202304],
            [349.118388060936, 180.0704829847506, -156.41647810972543],
        ],
    ),
    (
        [-0.2, -0.5, 1.5],
        [375.69165073910165, -38.304357402318885],
        [
            [94.91209161097649, -225.2763815494994, -53.86017043394477],
            [222.905692078896, 98.48346202123842, -24.63996188866595],
        ],
    ),
];

#[test]
fn pixels_and_derivatives_are_those_of_opencv() {
    let camera = camera();
    for (point, pixel, derivative) in OPENCV {
        let p = Vector3::from(point);
        let [u, v] = camera.project(&p).unwrap();
        // some twenty roundings of a number of some hundreds
        assert!((u - pixel[0]).abs().max((v - pixel[1]).abs()) < 5e-12, "{u} {v} {pixel:?}");
        for (row, expected) in camera.jacobian(&p).unwrap().iter().zip(derivative) {
            let off = (row - Vector3::from(expected)).norm();
            assert!(off < 1e-13 * row.norm() + 1e-11, "{off:e} of {row} at {point:?}");
        }
    }
}

/// The formulas as they are printed, over any number.
fn by_the_book<D: DualNum<Primitive = f64> + Copy>(p: [D; 3]) -> [D; 2] {
    let (r, c) = (rotation(), |value: f64| D::from(value));
    let at: [D; 3] = std::array::from_fn(|i| {
        (0..3).map(|j| (p[j] - c(POSITION[j])) * c(r[(i, j)])).fold(c(0.0), |a, b| a + b)
    });
    let (x, y) = (at[0] / at[2], at[1] / at[2]);
    let [k1, k2, p1, p2, k3] = LENS.map(c);
    let q = x * x + y * y;
    let d = c(1.0) + k1 * q + k2 * q * q + k3 * q * q * q;
    let xd = x * d + c(2.0) * p1 * x * y + p2 * (q + c(2.0) * x * x);
    let yd = y * d + p1 * (q + c(2.0) * y * y) + c(2.0) * p2 * x * y;
    [xd * c(FOCAL[0]) + c(CENTER[0]), yd * c(FOCAL[1]) + c(CENTER[1])]
}

#[test]
fn both_derivatives_are_those_of_dual_numbers() {
    let camera = camera();
    let (a, dp) = ([0.7, -1.3], Vector3::new(0.2, -0.5, 0.9));
    for (point, ..) in OPENCV {
        let p = Vector3::from(point);
        let weighed = |q: SVector<Dual2SVec64<3>, 3>| {
            let [u, v] = by_the_book([q[0], q[1], q[2]]);
            u * a[0] + v * a[1]
        };
        let (value, gradient, hessian) = num_dual::hessian(weighed, &p);
        let [u, v] = camera.project(&p).unwrap();
        let j = camera.jacobian(&p).unwrap();
        let second = camera.second(&p, &dp, a).unwrap();
        // roundings of values of some hundreds and derivatives of up to some thousands
        assert!((value - a[0] * u - a[1] * v).abs() < 1e-11);
        assert!((gradient - j[0] * a[0] - j[1] * a[1]).norm() < 1e-11);
        assert!((hessian * dp - second).norm() < 1e-11 * hessian.norm(), "{second} {}", hessian * dp);
    }
}

#[test]
fn what_is_in_no_image_is_refused_with_its_reason() {
    let camera = camera();
    let along = |depth: f64, aside: f64| {
        Vector3::from(POSITION) + rotation().tr_mul(&Vector3::new(aside * depth, 0.0, depth))
    };
    assert!(camera.project(&along(2.0, 0.1)).is_ok());
    for depth in [0.0, -1e-300, -2.0] {
        // at the centre itself rounding decides the sign, not the refusal
        let behind = camera.project(&along(depth, 0.1)).unwrap_err();
        assert!(matches!(behind, OutOfSight::Behind { .. } | OutOfSight::BeyondTheLens { .. }), "{behind}");
    }
    assert!(matches!(camera.jacobian(&along(-2.0, 0.1)), Err(OutOfSight::Behind { .. })));
    assert!(matches!(camera.project(&Vector3::new(f64::NAN, 0.0, 0.0)), Err(OutOfSight::NonFinite)));
    // r (1 + k₁ r²) grows up to r = 1/√(−3 k₁)
    let barrel = |k1: f64| {
        let lens = Camera::new([500.0; 2], [0.0; 2]).unwrap().distorted([k1, 0.0, 0.0, 0.0, 0.0]).unwrap();
        move |x: f64| lens.project(&Vector3::new(x, 0.0, 1.0))
    };
    for k1 in [-0.01, -0.28, -3.0] {
        let widest = (-1.0 / (3.0 * k1)).sqrt();
        assert!(barrel(k1)((1.0 - 1e-12) * widest).is_ok());
        let beyond = barrel(k1)((1.0 + 1e-12) * widest).unwrap_err();
        assert!(matches!(beyond, OutOfSight::BeyondTheLens { .. }), "{beyond}");
    }
    // pincushion distortion grows everywhere; what is beside the camera is in no image
    assert!(barrel(0.3)(900.0).is_ok() && barrel(0.0)(1e150).is_err());
    // 1 − 3 q + 5·0.1 q² has its first zero at 3 − √7, where the parabola comes down
    let lens = Camera::new([1.0; 2], [0.0; 2]).unwrap().distorted([-1.0, 0.1, 0.0, 0.0, 0.0]).unwrap();
    let at = |q: f64| lens.project(&Vector3::new(q.sqrt(), 0.0, 1.0)).is_ok();
    let zero = 3.0 - 7.0_f64.sqrt();
    assert!(at(zero * (1.0 - 1e-12)) && !at(zero * (1.0 + 1e-12)) && !at(6.0));
    // 1 + 3·0.1 q − 5·0.001 q² + 7·(−1e-5) q³: rises first
    let lens = Camera::new([1.0; 2], [0.0; 2]).unwrap().distorted([0.1, -1e-3, 0.0, 0.0, -1e-5]).unwrap();
    let g = |q: f64| 1.0 + 0.3 * q - 5e-3 * q * q - 7e-5 * q * q * q;
    let mut grows = 0.0;
    while g(grows) > 0.0 {
        grows += 1e-3;
    }
    let at = |q: f64| lens.project(&Vector3::new(q.sqrt(), 0.0, 1.0)).is_ok();
    assert!(at(grows - 2e-3) && !at(grows + 1e-3), "{grows}");
}

#[test]
fn what_is_no_camera_is_refused() {
    for focal in [[0.0, 1.0], [1.0, -1.0], [f64::NAN, 1.0], [f64::INFINITY, 1.0]] {
        assert!(Camera::new(focal, [0.0; 2]).is_err());
    }
    let camera = || Camera::new([500.0; 2], [0.0; 2]).unwrap();
    assert!(camera().distorted([0.0, f64::NAN, 0.0, 0.0, 0.0]).is_err());
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    for wrong in [mirror, 1.1 * Matrix3::identity(), Matrix3::zeros()] {
        assert!(camera().posed(Vector3::zeros(), wrong).is_err());
    }
    // four digits are meant as a rotation
    let rounded = rotation().map(|r| (1e4 * r).round() / 1e4);
    let p = Vector3::from([0.1, 0.2, 0.3]);
    let exact = camera().posed(POSITION.into(), rotation()).unwrap().project(&p).unwrap();
    let seen = camera().posed(POSITION.into(), rounded).unwrap().project(&p).unwrap();
    assert!((exact[0] - seen[0]).abs() < 0.1 && (exact[1] - seen[1]).abs() < 0.1);
}

fn step() -> RodStep {
    let rod = Rod::uniform(1.0, 10, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
    let supports =
        Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]));
    RodStep::new(rod, supports, Loads::default(), Damping::default()).unwrap()
}

/// A bent rod of 10 segments, at rest.
fn state(step: &RodStep) -> Vec<f64> {
    let place = |v: u32| {
        let s = 0.1 * f64::from(v);
        [s - 0.05 * s * s, 0.1 * s * s, 0.2 * s.powi(3)]
    };
    let mut state: Vec<f64> = (2..=10).flat_map(place).collect();
    state.resize(step.dim(), 0.0);
    state
}

/// A place and two cameras' pixels, one of a marker off the centreline.
fn views(step: &RodStep) -> Views {
    let on = Marker { s: 0.37, offset: Vector3::zeros() };
    let off = Marker { s: 0.83, offset: Vector3::new(0.02, -0.01, 0.005) };
    let markers = Markers::new(step, &[on, off]).unwrap();
    let other = camera().moved(Vector3::new(0.3, -0.1, 0.05));
    let views = [
        View::Pixels { camera: 0, point: 1 },
        View::Place { point: 0 },
        View::Pixels { camera: 1, point: 1 },
        View::Pixels { camera: 1, point: 0 },
    ];
    let named = views.iter().enumerate().map(|(i, view)| (format!("view {i}"), *view)).collect();
    Views::new(Box::new(markers), vec![camera(), other], named).unwrap()
}

const AT: At = At { step: 0, time: 0.0 };

#[test]
fn views_pass_every_check_of_an_operator() {
    let step = step();
    let x = state(&step);
    let report = check::operator(&mut views(&step), AT, &x, &vec![1e-3; x.len()], 2).unwrap();
    assert!(report.passed(), "{report}");
}

/// An entry of the transpose, or of the tangent, is off by a thousandth.
struct Mutant(Views, bool);

impl ObservationOperator for Mutant {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn state_dim(&self) -> usize {
        self.0.state_dim()
    }
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.0.observe(at, x, y)
    }
    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.0.tangent(at, x, dx, dy);
        dy[1] *= if self.1 { 1.001 } else { 1.0 };
    }
    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        let mut dy = dy.to_vec();
        dy[1] *= 1.001;
        self.0.adjoint_add(at, x, &dy, dx);
    }
}

#[test]
fn an_entry_of_the_jacobian_that_is_off_is_found() {
    let step = step();
    let x = state(&step);
    for (both, finds) in [(false, "dot product"), (true, "Taylor")] {
        let mut mutant = Mutant(views(&step), both);
        let report = check::operator(&mut mutant, AT, &x, &vec![1e-3; x.len()], 2).unwrap();
        let failed: Vec<&str> = report.failed().map(|f| f.what.as_str()).collect();
        assert!(failed.len() == 1 && failed[0].contains(finds), "{report}");
    }
}

/// Beside a central difference of the adjoint.
#[test]
fn second_derivatives_of_views() {
    let step = step();
    let (mut views, x) = (views(&step), state(&step));
    assert!(views.has_second_derivatives());
    let positions = 27;
    let dx: Vec<f64> =
        (0..x.len()).map(|i| if i < positions { (1.7 * i as f64).sin() } else { 0.0 }).collect();
    let dy: Vec<f64> = (0..views.dim()).map(|i| (0.9 * i as f64 + 0.3).cos()).collect();
    let mut adjoint = |h: f64| {
        let moved: Vec<f64> = x.iter().zip(&dx).map(|(x, d)| x + h * d).collect();
        let mut out = vec![0.0; x.len()];
        views.adjoint_add(AT, &moved, &dy, &mut out);
        out
    };
    let h = 1e-5;
    let (after, before) = (adjoint(h), adjoint(-h));
    let mut second = vec![0.0; x.len()];
    views.second_adjoint_add(AT, &x, &dx, &dy, &mut second);
    let norm = second.iter().map(|s| s * s).sum::<f64>().sqrt();
    let off =
        second.iter().zip(after.iter().zip(&before)).map(|(s, (a, b))| (s - (a - b) / (2.0 * h)).powi(2));
    // h² of third derivatives, and rounding over h: 1e-8 and less of the whole
    assert!(off.sum::<f64>().sqrt() < 1e-6 * norm, "{norm}");
}

/// Markers of a state with numbers behind it.
struct Longer(Markers, usize);

impl ObservationOperator for Longer {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn state_dim(&self) -> usize {
        self.0.state_dim() + self.1
    }
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.0.observe(at, &x[..self.0.state_dim()], y)
    }
    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        let own = self.0.state_dim();
        self.0.tangent(at, &x[..own], &dx[..own], dy);
    }
    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        let own = self.0.state_dim();
        self.0.adjoint_add(at, &x[..own], dy, &mut dx[..own]);
    }
    fn has_second_derivatives(&self) -> bool {
        true
    }
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        let own = self.0.state_dim();
        self.0.second_adjoint_add(at, &x[..own], &dx[..own], dy, &mut out[..own]);
    }
}

/// With poses in the state, of markers off the axis: beside differences of the adjoint, extrapolated twice.
#[test]
fn second_derivatives_of_views_with_unknown_poses() {
    let step = step();
    let offsets = [Vector3::zeros(), Vector3::new(0.02, -0.01, 0.005)];
    let markers = [0.37, 0.83].into_iter().zip(offsets).map(|(s, offset)| Marker { s, offset });
    let markers = Markers::new(&step, &markers.collect::<Vec<_>>()).unwrap();
    let view = |camera, point| (String::new(), View::Pixels { camera, point });
    let all = vec![view(0, 1), (String::new(), View::Place { point: 0 }), view(1, 1), view(0, 0)];
    let cameras = vec![camera(), camera().moved(Vector3::new(0.3, -0.1, 0.05))];
    let (mut x, n) = (state(&step), step.dim());
    x.extend([0.05, -0.02, 0.3, 0.01, -0.03, 0.02, -0.04, 0.1, 0.02]);
    let mut views = Views::new(Box::new(Longer(markers, 9)), cameras, all).unwrap();
    views = views.with_poses(vec![[Some(n), Some(n + 3)], [Some(n + 6), None]]).unwrap();
    assert!(views.has_second_derivatives());
    let dy: Vec<f64> = (0..views.dim()).map(|i| (0.9 * i as f64 + 0.3).cos()).collect();
    let positions = 27;
    let scale = |i: usize| match i {
        _ if i < positions => 0.02,
        _ if i < n => 0.0,
        _ => 0.05,
    };
    let [a, b] =
        [1.7, 2.3].map(|w| (0..x.len()).map(|i| scale(i) * (w * i as f64).sin()).collect::<Vec<_>>());
    let mut adjoint = |h: f64| -> Vec<f64> {
        let moved: Vec<f64> = x.iter().zip(&a).map(|(x, d)| x + h * d).collect();
        let mut out = vec![0.0; x.len()];
        views.adjoint_add(AT, &moved, &dy, &mut out);
        out
    };
    let steps = [0.08, 0.04, 0.02].map(|h| -> Vec<f64> {
        adjoint(h).iter().zip(adjoint(-h)).map(|(p, m)| (p - m) / (2.0 * h)).collect()
    });
    let better = |coarse: &[f64], fine: &[f64], k: f64| -> Vec<f64> {
        coarse.iter().zip(fine).map(|(c, f)| f + (f - c) / (k - 1.0)).collect()
    };
    let once = [better(&steps[0], &steps[1], 4.0), better(&steps[1], &steps[2], 4.0)];
    let best = better(&once[0], &once[1], 16.0);
    let [mut by_a, by_b] = [&a, &b].map(|dx| {
        let mut out = vec![0.0; x.len()];
        views.second_adjoint_add(AT, &x, dx, &dy, &mut out);
        out
    });
    let norm =
        |of: &dyn Fn(usize) -> f64| (0..x.len()).map(|i| (scale(i) * of(i)).powi(2)).sum::<f64>().sqrt();
    let size = norm(&|i| by_a[i]);
    let error = norm(&|i| by_a[i] - best[i]);
    // what three differences leave: h⁶ of seventh derivatives
    assert!(error <= 1e-8 * size, "{error:e} of {size:e}");
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let gap = (product(&by_a, &b) - product(&by_b, &a)).abs();
    assert!(gap <= 1e-14 * size * (x.len() as f64).sqrt(), "{gap:e} of {size:e}");
    let slope = norm(&|i| by_a[i] - steps[1][i]) / norm(&|i| by_a[i] - steps[2][i]);
    assert!((slope.log2() - 2.0).abs() <= 0.1, "slope {}", slope.log2());
    // every entry of a pose counts
    for i in n..x.len() {
        let right = by_a[i];
        by_a[i] *= 1.001;
        let off = norm(&|i| by_a[i] - best[i]);
        assert!(off > 1e-8 * size, "entry {i}, wrong by a thousandth, is not seen: {off:e} of {size:e}");
        by_a[i] = right;
    }
}

/// Poses in the state: pixels are those of cameras that stand there, and every check passes.
#[test]
fn the_pose_of_a_camera_may_be_unknown() {
    let step = step();
    let markers = || {
        let all = [0.37, 0.83].map(|s| Marker { s, offset: Vector3::zeros() });
        Longer(Markers::new(&step, &all).unwrap(), 9)
    };
    let other = camera().moved(Vector3::new(0.3, -0.1, 0.05));
    let view = |camera, point| (String::new(), View::Pixels { camera, point });
    let all = || vec![view(0, 1), (String::new(), View::Place { point: 0 }), view(1, 1), view(0, 0)];
    let of = |cameras: [Camera; 2]| Views::new(Box::new(markers()), cameras.to_vec(), all()).unwrap();
    let (mut x, n) = (state(&step), step.dim());
    let (rho, delta) = (Vector3::new(0.05, -0.02, 0.3), Vector3::new(0.01, -0.03, 0.02));
    let of_other = Vector3::new(-0.04, 0.1, 0.02);
    for v in [rho, delta, of_other] {
        x.extend_from_slice(v.as_slice());
    }
    let poses = vec![[Some(n), Some(n + 3)], [Some(n + 6), None]];
    let mut unknown = of([camera(), other.clone()]).with_poses(poses).unwrap();
    let report = check::operator(&mut unknown, AT, &x, &vec![1e-3; x.len()], 2).unwrap();
    assert!(report.passed(), "{report}");
    // turned about its own axes, its axes in space are Rᵀ exp([ρ]×)
    let turned = |camera: &Camera, rho: &Vector3<f64>, delta: Vector3<f64>| {
        let axes = rotation::exponential(rho).tr_mul(&camera.rotation());
        camera.clone().posed(camera.position() + delta, axes).unwrap()
    };
    let there = [turned(&camera(), &rho, delta), turned(&other, &of_other, Vector3::zeros())];
    let mut known = of(there);
    let [mut a, mut b] = [vec![0.0; unknown.dim()], vec![0.0; unknown.dim()]];
    unknown.observe(AT, &x, &mut a).unwrap();
    known.observe(AT, &x, &mut b).unwrap();
    // rounding of pixels of some hundreds
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-9), "{a:?} {b:?}");
    // beside central differences over 1e-6 of pixels of 1e3
    let mut columns = vec![0.0; a.len()];
    for i in n..x.len() {
        let mut dx = vec![0.0; x.len()];
        dx[i] = 1.0;
        unknown.tangent(AT, &x, &dx, &mut columns);
        let mut at = |h: f64| {
            let mut moved = x.clone();
            moved[i] += h;
            unknown.observe(AT, &moved, &mut a).unwrap();
            a.clone()
        };
        let (after, before) = (at(1e-6), at(-1e-6));
        for (column, (after, before)) in columns.iter().zip(after.iter().zip(&before)) {
            assert!((column - (after - before) / 2e-6).abs() < 1e-5, "{i}: {column} {after} {before}");
        }
    }
    let refused = |poses| of([camera(), other.clone()]).with_poses(poses).err();
    assert!(matches!(refused(vec![[None; 2]]), Some(Error::Count { found: 1, expected: 2, .. })));
    assert!(matches!(refused(vec![[None; 2], [None, Some(n + 7)]]), Some(Error::Value { .. })));
}

#[test]
fn only_what_must_be_seen_is_an_error() {
    let step = step();
    let x = state(&step);
    let markers = || Box::new(Markers::new(&step, &[Marker { s: 0.9, offset: Vector3::zeros() }]).unwrap());
    // it looks away from the rod
    let away = Camera::new([500.0; 2], [0.0; 2]).unwrap().posed(Vector3::z(), Matrix3::identity()).unwrap();
    let view = || vec![("marker tip in camera left".to_string(), View::Pixels { camera: 0, point: 0 })];
    let mut y = [1.0; 2];
    let mut strict = Views::new(markers(), vec![away.clone()], view()).unwrap();
    let said = strict.observe(At { step: 3, time: 0.25 }, &x, &mut y).unwrap_err().to_string();
    assert!(said.starts_with("marker tip in camera left cannot be seen at t = 0.25 s: it is -"), "{said}");
    let mut lax = Views::new(markers(), vec![away], view()).unwrap().seen_where(|at, _| at.step == 4);
    lax.observe(At { step: 3, time: 0.25 }, &x, &mut y).unwrap();
    lax.tangent(At { step: 3, time: 0.25 }, &x, &x, &mut y);
    assert_eq!(y, [0.0; 2]);
    assert!(lax.observe(At { step: 4, time: 0.25 }, &x, &mut y).is_err());
    let nothing = Views::new(markers(), vec![], view());
    assert!(nothing.is_err(), "a camera that is not there");
}
