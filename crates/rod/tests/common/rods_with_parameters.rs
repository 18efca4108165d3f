//! Rods of every kind with constants as parameters.

use varda_implicit::{ParametricStep, Scheme};
use varda_rod::{
    Change, Clamp, ClampAt, Damping, Displacement, Drag, EllipseDrive, FollowerForce, HeldAt, Law, Loads,
    Material, Moment, Motion, Moved, MovedBy, Parameter, Rod, RodStep, Section, Supports, Vector3,
    straight_guess,
};

use super::{Dashpot, noise};

pub(crate) const SEGMENTS: usize = 8;

/// What of a rod differs from case to case.
#[derive(Clone, Copy)]
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) anisotropic: bool,
    pub(crate) curved: bool,
    pub(crate) damping: Damping,
    pub(crate) spins: bool,
    pub(crate) end: bool,
    pub(crate) held: bool,
    /// Parameters move the supports.
    pub(crate) moved: bool,
    pub(crate) drag: bool,
    /// Forces that turn with sections, and moments.
    pub(crate) pushed: bool,
}

pub(crate) const PLAIN: Case = Case {
    name: "plain",
    anisotropic: false,
    curved: false,
    damping: Damping { stiffness: 0.0, mass: 0.0 },
    spins: false,
    end: false,
    held: true,
    moved: false,
    drag: false,
    pushed: false,
};
pub(crate) const LOST: Damping = Damping { stiffness: 0.02, mass: 0.4 };

pub(crate) fn cases() -> Vec<Case> {
    vec![
        PLAIN,
        Case { name: "mass-damped", damping: Damping { mass: 0.7, ..LOST }, ..PLAIN },
        Case { name: "curved", curved: true, ..PLAIN },
        Case { name: "anisotropic and damped", anisotropic: true, damping: LOST, ..PLAIN },
        Case { name: "curved, held at both ends", curved: true, end: true, damping: LOST, ..PLAIN },
        Case { name: "spinning", anisotropic: true, curved: true, spins: true, damping: LOST, ..PLAIN },
        Case { name: "moved", moved: true, ..PLAIN },
        Case { name: "moved in a fluid", moved: true, drag: true, ..PLAIN },
        Case { name: "moved, curved and damped", moved: true, curved: true, damping: LOST, ..PLAIN },
        Case { name: "moved at both ends", moved: true, curved: true, anisotropic: true, end: true, ..PLAIN },
        Case { name: "moved at both ends and damped", moved: true, end: true, damping: LOST, ..PLAIN },
        Case { name: "no director held", curved: true, held: false, ..PLAIN },
    ]
}

pub(crate) fn rod(case: Case) -> Rod {
    let material = Material::new(1e6, 0.45, 1100.0);
    let section = if case.anisotropic {
        Section::ellipse(&material, 0.01, 0.007)
    } else {
        Section::circle(&material, 0.01)
    };
    let mut rod = Rod::uniform(1.0, SEGMENTS, &section).unwrap();
    rod.add_point_mass(1.0, 0.05).unwrap();
    if case.curved {
        rod = rod.naturally([0.4, -0.3], 0.2);
    }
    if case.spins {
        rod = rod.with_rotary_inertia(section.rotary_inertia(&material));
    }
    rod
}

pub(crate) fn supports(case: Case) -> Supports {
    let place = |t: f64| [0.05 * (5.0 * t).sin(), 0.0, 0.0];
    let (turning, face) = (|t: f64| [1.0, 2.0 * t, 0.3 * t], |t: f64| [0.3 * t, -t, 1.0]);
    let mut supports = if case.moved && case.held {
        Supports::clamped_start(Clamp::new(ClampAt::Face, DRIVE, turning, face))
    } else if case.held {
        Supports::clamped_start(Clamp::new(ClampAt::Edge, place, Vector3::x(), Vector3::z()))
    } else {
        Supports { prescribed: vec![(0, std::sync::Arc::new(place))], ..Supports::default() }
    };
    if case.end {
        let end = if case.moved && case.held { DRIVE.at(0.0).x + 0.93 } else { 0.93 };
        supports.end = Some(Clamp::new(ClampAt::Edge, [end, 0.1, 0.0], Vector3::x(), Vector3::z()));
    } else if case.moved {
        let near = straight(case, SEGMENTS - 2);
        supports.prescribed.push((SEGMENTS - 2, std::sync::Arc::new(near)));
    }
    supports
}

