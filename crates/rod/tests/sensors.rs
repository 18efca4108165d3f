//! Sensors of forces and accelerations: values beside the forces within the rod and beside the velocities of
//! a run, derivatives beside differences, for rods of every kind.

mod common;

use common::rods_with_parameters::{Case, DOWN, LOST, PLAIN, SEGMENTS, cases, control, rod, step, supports};
use common::{difference, dot, noise, off};
use varda_implicit::{
    At, ImplicitModel, ImplicitStep, Model, ObservationOperator, ParametricStep, Scheme, WithParameters,
    check,
};
use varda_rod::{
    Damping, Error, Marker, Markers, Matrix3, ReadRotations, RodStep, Sensor, Sensors, UnitQuaternion,
    Vector3, rotation,
};

const STEP: f64 = 0.004;

/// In a fluid, pushed by forces that turn with sections, turned by moments.
const LOADED: [Case; 3] = [
    Case { name: "in a fluid", drag: true, ..PLAIN },
    Case { name: "pushed", pushed: true, anisotropic: true, curved: true, ..PLAIN },
    Case { name: "all at once", pushed: true, drag: true, end: true, damping: LOST, ..PLAIN },
];

/// A rotation about no axis of a section.
fn turned() -> Matrix3<f64> {
    rotation::exponential(&Vector3::new(0.4, -0.9, 1.3))
}

/// Every sensor that fits the supports of a case.
fn sensors(case: Case, rod: &RodStep) -> Vec<Sensor> {
    let length = rod.rod().length();
    let mut all = vec![
        Sensor::Tension { s: 0.31 },
        Sensor::Tension { s: 0.97 * length },
        Sensor::SupportForce { s: 0.0 },
        Sensor::Acceleration { s: 0.29 },
        Sensor::Acceleration { s: 0.6 },
        Sensor::SpecificForce { s: 0.44, axes: Matrix3::identity() },
        Sensor::SpecificForce { s: 0.8, axes: turned() },
        Sensor::AngularRate { s: 0.55 },
        Sensor::Direction { s: 0.55 },
        Sensor::Orientation { s: 0.33, axes: Matrix3::identity() },
        Sensor::Orientation { s: 0.9, axes: turned() },
        Sensor::Moment { s: rod.rod().arc_lengths()[3] },
        Sensor::Moment { s: 0.57 },
    ];
    if case.spins {
        all.push(Sensor::Spin { s: 0.7 });
    }
    if case.held || case.moved {
        all.extend([Sensor::AxialSupportForce { s: 0.0 }, Sensor::Tension { s: 0.01 }]);
        all.push(Sensor::SupportMoment { s: 0.0 });
    }
    if case.end {
        all.extend([Sensor::SupportForce { s: length }, Sensor::AxialSupportForce { s: length }]);
        all.push(Sensor::SupportMoment { s: length });
    } else if case.moved {
        let hook = rod.rod().arc_lengths()[SEGMENTS - 2];
        all.extend([Sensor::SupportForce { s: hook }, Sensor::Acceleration { s: hook - 0.01 }]);
    }
    all
}

/// These on a rod, and what those of rotations have read at the third step: a radian and more from what it
/// is; at another time something else.
fn reading(rod: RodStep, all: &[Sensor]) -> Result<Sensors, Error> {
    let about = |x, y, z| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
    let mut sensors = Sensors::new(rod, STEP, all)?;
    for (i, sensor) in all.iter().enumerate() {
        if let Sensor::Direction { .. } | Sensor::Orientation { .. } = sensor {
            let read = vec![(0.0, about(0.1, 0.2, 0.3)), (3.0 * STEP, about(0.9, -0.3, 0.2 * i as f64))];
            sensors = sensors.measured_from(i, ReadRotations::new(read));
        }
    }
    Ok(sensors)
}

