//! Rods at rest wherever they are held: elastica, hanging cables, coils, shapes that were measured.

use std::f64::consts::PI;
use std::sync::Arc;

use varda_implicit::{ImplicitModel, Model};
use varda_rod::{
    Clamp, ClampAt, Damping, Found, Loads, Rest, Rod, RodStep, Search, Section, Supports, Vector3, rest,
};

fn section(ea: f64, ei: f64) -> Section {
    Section { ea, ei1: ei, ei2: ei, gj: ei, mass_per_length: 0.1 }
}

fn between(start: (Vector3<f64>, Vector3<f64>), end: (Vector3<f64>, Vector3<f64>)) -> Supports {
    let side = Vector3::z();
    let clamp = |(x, t): (Vector3<f64>, Vector3<f64>)| Some(Clamp::new(ClampAt::Edge, x, t, side));
    Supports { start: clamp(start), end: clamp(end), ..Supports::default() }
}

fn hooks(rod: &Rod, places: &[(usize, [f64; 3])]) -> Supports {
    assert!(places.iter().all(|p| p.0 <= rod.segments()));
    let prescribed = places.iter().map(|&(v, x)| (v, Arc::new(x) as Arc<dyn varda_rod::Motion>)).collect();
    Supports { prescribed, ..Supports::default() }
}

fn weight() -> Loads {
    Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() }
}

/// Complete elliptic integrals K and E of the parameter m, by the arithmetic-geometric mean.
fn elliptic(m: f64) -> (f64, f64) {
    let (mut a, mut b, mut sum, mut power) = (1.0f64, (1.0 - m).sqrt(), 0.5 * m, 0.5);
    for _ in 0..12 {
        let c = 0.5 * (a - b);
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
        power *= 2.0;
        sum += power * c * c;
    }
    let k = PI / (2.0 * a);
    (k, k * (1.0 - sum))
}

/// Height of the elastica between two clamps in line: √m L/K with 2E/K − 1 = D/L.
fn elastica_height(length: f64, distance: f64) -> f64 {
    let (mut low, mut high) = (0.0, 0.999);
    for _ in 0..60 {
        let m = 0.5 * (low + high);
        let (k, e) = elliptic(m);
        if 2.0 * e / k - 1.0 > distance / length { low = m } else { high = m }
    }
    low.sqrt() * length / elliptic(low).0
}

#[test]
fn two_grippers_nearer_than_the_length_hold_the_elastica() {
    for share in [0.55, 0.7, 0.8, 0.9, 0.95, 0.99] {
        let error = [40usize, 80].map(|n| {
            // the held edges bend nothing: the elastica runs between their middles
            let h = 1.0 / n as f64;
            let rod = Rod::uniform(1.0, n, &section(1e6, 1e-3)).unwrap();
            let distance = share * (1.0 - h) + h;
            let supports = between((Vector3::zeros(), Vector3::x()), (Vector3::x() * distance, Vector3::x()));
            let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default()).unwrap();
            let height = found.rest.vertices.iter().map(|x| x.y.hypot(x.z)).fold(0.0, f64::max);
            (height - elastica_height(1.0 - h, share * (1.0 - h))).abs()
        });
        assert!(error[1] <= 4e-4, "D/L {share}: {error:?}");
        assert!((error[0] / error[1] - 4.0).abs() <= 0.6, "D/L {share}: {error:?}");
    }
}

