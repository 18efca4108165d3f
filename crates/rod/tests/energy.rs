//! Energy, gradient and Hessian against 50-digit fixtures.

use serde_json::Value;
use varda_rod::{Framed, Rod, Vector3, derivatives};

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().expect("an array").iter().map(|x| x.as_f64().expect("a number")).collect()
}

fn triples(v: &Value) -> Vec<Vector3<f64>> {
    v.as_array().expect("an array").iter().map(|x| Vector3::from_vec(numbers(x))).collect()
}

fn largest(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |m: f64, x| m.max(x.abs()))
}

fn check(text: &str) {
    let f: Value = serde_json::from_str(text).expect("JSON");
    let name = f["name"].as_str().expect("a name");
    let n = f["n_edges"].as_u64().expect("a count") as usize;
    let matrices = f["EI"].as_array().expect("an array").iter();
    let rod = Rod {
        rest_lengths: numbers(&f["rest_lengths"]),
        voronoi_lengths: numbers(&f["voronoi_lengths"]),
        ea: numbers(&f["EA"]),
        ei: matrices
            .map(|m| [m[0][0].as_f64().unwrap(), m[0][1].as_f64().unwrap(), m[1][1].as_f64().unwrap()])
            .collect(),
        gj: numbers(&f["GJ"]),
        natural_curvature: f["kappa_bar"]
            .as_array()
            .unwrap()
            .iter()
            .map(|k| numbers(k).try_into().unwrap())
            .collect(),
        natural_twist: numbers(&f["tau_bar"]),
        masses: vec![1.0; n + 1],
        spin_inertia: Vec::new(),
    };
    let (vertices, directors) = (triples(&f["vertices"]), triples(&f["ref_d1"]));
    let (reference_twist, theta) = (numbers(&f["ref_twist"]), numbers(&f["theta"]));
    let at = Framed {
        vertices: &vertices,
        directors: &directors,
        reference_twist: &reference_twist,
        theta: &theta,
    };
    let ours = derivatives(&rod, &at).expect("a sound configuration");

    // Tolerances as stated with the fixtures: rounding of float64 inputs, looser where edges are almost
    // folded.
    let loose = if name.contains("folded") { 10.0 } else { 1.0 };
    let total = f["energy"]["total"].as_f64().unwrap();
    let scale: f64 = rod.ea.iter().zip(&rod.rest_lengths).map(|(a, l)| a * l).sum();
    let error = (ours.energy.total() - total).abs();
    assert!(
        error <= 1e-12 * loose * total.abs().max(1e-12 * scale),
        "{name}: energy off by {error:e} of {total:e}"
    );

    let gradient = numbers(&f["gradient"]["total"]);
    let bound = (1e-10 * loose * largest(&gradient)).max(1e-13 * largest(&rod.ea));
    for (i, (a, b)) in ours.gradient.iter().zip(&gradient).enumerate() {
        assert!((a - b).abs() <= bound, "{name}: gradient {i} is {a:e}, expected {b:e}");
    }

    let full = 4 * n + 3;
    let mut hessian = vec![0.0; full * full];
    for part in ["stretch", "bend", "twist"] {
        for entry in f["hessian_lower_coo"][part].as_array().unwrap() {
            let (i, j) = (entry[0].as_u64().unwrap() as usize, entry[1].as_u64().unwrap() as usize);
            hessian[i + j * full] += entry[2].as_f64().unwrap();
            if i != j {
                hessian[j + i * full] += entry[2].as_f64().unwrap();
            }
        }
    }
    let bound = 1e-10 * loose * largest(&hessian);
    for (i, (a, b)) in ours.hessian.iter().zip(&hessian).enumerate() {
        assert!(
            (a - b).abs() <= bound,
            "{name}: Hessian ({}, {}) is {a:e}, expected {b:e}",
            i % full,
            i / full
        );
    }
    // The check can fail: one entry off by a thousandth is seen.
    let k = (0..hessian.len()).max_by(|&a, &b| hessian[a].abs().total_cmp(&hessian[b].abs())).unwrap();
    assert!(!((ours.hessian[k] * 1.001 - hessian[k]).abs() <= bound), "{name}: the check is blind");
}

macro_rules! fixtures {
    ($($name:ident),*) => { $(#[test] fn $name() {
        check(include_str!(concat!("../../../tests/fixtures/der/", stringify!($name), ".json")));
    })* };
}

fixtures!(
    aniso_natural_7,
    curved_iso_5,
    large_theta_6,
    near_folded_170_4,
    nonuniform_stretched_12,
    slender_1e4_8,
    straight_rest_3
);