/// A run of some steps: the step, its parameters and all states.
fn run(case: Case, scheme: Scheme, interval: f64, steps: usize) -> (RodStep, Vec<f64>, Vec<Vec<f64>>) {
    let step = step(case, scheme);
    let z = control(&step);
    let p = z[z.len() - step.parameters()..].to_vec();
    let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, interval);
    let mut states = vec![vec![0.0; Model::dim(&model)]];
    model.initial_state(&z, &mut states[0]).unwrap();
    for k in 0..steps {
        let mut next = states[k].clone();
        model.step(k, &states[k], &mut next).unwrap();
        states.push(next);
    }
    let own = |x: &Vec<f64>, model: &mut ImplicitModel<WithParameters<RodStep>>| {
        model.step_mut().at(x).unwrap().1.to_vec()
    };
    let states = states.iter().map(|x| own(x, &mut model)).collect();
    (model.into_inner().into_step(), p, states)
}

fn at(k: usize, interval: f64) -> At {
    At { step: k, time: k as f64 * interval }
}

fn observed(sensors: &mut Sensors, at: At, x: &[f64]) -> Vec<f64> {
    let mut y = vec![f64::NAN; sensors.dim()];
    sensors.observe(at, x, &mut y).unwrap();
    y
}

/// Neither strain rates nor drag, whose velocities of supports are differences.
fn without_rates(case: &Case) -> bool {
    case.damping.stiffness == 0.0 && !case.drag
}

/// Backward Euler has X_{k−1} = X_k − Δt V_k: without strain rates its forces are the same numbers.
#[test]
fn forces_are_those_within_the_rod() {
    for case in cases().into_iter().filter(without_rates) {
        let (mut rod, p, states) = run(case, Scheme::BackwardEuler, STEP, 3);
        let forces = rod.internal_forces(3.0 * STEP, &states[3], (2.0 * STEP, &states[2])).unwrap();
        let all = sensors(case, &rod);
        let (length, n) = (rod.rod().length(), SEGMENTS);
        let arc_lengths = rod.rod().arc_lengths();
        let supports = rod.supports().clone();
        let vertices = rod.vertices(3.0 * STEP, &states[3]).unwrap();
        let mut sensors = Sensors::new(rod, STEP, &all).unwrap();
        sensors.set_parameters(&p).unwrap();
        let y = observed(&mut sensors, at(3, STEP), &states[3]);
        let mut row = 0;
        for sensor in &all {
            let values = &y[row..row + sensor.rows()];
            row += sensor.rows();
            let reaction = |s: f64| {
                let found = forces.reactions.iter().find(|r| (arc_lengths[r.vertex] - s).abs() < 1e-9);
                found.unwrap_or_else(|| panic!("{}: no reaction at {s}", case.name))
            };
            let moment = |i: usize| {
                let [m1, m2] = forces.bending[i - 1];
                Vector3::new(m1, m2, forces.twisting[i - 1])
            };
            let expected: Vec<f64> = match *sensor {
                Sensor::Tension { s } => {
                    let edge = arc_lengths[1..].iter().position(|end| s <= *end).unwrap_or(n - 1);
                    vec![forces.tension[edge]]
                }
                Sensor::SupportForce { s } => reaction(s).force.as_slice().to_vec(),
                Sensor::AxialSupportForce { s } => {
                    let e = if s == 0.0 { 0 } else { n - 1 };
                    vec![reaction(s).force.dot(&(vertices[e + 1] - vertices[e]).normalize())]
                }
                Sensor::SupportMoment { s } => reaction(s).moment.as_slice().to_vec(),
                Sensor::Moment { s } => {
                    let i = arc_lengths.iter().rposition(|at| *at <= s).unwrap();
                    let share = (s - arc_lengths[i]) / (arc_lengths[i + 1] - arc_lengths[i]);
                    (moment(i) * (1.0 - share) + moment(i + 1) * share).as_slice().to_vec()
                }
                _ => continue,
            };
            let (error, size) = off(values, &expected);
            // rounding of EA ε, 3e2 N of strain 1e-16 / l
            assert!(error < 1e-10 * size.max(1.0), "{}: {sensor:?} {values:?} {expected:?}", case.name);
        }
        assert!(length > 0.9 && supports.start.is_some() == (case.held || case.moved));
    }
}

