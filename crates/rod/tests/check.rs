//! The checks for users hold on what this crate ships.

use varda_implicit::{At, check};
use varda_rod::{
    Clamp, Damping, Loads, Marker, Markers, Material, Matrix3, Rod, RodStep, Section, Supports, Vector3,
};

fn step() -> RodStep {
    let rod = Rod::uniform(1.0, 10, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
    let supports = Supports::clamped_start(Clamp::new([0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]));
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
        let report = check::operator(&mut markers, At { step: 0, time: 0.0 }, &state, &scale, 2).unwrap();
        assert!(report.passed(), "{report}");
    }
}
