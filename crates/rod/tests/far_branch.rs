//! Starts that differ by a hair stay on one branch of twist.

use varda_implicit::{ImplicitModel, Model};
use varda_rod::{Clamp, ClampAt, Damping, Loads, Rod, RodStep, Search, Section, Supports, Vector3, rest};

/// A number between −½ and ½ that looks drawn.
fn drawn(i: usize, scale: f64) -> f64 {
    let q = (i as f64 * scale + 4.1).sin() * 43758.5453;
    q - q.floor() - 0.5
}

/// Without a limit of an update's turns, twelve of these 59 rough motions end a turn or more away from the
/// others.
#[test]
fn rough_motions_of_an_anisotropic_rod_end_on_one_branch_of_twist() {
    let section = Section { ea: 1e4, ei1: 1e-3, ei2: 3e-3, gj: 1e-3, mass_per_length: 0.1 };
    let rod = Rod::uniform(1.0, 20, &section).unwrap();
    let clamp = Clamp::new(ClampAt::Edge, Vector3::zeros(), Vector3::new(0.3, 0.0, -1.0), Vector3::y());
    let supports = Supports::clamped_start(clamp);
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    let base = rest(&rod, &supports, &loads, 0.0, &Search::default()).unwrap().rest;
    let ends = (0..59).map(|k| {
        let step = RodStep::new(rod.clone(), supports.clone(), loads.clone(), Damping::default()).unwrap();
        let mut z = step.control_at_rest(&base);
        let half = z.len() / 2;
        for i in 0..half {
            z[i] += 0.02 * drawn(i, 12.9898) + 2e-5 * drawn(59 * i + k, 78.233);
            z[half + i] = 0.5 * (7.0 * i as f64).sin();
        }
        let mut model = ImplicitModel::new(step, 0, 2e-3);
        let mut x = vec![0.0; model.dim()];
        let mut next = x.clone();
        model.initial_state(&z, &mut x).unwrap();
        for k in 0..20 {
            model.step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
        }
        x.split_off(2 * half)
    });
    let ends: Vec<Vec<f64>> = ends.collect();
    let middle = |i: usize| {
        let mut all: Vec<f64> = ends.iter().map(|e| e[i]).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let middles: Vec<f64> = (0..ends[0].len()).map(middle).collect();
    let far = |end: &&Vec<f64>| end.iter().zip(&middles).any(|(a, b)| !((a - b).abs() <= 1.0));
    assert_eq!(ends.iter().filter(far).count(), 0);
}