/// The acceleration that forces make is the rate of velocity in the equations of the step: of backward Euler
/// (V_k − V_{k−1})/Δt, of BDF2 (3V_k − 4V_{k−1} + V_{k−2})/2Δt.
#[test]
fn accelerations_are_those_of_the_schemes() {
    for case in cases().into_iter().filter(without_rates) {
        for scheme in [Scheme::BackwardEuler, Scheme::Bdf2] {
            let (rod, p, states) = run(case, scheme, STEP, 4);
            let (free, places) = (rod.free_vertices().to_vec(), 3 * rod.free_vertices().len());
            let arc_lengths = rod.rod().arc_lengths();
            let all: Vec<Sensor> = free.iter().map(|v| Sensor::Acceleration { s: arc_lengths[*v] }).collect();
            let mut sensors = Sensors::new(rod, STEP, &all).unwrap();
            sensors.set_parameters(&p).unwrap();
            let y = observed(&mut sensors, at(4, STEP), &states[4]);
            let v = |k: usize, i: usize| states[k][places + i];
            let rates: Vec<f64> = (0..places)
                .map(|i| match scheme {
                    Scheme::BackwardEuler => (v(4, i) - v(3, i)) / STEP,
                    _ => (3.0 * v(4, i) - 4.0 * v(3, i) + v(2, i)) / (2.0 * STEP),
                })
                .collect();
            let (error, size) = off(&y, &rates);
            // a step ends at an update of 1e-11 m, which is 1e-11/Δt² = 6e-7 of acceleration times
            // the stiffest EA/(l m) Δt² = 4e2
            assert!(error < 1e-5 * size && size > 1.0, "{}, {scheme:?}: {error:e} of {size:e}", case.name);
        }
    }
}

/// Sections are those that markers off the centreline have; an edge turns as its ends move.
#[test]
fn what_is_fixed_to_a_section_sees_its_axes() {
    for case in cases() {
        let (rod, p, states) = run(case, Scheme::Bdf2, STEP, 3);
        let (s, x, at) = (0.44, &states[3], at(3, STEP));
        let units = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
        let mut markers = Markers::new(&rod, &units.map(|offset| Marker { s, offset })).unwrap();
        markers.set_parameters(&p);
        let axes = |markers: &mut Markers, x: &[f64]| -> Matrix3<f64> {
            let mut y = [0.0; 12];
            markers.observe(at, x, &mut y).unwrap();
            let [o, m1, m2, t] = [0, 3, 6, 9].map(|i| Vector3::from_column_slice(&y[i..i + 3]));
            Matrix3::from_columns(&[m1 - o, m2 - o, t - o])
        };
        let section = axes(&mut markers, x);
        let all = [
            Sensor::Acceleration { s },
            Sensor::SpecificForce { s, axes: Matrix3::identity() },
            Sensor::SpecificForce { s, axes: turned() },
            Sensor::AngularRate { s },
            Sensor::Direction { s },
            Sensor::Orientation { s, axes: Matrix3::identity() },
            Sensor::Orientation { s, axes: turned() },
        ];
        let places = 3 * rod.free_vertices().len();
        let gravity = gravity_of(case, &p);
        let read = rotation::exponential(&Vector3::new(0.7, -0.2, 0.4));
        let rows = ReadRotations::new(vec![(at.time, UnitQuaternion::from_matrix(&read))]);
        let mut sensors = Sensors::new(rod, STEP, &all).unwrap();
        for i in 4..7 {
            sensors = sensors.measured_from(i, rows.clone());
        }
        sensors.set_parameters(&p).unwrap();
        let y = observed(&mut sensors, at, x);
        let [a, f, turned_f] = [0, 3, 6].map(|i| Vector3::from_column_slice(&y[i..i + 3]));
        let expected = section.tr_mul(&(a - gravity));
        // a few roundings
        assert!((f - expected).norm() < 1e-12 * expected.norm(), "{}: {f} {expected}", case.name);
        assert!((turned_f - turned() * f).norm() < 1e-12 * f.norm(), "{}", case.name);
        // what was read, turned by the angles along its own axes, is what is there
        let t = section.column(2).into_owned();
        let tilted = read * rotation::exponential(&Vector3::new(-y[12], y[11], 0.0)) * Vector3::z();
        assert!((tilted - t).norm() < 1e-12, "{}: {tilted} {t}", case.name);
        for (first, axes) in [(13, Matrix3::identity()), (16, turned())] {
            let turn = Vector3::from_column_slice(&y[first..first + 3]);
            let body = read * rotation::exponential(&turn) * axes;
            assert!((body - section).norm() < 1e-12, "{}: {body} {section}", case.name);
        }
        // ω = t × ṫ beside tangents a microsecond of the state's velocities before and after
        let moved = |h: f64| -> Vec<f64> {
            let mut moved = x.clone();
            (0..places).for_each(|i| moved[i] += h * x[places + i]);
            moved
        };
        let t = |markers: &mut Markers, h: f64| axes(markers, &moved(h)).column(2).into_owned();
        let rate = (t(&mut markers, 1e-6) - t(&mut markers, -1e-6)) / 2e-6;
        let omega = section.tr_mul(&section.column(2).cross(&rate));
        // rounding of a tangent over a microsecond
        assert!((omega.x - y[9]).abs().max((omega.y - y[10]).abs()) < 1e-8, "{}: {omega} {y:?}", case.name);
        assert!(f.norm() > 1.0 && omega.norm() > 1e-2, "{}: nothing moves", case.name);
    }
}

