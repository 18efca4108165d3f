//! The checks for users hold on what this crate ships, and find every single fault of a load.

use nalgebra::{Matrix6, Vector6};
use std::ops::Range;
use varda_implicit::At;
use varda_rod::{
    Clamp, ClampAt, Damping, EdgeLoad, EdgeMotion, Load, Loads, Marker, Markers, Material, Matrix3, Rod,
    RodStep, Section, Supports, Vector3, check,
};

fn step() -> RodStep {
    let rod = Rod::uniform(1.0, 10, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
    let supports =
        Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]));
    RodStep::new(rod, supports, Loads::default(), Damping::default()).unwrap()
}

#[test]
fn markers_on_and_off_the_centreline_pass() {
    let step = step();
    let on = Marker { s: 0.37, offset: Vector3::zeros() };
    let off = Marker { s: 0.83, offset: Vector3::new(0.02, -0.01, 0.005) };
    let turned = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    // a bent rod, at rest
    let mut state: Vec<f64> = (2..=10)
        .flat_map(|v| {
            let s = 0.1 * f64::from(v);
            [s - 0.05 * s * s, 0.1 * s * s, 0.2 * s.powi(3)]
        })
        .collect();
    state.resize(54, 0.0);
    state.resize(varda_implicit::ImplicitStep::dim(&step), 0.03);
    for markers in [vec![on], vec![on, off], vec![off]] {
        let markers = Markers::new(&step, &markers).unwrap();
        let mut markers = markers.in_axes(turned, Vector3::new(1.0, 2.0, 3.0)).unwrap();
        let scale = vec![1e-3; state.len()];
        let report =
            varda_implicit::check::operator(&mut markers, At { step: 0, time: 0.0 }, &state, &scale, 2)
                .unwrap();
        assert!(report.passed(), "{report}");
    }
}

/// A spring ½ k (|e| − l̄)² along the edge in a field ½ q |x|² of its second vertex (with a
/// potential), or drag c V |V| on both vertices (without one), with a fault.
struct Mutant {
    drag: bool,
    fault: &'static str,
}

const STIFFNESS: f64 = 7.0;
const FIELD: f64 = 0.3;

impl Mutant {
    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    fn spring(&self, motion: &EdgeMotion) -> EdgeLoad {
        let e = motion.places[1] - motion.places[0];
        let (l, t) = (e.norm(), e.normalize());
        let pull = STIFFNESS * (l - motion.rest_length);
        let hessian =
            (t * t.transpose()) * STIFFNESS + (Matrix3::identity() - t * t.transpose()) * (pull / l);
        let outward = motion.places[1] * FIELD;
        let mut load = EdgeLoad::zero();
        load.energy = 0.5 * STIFFNESS * (l - motion.rest_length).powi(2)
            + 0.5 * FIELD * motion.places[1].norm_squared();
        load.forces.fixed_rows_mut::<3>(0).copy_from(&(t * pull));
        load.forces.fixed_rows_mut::<3>(3).copy_from(&(-t * pull - outward));
        for (i, j, sign) in [(0, 0, -1.0), (0, 3, 1.0), (3, 0, 1.0), (3, 3, -1.0)] {
            load.by_places.fixed_view_mut::<3, 3>(i, j).copy_from(&(hessian * sign));
        }
        (3..6).for_each(|i| load.by_places[(i, i)] -= FIELD);
        load
    }

    fn drag(motion: &EdgeMotion) -> EdgeLoad {
        let mut load = EdgeLoad::zero();
        for (v, velocity) in motion.velocities.iter().enumerate() {
            let speed = velocity.norm();
            let by = Matrix3::identity() * speed + velocity * velocity.transpose() / speed;
            load.forces.fixed_rows_mut::<3>(3 * v).copy_from(&(velocity * -speed));
            load.by_velocities.fixed_view_mut::<3, 3>(3 * v, 3 * v).copy_from(&-by);
        }
        load
    }
}

impl Load for Mutant {
    fn has_potential(&self) -> bool {
        !self.drag || self.is("claims a potential")
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        if self.is("beyond") { 2..segments + 1 } else { 2..segments }
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let mut load = if self.drag { Self::drag(motion) } else { self.spring(motion) };
        match self.fault {
            "Jacobian" => load.by_places[(4, 2)] *= 1.01,
            "unsymmetric" => {
                // an entry of a force and its derivative: right as a force, no potential
                load.forces[4] += 1e-3 * motion.places[0].x;
                load.by_places[(4, 0)] += 1e-3;
            }
            "energy" => load.energy *= 1.01,
            "sign" => load.energy = -load.energy,
            "of velocity" => load.forces += Vector6::repeat(1e-9 * motion.velocities[0].x),
            "damping" => load.by_velocities = Matrix6::identity() * 1e-3,
            "finite" => load.forces[1] = f64::NAN,
            "energy of drag" => load.energy = 1.0,
            _ => {}
        }
        load
    }
}

#[test]
fn every_single_fault_of_a_load_is_found_and_named() {
    let rod = Rod::uniform(0.8, 40, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
    let of = |drag, fault| check::load(&Mutant { drag, fault }, &rod, 0.3, 0.5, 7).unwrap();
    for drag in [false, true] {
        let sound = of(drag, "");
        assert!(sound.passed(), "{sound}");
    }
    for (drag, fault, finding) in [
        (false, "beyond", "edges beyond the rod"),
        (false, "Jacobian", "slope of ∂F/∂(places)"),
        (false, "unsymmetric", "symmetry of ∂F/∂(places)"),
        (false, "unsymmetric", "slope of the potential"),
        (false, "energy", "slope of the potential"),
        (false, "sign", "slope of the potential"),
        (false, "of velocity", "values that depend on velocities"),
        (false, "damping", "slope of ∂F/∂(velocities)"),
        (true, "damping", "slope of ∂F/∂(velocities)"),
        (false, "finite", "values not finite"),
        (true, "claims a potential", "values that depend on velocities"),
        (true, "energy of drag", "energy of a load without potential"),
    ] {
        let report = of(drag, fault);
        assert!(report.failed().any(|f| f.what.contains(finding)), "{fault}:\n{report}");
    }
}