#[test]
fn slack_cables_find_their_catenary_and_do_not_ask_how_stiff_they_are() {
    for (ea, ei, end) in
        [(1e4, 1e-4, [1.0, 0.0, 0.4]), (1e5, 1e-6, [0.3, 0.0, -0.2]), (1e6, 0.0, [1.2, 0.0, 0.0])]
    {
        let rod = Rod::uniform(1.5, 40, &section(ea, ei)).unwrap();
        let supports = hooks(&rod, &[(0, [0.0; 3]), (40, end)]);
        let found = rest(&rod, &supports, &weight(), 0.0, &Search::default()).unwrap();
        // the horizontal pull of a cable is the same along it: x' / l of every edge times its tension
        let pull = |e: usize| {
            let d = found.rest.vertices[e + 1] - found.rest.vertices[e];
            ea * (d.norm() / rod.rest_lengths[e] - 1.0) * d.x / d.norm()
        };
        let reference = pull(20);
        assert!(reference > 0.0);
        for e in 5..35 {
            assert!((pull(e) - reference).abs() <= 0.02 * reference, "edge {e}: {} {reference}", pull(e));
        }
    }
}

#[test]
fn a_deep_arch_is_a_saddle_and_is_left_for_a_lower_shape_out_of_its_plane() {
    let rod = Rod::uniform(1.0, 40, &section(1e4, 1e-3)).unwrap();
    let supports = between((Vector3::zeros(), Vector3::x()), (Vector3::x() * 0.2, Vector3::x()));
    let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default()).unwrap();
    // how far the vertices lie from the best plane through the chord
    let moment = found
        .rest
        .vertices
        .iter()
        .fold([0.0; 3], |m, x| [m[0] + x.y * x.y, m[1] + x.y * x.z, m[2] + x.z * x.z]);
    let least = 0.5
        * (moment[0] + moment[2] - ((moment[0] - moment[2]).powi(2) + 4.0 * moment[1] * moment[1]).sqrt());
    assert!(least > 1e-2, "it stayed in a plane: {least}");
}

#[test]
fn coils_start_from_their_natural_curvature() {
    for (curvature, twist) in [(15.0, 0.0), (30.0, 10.0), (60.0, 5.0)] {
        let rod = Rod::uniform(1.0, 200, &section(1e4, 1e-3)).unwrap().naturally([curvature, 0.0], twist);
        let supports =
            Supports::clamped_start(Clamp::new(ClampAt::Edge, Vector3::zeros(), Vector3::z(), Vector3::x()));
        let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default()).unwrap();
        assert!(found.energy.abs() <= 1e-16, "{}", found.energy);
        let chord = (found.rest.vertices[200] - found.rest.vertices[0]).norm();
        let rate = f64::hypot(curvature, twist);
        let (radius, climb) = (curvature / (rate * rate), twist / rate);
        let expected = f64::hypot(2.0 * radius * (0.5 * rate).sin(), climb);
        assert!((chord - expected).abs() <= 5e-3, "{chord} {expected}");
        // its angles are handed on: the first step moves nothing
        let step = RodStep::new(rod, supports, Loads::default(), Damping::default()).unwrap();
        let control = step.control_at_rest(&found.rest);
        let mut model = ImplicitModel::new(step.starting_from(&found.rest, 0.0), 0, 1e-3);
        let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&control, &mut x).unwrap();
        model.step(0, &x, &mut next).unwrap();
        let moved = x.iter().zip(&next).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(moved <= 1e-6, "{moved}");
    }
}

/// Supports carry the weight: the sums of forces, and of moments about the origin, are zero.
fn balanced(rod: &Rod, found: &Found) {
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    for (x, m) in found.rest.vertices.iter().zip(&rod.masses) {
        force += weight().gravity * *m;
        moment += x.cross(&(weight().gravity * *m));
    }
    let most = force.norm();
    for r in &found.reactions {
        force += r.force;
        moment += r.moment + found.rest.vertices[r.vertex].cross(&r.force);
    }
    assert!(force.norm() <= 1e-7 * most && moment.norm() <= 1e-7 * most, "{force} {moment}");
}