/// Gravity with the parameters of a case: those of `unknowns`, 5 to 7.
fn gravity_of(case: Case, p: &[f64]) -> Vector3<f64> {
    assert!(p.len() > 7, "{}: gravity is turned", case.name);
    let turn = Vector3::x() * p[6] + Vector3::new(0.0, 1.0, 0.2) * p[7];
    rotation::exponential(&turn) * (DOWN.gravity + Vector3::new(0.0, 9.81, 0.0) * p[5])
}

/// With strain rates, beside differences of velocities over fine steps.
#[test]
fn damped_accelerations_are_those_of_a_fine_run() {
    let fine = 1e-4;
    for case in cases().into_iter().filter(|case| !without_rates(case)) {
        let mut errors = Vec::new();
        for (interval, k) in [(2.0 * fine, 50), (fine, 100)] {
            let (rod, p, states) = run(case, Scheme::Bdf2, interval, k + 1);
            let (first, places) = (rod.free_vertices()[0], 3 * rod.free_vertices().len());
            let middle = rod.free_vertices().len() / 2;
            let s = rod.rod().arc_lengths()[first + middle];
            let mut sensors = Sensors::new(rod, interval, &[Sensor::Acceleration { s }]).unwrap();
            sensors.set_parameters(&p).unwrap();
            let y = observed(&mut sensors, at(k, interval), &states[k]);
            let rate: Vec<f64> = (0..3)
                .map(|c| places + 3 * middle + c)
                .map(|i| (states[k + 1][i] - states[k - 1][i]) / (2.0 * interval))
                .collect();
            let (error, size) = off(&y, &rate);
            errors.push(error / size);
        }
        // first order in Δt: what BDF2 is not, the rate of angles is
        assert!(errors[1] < 0.02 && errors[1] < 0.7 * errors[0], "{}: {errors:?}", case.name);
    }
}

/// Derivatives beside differences over h, sensor by sensor.
fn close(case: Case, sensors: &[Sensor], derivative: &[f64], by_difference: &[f64], h: f64, what: &str) {
    let mut row = 0;
    for sensor in sensors {
        let rows = row..row + sensor.rows();
        row = rows.end;
        let (error, size) = off(&derivative[rows.clone()], &by_difference[rows]);
        // rounding of EA ε, 3e2 N in edges of 0.1 m with strains of 1e-16, of rates over 1e-3 Δt times
        // β = 0.02 s (5e3); of accelerations over masses of 0.04 kg
        let rounding = if case.damping.stiffness > 0.0 || case.drag { 3e-9 } else { 1e-11 };
        let rounding = match sensor {
            Sensor::Acceleration { .. } | Sensor::SpecificForce { .. } => 30.0 * rounding,
            Sensor::AngularRate { .. } | Sensor::Spin { .. } => 1e-11,
            Sensor::Direction { .. } | Sensor::Orientation { .. } => 1e-11,
            // EI/l of 0.06 N m, of rates times 5e3
            Sensor::Moment { .. } => 1e-12,
            // an arm of 0.1 m
            Sensor::SupportMoment { .. } => 0.2 * rounding,
            _ => rounding,
        };
        let bound = 1e-7 * size + rounding / h;
        assert!(error <= bound, "{}, {what}, {sensor:?}: off by {error:e} of {size:e}, {bound:e}", case.name);
        assert!(
            bound <= 1e-4 * size.max(1.0),
            "{}, {what}, {sensor:?}: a bound that sees nothing",
            case.name
        );
    }
}