pub(crate) const DRIVE: EllipseDrive = EllipseDrive {
    centre: Vector3::new(0.0, 0.0, 0.0),
    radii: [0.04, 0.02],
    omega: 7.0,
    phase: 0.3,
    ramp: 0.0,
};

/// Where a vertex of the straight rod is.
pub(crate) fn straight(case: Case, vertex: usize) -> [f64; 3] {
    let s = rod(case).with_faces([true, false]).arc_lengths()[vertex];
    let start = DRIVE.at(0.0);
    [start.x + 0.99 * s, start.y + 0.05, start.z]
}

/// What moves the supports.
pub(crate) fn moves(case: Case) -> Vec<Parameter> {
    let linear = |of: HeldAt, by: MovedBy| {
        let change = Change { supports: vec![Moved { of, by }], ..Change::default() };
        Parameter { change, law: Law::Linear }
    };
    let drive = |radii, phase| MovedBy::Drive { drive: DRIVE, radii, phase };
    let along = |v: Vector3<f64>| {
        MovedBy::Along(Displacement(std::sync::Arc::new(move |t: f64| v * (1.0 + (30.0 * t).sin()) * 0.01)))
    };
    let turn = |v: Vector3<f64>, arm: Vector3<f64>| {
        let along = Displacement(std::sync::Arc::new(move |t: f64| v * (1.0 + (40.0 * t).sin())));
        MovedBy::TurnAlong { along, arm }
    };
    let mut all = vec![
        linear(HeldAt::Start, turn(Vector3::new(0.7, -0.4, 0.5), Vector3::new(0.02, 0.01, -0.03))),
        linear(HeldAt::Start, turn(Vector3::new(0.1, 0.9, 0.2), Vector3::new(0.02, 0.01, -0.03))),
        linear(HeldAt::Start, MovedBy::Turn(Vector3::x())),
        linear(HeldAt::Start, MovedBy::Turn(Vector3::y())),
        linear(HeldAt::Start, MovedBy::Turn(Vector3::new(0.1, 0.0, 1.0))),
        Parameter { law: Law::Exponential, ..linear(HeldAt::Start, drive([0.04, 0.0], 0.0)) },
        linear(HeldAt::Start, drive([0.0, 0.01], 0.0)),
        linear(HeldAt::Start, drive([0.0; 2], 1.0)),
        linear(HeldAt::Start, along(Vector3::new(1.0, 0.3, -0.4))),
    ];
    if !case.held {
        all = vec![linear(HeldAt::Vertex(0), along(Vector3::new(1.0, 0.3, -0.4)))];
    }
    if case.end {
        all.push(linear(HeldAt::End, MovedBy::Turn(Vector3::new(0.0, 1.0, 0.2))));
        all.push(linear(HeldAt::End, MovedBy::Turn(Vector3::z())));
        all.push(linear(HeldAt::End, turn(Vector3::new(0.3, -0.6, 1.0), Vector3::zeros())));
        all.push(linear(HeldAt::End, along(Vector3::new(-0.4, 1.0, 0.3))));
    } else {
        all.push(linear(HeldAt::Vertex(SEGMENTS - 2), along(Vector3::new(-0.4, 1.0, 0.3))));
    }
    all
}