#[test]
fn several_hooks_a_hook_inside_and_none() {
    let rod = Rod::uniform(2.0, 40, &section(1e4, 1e-3)).unwrap();
    let three = hooks(&rod, &[(0, [0.0; 3]), (20, [0.7, 0.2, 0.1]), (40, [1.2, 0.0, 0.0])]);
    let found = rest(&rod, &three, &weight(), 0.0, &Search::default()).unwrap();
    assert!(found.rest.vertices[10].z < -0.2 && found.rest.vertices[30].z < -0.2);
    balanced(&rod, &found);
    let middle = hooks(&rod, &[(20, [0.0; 3])]);
    let found = rest(&rod, &middle, &weight(), 0.0, &Search::default()).unwrap();
    assert!(found.rest.vertices[0].z < -0.5 && found.rest.vertices[40].z < -0.5);
    balanced(&rod, &found);
    let side = between((Vector3::zeros(), Vector3::x()), (Vector3::new(0.8, 0.4, 0.3), Vector3::y()));
    balanced(&rod, &rest(&rod, &side, &weight(), 0.0, &Search::default()).unwrap());
    let error = rest(&rod, &Supports::default(), &weight(), 0.0, &Search::default()).unwrap_err();
    assert!(error.to_string().contains("nothing holds the rod"), "{error}");
}

#[test]
fn a_first_shape_picks_the_branch_and_a_measured_one_is_at_ease() {
    // a ruler, soft towards z: bowed up or down, nothing between
    let rod = Rod::uniform(1.0, 40, &Section { ei2: 10.0, ..section(1e6, 1e-1) }).unwrap();
    let supports = between((Vector3::zeros(), Vector3::x()), (Vector3::x() * 0.8, Vector3::x()));
    for side in [1.0, -1.0] {
        let bow = |u: f64| Vector3::new(0.8 * u, 0.0, side * 0.3 * (PI * u).sin().powi(2));
        let points: Vec<_> = (0..=12).map(|i| bow(i as f64 / 12.0)).collect();
        let search = Search::default().with_initial_shape(Rest::through(&rod, &points).unwrap());
        let found = rest(&rod, &supports, &Loads::default(), 0.0, &search).unwrap();
        assert!(found.rest.vertices[20].z * side > 0.1, "{}", found.rest.vertices[20]);
    }
    // the same points where they are said to be along the rod, a few of them
    let bow = |u: f64| Vector3::new(0.8 * u, 0.0, 0.3 * (PI * u).sin().powi(2));
    let (places, points): (Vec<_>, Vec<_>) =
        [0.2, 0.35, 0.5, 0.65, 0.8].map(|u| (u, bow(u))).into_iter().unzip();
    let shape = Rest::through_at(&rod, &places, &points).unwrap();
    assert!((shape.vertices[20] - points[2]).norm() <= 1e-12, "{}", shape.vertices[20]);
    let on = shape.vertices[0] - points[0];
    assert!((on.norm() - 0.2).abs() <= 1e-12, "straight on for the rest: {on}");
    let search = Search::default().with_initial_shape(shape);
    let found = rest(&rod, &supports, &Loads::default(), 0.0, &search).unwrap();
    assert!(found.rest.vertices[20].z > 0.1, "{}", found.rest.vertices[20]);
    let helix = |u: f64| Vector3::new(0.1 * (4.0 * u).sin(), 0.1 - 0.1 * (4.0 * u).cos(), 0.3 * u);
    let points: Vec<_> = (0..=60).map(|i| helix(i as f64 / 30.0)).collect();
    let shape = Rest::through(&rod, &points).unwrap().vertices;
    let t = (shape[1] - shape[0]).normalize();
    let cable = rod.at_ease_in(&shape, Vector3::z()).unwrap();
    let clamp = Supports::clamped_start(Clamp::new(ClampAt::Edge, shape[0], t, Vector3::z()));
    let found = rest(&cable, &clamp, &Loads::default(), 0.0, &Search::default()).unwrap();
    for (x, y) in found.rest.vertices.iter().zip(&shape) {
        // edges of a resampled curve are a little shorter than its arcs, so places differ along the curve
        assert!((x - y).norm() <= 2e-2, "{x} {y}");
    }
}