#[test]
fn every_check_of_an_operator() {
    for case in cases().into_iter().chain(LOADED) {
        for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
            let (rod, p, states) = run(case, scheme, STEP, 3);
            let all = sensors(case, &rod);
            let mut sensors = match reading(rod, &all) {
                Ok(sensors) => sensors,
                Err(error) => {
                    let needs_past = scheme == Scheme::BackwardEuler && case.damping.stiffness > 0.0;
                    assert!(error == Error::NoRates && needs_past, "{}: {error}", case.name);
                    continue;
                }
            };
            sensors.set_parameters(&p).unwrap();
            let x = &states[3];
            let report = check::operator(&mut sensors, at(3, STEP), x, &vec![1e-3; x.len()], 3).unwrap();
            assert!(report.passed(), "{}, {scheme:?}: {report}", case.name);
            for (i, dx) in (0..4).map(|seed| noise(seed).take(x.len()).collect::<Vec<f64>>()).enumerate() {
                let mut tangent = vec![0.0; sensors.dim()];
                sensors.tangent(at(3, STEP), x, &dx, &mut tangent);
                let by_difference = difference(x, &dx, 1e-5, |x| observed(&mut sensors, at(3, STEP), x));
                close(case, &all, &tangent, &by_difference, 1e-5, &format!("{scheme:?}, {i}"));
            }
        }
    }
}

/// (Σ dy ∂y/∂x, Σ dy ∂y/∂p) at a state with constants.
fn gradient(sensors: &mut Sensors, at: At, [x, p]: [&[f64]; 2], dy: &[f64]) -> Vec<f64> {
    sensors.set_parameters(p).unwrap();
    observed(sensors, at, x);
    let (mut back, mut columns) = (vec![0.0; x.len()], vec![0.0; dy.len() * p.len()]);
    sensors.adjoint_add(at, x, dy, &mut back);
    sensors.by_parameters(at, x, &mut columns).unwrap();
    back.extend(columns.chunks_exact(dy.len()).map(|column| dot(column, dy)));
    back
}

/// The product of Σ dy ∂²y/∂(x, p)² with an increment, or of the state's alone.
fn second(sensors: &mut Sensors, at: At, x: &[f64], by: &[f64], dy: &[f64], known: bool) -> Vec<f64> {
    let mut out = vec![0.0; by.len()];
    let ((dx, dp), (out_x, out_p)) = (by.split_at(x.len()), out.split_at_mut(x.len()));
    match known {
        true => sensors.second_adjoint_add(at, x, dx, dy, out_x),
        false => sensors.second_with_parameters_add(at, x, [dx, dp], dy, [out_x, out_p]),
    }
    out
}