/// Every kind of parameter that a case has.
pub(crate) fn unknowns(case: Case) -> Vec<Parameter> {
    let rod = rod(case);
    let none = Change::default;
    let exponential = |change: Change| Parameter { change, law: Law::Exponential };
    let linear = |change: Change| Parameter { change, law: Law::Linear };
    let mut tip = vec![0.0; SEGMENTS + 1];
    tip[SEGMENTS] = 0.02;
    let mut all = vec![
        exponential(Change { ea: rod.ea.clone(), ..none() }),
        exponential(Change { ei: rod.ei.clone(), ..none() }),
        exponential(Change { gj: rod.gj.clone(), ..none() }),
        exponential(Change { masses: rod.masses.clone(), spin_inertia: rod.spin_inertia.clone(), ..none() }),
        linear(Change { masses: tip, ..none() }),
        linear(Change { gravity: Vector3::new(0.0, 9.81, 0.0), ..none() }),
        linear(Change { gravity_turn: Vector3::x(), ..none() }),
        linear(Change { gravity_turn: Vector3::new(0.0, 1.0, 0.2), ..none() }),
    ];
    if case.damping.stiffness > 0.0 {
        let damping = Damping { stiffness: case.damping.stiffness, mass: 0.0 };
        all.push(exponential(Change { damping, ..none() }));
    }
    if case.damping.mass > 0.0 {
        let damping = Damping { stiffness: 0.0, mass: case.damping.mass };
        all.push(exponential(Change { damping, ..none() }));
    }
    if case.curved {
        let lengths = &rod.voronoi_lengths;
        let curvature = |c: [f64; 2]| lengths.iter().map(|l| c.map(|c| c * l)).collect();
        all.push(linear(Change { natural_curvature: curvature([1.0, 0.0]), ..none() }));
        all.push(linear(Change { natural_curvature: curvature([0.0, 1.0]), ..none() }));
        all.push(linear(Change { natural_twist: lengths.clone(), ..none() }));
    }
    if case.anisotropic {
        let ei2 = rod.ei.iter().map(|k| [0.0, 0.0, k[2]]).collect();
        all.push(exponential(Change { ei: ei2, ..none() }));
    }
    if case.moved {
        all.extend(moves(case));
    }
    all
}

pub(crate) const DOWN: Loads =
    Loads { gravity: Vector3::new(0.0, 0.0, -9.81), point_forces: Vec::new(), of_motion: Vec::new() };

pub(crate) fn loads(case: Case) -> Loads {
    let mut loads = DOWN;
    if case.drag {
        // past the rod the same way at all times: drag is once differentiable where it turns
        let flow = Vector3::new(3.0, 1.0, 0.4);
        let drag = Drag { fluid_density: 40.0, diameter: 0.02, normal: 1.2, tangential: 0.3, flow };
        loads.of_motion.push(std::sync::Arc::new(drag));
        loads.of_motion.push(std::sync::Arc::new(Dashpot(0.3)));
    }
    if case.pushed {
        let rod = rod(case);
        let across = FollowerForce::new(&rod, 0.7, |t: f64| [0.2 + t, -0.3, 0.1]).unwrap();
        let along = FollowerForce::tangential(&rod, 1.0, |t| -0.2 - t).unwrap();
        let turning = Moment::new(&rod, 0.55, |t: f64| [0.02, -0.03 - 0.1 * t, 0.04]).unwrap();
        let twisting = Moment::about_tangent(&rod, 1.0, |_| 0.03).unwrap();
        loads.of_motion.push(std::sync::Arc::new(across));
        loads.of_motion.push(std::sync::Arc::new(along));
        loads.of_motion.push(std::sync::Arc::new(turning));
        loads.of_motion.push(std::sync::Arc::new(twisting));
    }
    loads
}

pub(crate) fn step(case: Case, scheme: Scheme) -> RodStep {
    loaded_step(case, scheme, loads(case))
}

pub(crate) fn loaded_step(case: Case, scheme: Scheme, loads: Loads) -> RodStep {
    let unknown = unknowns(case);
    RodStep::with_parameters(rod(case), supports(case), loads, case.damping, unknown)
        .unwrap()
        .with_scheme(scheme)
}

/// A control off the straight shape, moving, its parameters not zero.
pub(crate) fn control(step: &RodStep) -> Vec<f64> {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, [1.0, 0.1, 0.0]).unwrap();
    let mut z = step.control_at_rest(&guess);
    let half = z.len() / 2;
    z.iter_mut().zip(noise(1)).enumerate().for_each(|(i, (z, e))| {
        *z += e * if i < half { 0.004 } else { 0.05 };
    });
    z.extend(noise(2).take(step.parameters()).map(|e| 0.2 * e));
    z
}