/// Second derivatives by the state, and by the state with constants, sensor by sensor, beside differences of
/// first ones, extrapolated twice.
#[test]
fn second_derivatives_are_those_of_the_first() {
    let schemes = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];
    let all = || cases().into_iter().chain(LOADED).flat_map(|case| schemes.map(|scheme| (case, scheme)));
    for (known, (case, scheme)) in [true, false].into_iter().flat_map(|known| all().map(move |c| (known, c)))
    {
        let (rod, p, states) = run(case, scheme, STEP, 3);
        let (all, places, own) =
            (sensors(case, &rod), 3 * rod.free_vertices().len(), rod.dim() - rod.history());
        let Ok(mut sensors) = reading(rod, &all) else { continue };
        sensors.set_parameters(&p).unwrap();
        assert!(sensors.has_second_derivatives());
        let (x, at) = (&states[3], at(3, STEP));
        let n = x.len() + p.len();
        let scale = |i: usize| match i % own {
            _ if i >= x.len() => 0.2,
            i if i < places => 1e-2,
            i if i < 2 * places => 1.0,
            _ => 0.1,
        };
        let [a, b] = [5, 6].map(|seed| -> Vec<f64> {
            let moves = |i: usize| if known && i >= x.len() { 0.0 } else { scale(i) };
            noise(seed).take(n).enumerate().map(|(i, e)| moves(i) * e).collect()
        });
        let mut row = 0;
        for sensor in &all {
            let mut dy = vec![0.0; sensors.dim()];
            let rows = row..row + sensor.rows();
            row = rows.end;
            dy[rows].iter_mut().zip(noise(9)).for_each(|(dy, e)| *dy = e);
            let steps = [0.04, 0.02, 0.01].map(|h| -> Vec<f64> {
                let mut moved = |h: f64| {
                    let at_h = |of: &[f64], by: &[f64]| -> Vec<f64> {
                        of.iter().zip(by).map(|(of, by)| of + h * by).collect()
                    };
                    let (x, p) = (at_h(x, &a[..x.len()]), at_h(&p, &a[x.len()..]));
                    gradient(&mut sensors, at, [&x, &p], &dy)
                };
                moved(h).iter().zip(moved(-h)).map(|(p, m)| (p - m) / (2.0 * h)).collect()
            });
            let better = |coarse: &[f64], fine: &[f64], k: f64| -> Vec<f64> {
                coarse.iter().zip(fine).map(|(c, f)| f + (f - c) / (k - 1.0)).collect()
            };
            let once = [better(&steps[0], &steps[1], 4.0), better(&steps[1], &steps[2], 4.0)];
            let best = better(&once[0], &once[1], 16.0);
            gradient(&mut sensors, at, [x, &p], &dy);
            let [mut by_a, by_b] = [&a, &b].map(|by| second(&mut sensors, at, x, by, &dy, known));
            let seen = if known { x.len() } else { n };
            let norm =
                |of: &dyn Fn(usize) -> f64| (0..seen).map(|i| (scale(i) * of(i)).powi(2)).sum::<f64>().sqrt();
            let size = norm(&|i| by_a[i]);
            let error = norm(&|i| by_a[i] - best[i]);
            let name = format!("{}, {scheme:?}, {sensor:?}, {known}: {error:.1e} of {size:.1e}", case.name);
            // a number of the state; a section that is clamped
            let constant = match sensor {
                Sensor::Spin { .. } => true,
                Sensor::Orientation { s, .. } => case.end && *s > 0.875 && (known || !case.moved),
                _ => false,
            };
            if constant {
                assert!(size == 0.0, "{name}");
                continue;
            }
            // what three differences leave, h⁶ of the seventh derivative and rounding: 2e-9 and less, where
            // strain rates over 1e-3 Δt round too
            assert!(error <= 1e-8 * size, "{name}");
            let symmetry = (dot(&by_a, &b) - dot(&by_b, &a)).abs();
            let products = size * norm(&|i| b[i] / scale(i).powi(2));
            // rounding of stresses of rates and of velocities of drag, 5e3 times what is left of them
            let bound = if case.damping.stiffness > 0.0 || case.drag { 1e-10 } else { 1e-12 };
            assert!(symmetry <= bound * products, "{name}: {:e}", symmetry / products);
            let [coarse, fine] = [0, 1].map(|s: usize| norm(&|i| by_a[i] - steps[s][i]));
            if coarse > 1e-5 * size {
                let slope = (coarse / fine).log2();
                assert!((slope - 2.0).abs() <= 0.1, "{name}: slope {slope}");
            }
            let entry = |i: &usize| (scale(*i) * by_a[*i]).abs();
            let largest = (0..seen).max_by(|i, j| entry(i).total_cmp(&entry(j))).unwrap();
            by_a[largest] *= 1.00001;
            assert!(norm(&|i| by_a[i] - best[i]) > 1e-8 * size, "{name}: a wrong entry is not seen");
        }
    }
}

#[test]
fn constants_change_what_sensors_see_as_differences_say() {
    for case in cases() {
        let (rod, p, states) = run(case, Scheme::Bdf2, STEP, 3);
        let all = sensors(case, &rod);
        let mut sensors = reading(rod, &all).unwrap();
        let (rows, x, at) = (sensors.dim(), &states[3], at(3, STEP));
        sensors.set_parameters(&p).unwrap();
        let mut columns = vec![f64::NAN; rows * p.len()];
        sensors.by_parameters(at, x, &mut columns).unwrap();
        for (i, column) in columns.chunks_exact(rows).enumerate() {
            let mut dp = vec![0.0; p.len()];
            dp[i] = 1.0;
            let by_difference = difference(&p, &dp, 1e-3, |p| {
                sensors.set_parameters(p).unwrap();
                observed(&mut sensors, at, x)
            });
            sensors.set_parameters(&p).unwrap();
            close(case, &all, column, &by_difference, 1e-3, &format!("constant {i}"));
        }
    }
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let of = |case: Case, scheme, sensor| Sensors::new(step(case, scheme), STEP, &[sensor]).err();
    let bdf2 = Scheme::Bdf2;
    let not_held = |s, what| Some(Error::NotHeld { s, what });
    assert_eq!(of(PLAIN, bdf2, Sensor::SupportForce { s: 0.5 }), not_held(0.5, "support"));
    assert_eq!(of(PLAIN, bdf2, Sensor::AxialSupportForce { s: 1.0 }), not_held(1.0, "clamp"));
    let loose = Case { held: false, ..PLAIN };
    assert_eq!(of(loose, bdf2, Sensor::SupportForce { s: 0.0 }), None);
    assert_eq!(of(loose, bdf2, Sensor::AxialSupportForce { s: 0.0 }), not_held(0.0, "clamp"));
    assert_eq!(of(PLAIN, bdf2, Sensor::SupportMoment { s: 1.0 }), not_held(1.0, "clamp"));
    assert_eq!(of(loose, bdf2, Sensor::SupportMoment { s: 0.0 }), not_held(0.0, "clamp"));
    let near = |s| of(PLAIN, bdf2, Sensor::Moment { s });
    let beside = |s| Some(Error::NoMoment { s, from: 0.125, to: 0.875 });
    assert_eq!([near(0.0), near(0.1), near(0.9)], [beside(0.0), beside(0.1), beside(0.9)]);
    assert_eq!([near(0.125), near(0.875)], [None, None]);
    let spin = Sensor::Spin { s: 0.5 };
    assert!(matches!(of(PLAIN, bdf2, spin), Some(Error::NoSpin { edge: 3 })));
    let skew = Sensor::SpecificForce { s: 0.5, axes: Matrix3::identity() * 2.0 };
    assert!(matches!(of(PLAIN, bdf2, skew), Some(Error::Value { field: "axes of a sensor", .. })));
    assert!(matches!(of(PLAIN, bdf2, Sensor::Tension { s: 1.2 }), Some(Error::OffRod { s: 1.2, .. })));
    assert!(matches!(of(PLAIN, bdf2, Sensor::Acceleration { s: f64::NAN }), Some(Error::OffRod { .. })));
    let damped = Case { damping: LOST, ..PLAIN };
    let euler = Scheme::BackwardEuler;
    assert_eq!(of(damped, euler, Sensor::Tension { s: 0.5 }), Some(Error::NoRates));
    let mut chain = rod(PLAIN);
    chain.ei.fill([0.0; 3]);
    chain.gj.fill(0.0);
    let chain = || RodStep::new(chain.clone(), supports(PLAIN), DOWN, Damping::default()).unwrap();
    let body = Sensor::Orientation { s: 0.5, axes: Matrix3::identity() };
    assert_eq!(Sensors::new(chain(), STEP, &[body]).err(), Some(Error::NoAngle));
    assert_eq!(Sensors::new(chain(), STEP, &[Sensor::AngularRate { s: 0.5 }]).err(), Some(Error::NoFrames));
    assert_eq!(Sensors::new(chain(), STEP, &[Sensor::Moment { s: 0.5 }]).err(), Some(Error::NoFrames));
    // neither a director that is held nor curvature: the angle of its sections is a convention
    assert_eq!((of(loose, bdf2, body), of(PLAIN, bdf2, body)), (Some(Error::NoAngle), None));
    let skew = Sensor::Orientation { s: 0.5, axes: Matrix3::identity() * 2.0 };
    assert!(matches!(of(PLAIN, bdf2, skew), Some(Error::Value { field: "axes of a sensor", .. })));
    let wrong = Sensors::new(step(PLAIN, bdf2), 0.0, &[]).err();
    assert!(matches!(wrong, Some(Error::Value { field: "interval of sensors", .. })));
}
