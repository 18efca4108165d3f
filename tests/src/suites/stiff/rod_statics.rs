//! Statics at the edges: slack and taut chains, columns pushed together.

use super::common::{refused, statics, work};
use super::rod_shapes::{DOWN, SILICONE, chain, fixed_clamp, held, run_from, weight};
use crate::row::Rows;
use problems::counted::Counted;
use std::f64::consts::{PI, TAU};
use varda_implicit::ImplicitModel;
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Rest, Rod, RodStep, Section, Supports, Vector3, equilibrium,
};

pub(super) fn run(rows: &mut Rows) {
    slack(rows);
    buckled(rows);
    pushed(rows);
}

/// A chain hung slack between two points: the discrete catenary. Its tension has one horizontal component H;
/// with V₀ at the first edge and equal masses m the tension of edge e is (H, V₀ − e m g), which gives
/// every place; H and V₀ are found by bisection.
fn slack(rows: &mut Rows) {
    for (name, ends) in [("chain", 0.6), ("nearly taut chain", 0.999), ("slack chain", 0.05)] {
        rows.case(&format!("{name}, ends {ends} L apart"), |case| {
            let n = 60;
            let rod = Rod::uniform(1.0, n, &chain())?;
            let supports = Supports {
                prescribed: vec![held(0, [0.0; 3]), held(n, [ends, 0.0, 0.0])],
                ..Supports::default()
            };
            // a V that hangs through, longer than the ends are apart
            let depth = (0.25_f64 - 0.25 * ends * ends).sqrt();
            let along = |e: usize| if e < n / 2 { -1.0 } else { 1.0 };
            let mut guess = vec![Vector3::zeros()];
            for e in 0..n {
                let last = guess[e];
                guess.push(last + Vector3::new(ends / n as f64, 0.0, along(e) * depth * 2.0 / n as f64));
            }
            let guess = Rest { vertices: guess, theta: vec![0.0; n] };
            let (rest, report) = equilibrium(&rod, &supports, &weight(), 0.0, &guess)?;
            let (mg, l, ea) = (rod.masses[1] * 9.81, rod.rest_lengths[0], rod.ea[0]);
            let vertical = 0.5 * (n - 1) as f64 * mg;
            let span = |h: f64| {
                (0..n).map(move |e| {
                    let v = vertical - e as f64 * mg;
                    let t = h.hypot(v);
                    let stretched = l * (1.0 + t / ea);
                    (stretched * h / t, -stretched * v / t)
                })
            };
            let (mut low, mut high) = (1e-9, 1e4);
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if span(middle).map(|d| d.0).sum::<f64>() < ends { low = middle } else { high = middle }
            }
            let (mut x, mut z, mut error) = (0.0, 0.0, 0.0_f64);
            for (e, (dx, dz)) in span(low).enumerate() {
                (x, z) = (x + dx, z + dz);
                let p = rest.vertices[e + 1];
                error = error.max((p[0] - x).abs()).max((p[2] - z).abs());
            }
            let (work, note) = statics(&report);
            case.at_most("distance from the discrete catenary", error, 1e-10, "m")
                .because("statics end with an update below 1e-11 L; the reference is sixty sums")
                .work(work)
                .note(note);
            Ok(())
        });
    }
}

/// A column clamped at both ends and pushed together: it must leave the straight saddle. The elastica's first
/// mode at a small end-shortening δ has the amplitude a = (2L/π) √(δ/L) (inextensible; next order 1 +
/// O(δ/L)).
fn buckled(rows: &mut Rows) {
    for shortening in rows.grid("columns pushed together", [0.01, 0.1, 0.3]) {
        rows.case(&format!("column pushed together by {:.0} %", 100.0 * shortening), |case| {
            let n = 80;
            let thin = Section::circle(&SILICONE, 0.001);
            let rod = Rod::uniform(1.0, n, &thin)?;
            let end = Clamp::new(ClampAt::Edge, [0.0, 0.0, -(1.0 - shortening)], DOWN, [1.0, 0.0, 0.0]);
            let supports = Supports { start: Some(fixed_clamp()), end: Some(end), ..Supports::default() };
            let l = 1.0 / n as f64;
            // evenly compressed, and exactly straight or bowed as far as the elastica is
            let inner = (1.0 - shortening - 2.0 * l) / (n - 2) as f64;
            let z = |v: usize| if v <= 1 { v as f64 * l } else { l + inner * (v - 1) as f64 };
            let guess = |bow: f64| {
                let aside = |v: usize| bow * 0.5 * (1.0 - (TAU * (v as f64 - 0.5) / (n - 1) as f64).cos());
                let free = |v: usize| if (2..=n - 2).contains(&v) { aside(v) } else { 0.0 };
                let vertices = (0..=n).map(|v| Vector3::new(free(v), 0.0, -z(v))).collect();
                Rest { vertices, theta: vec![0.0; n] }
            };
            let expected = clamped_elastica(shortening);
            let reason = "the discrete clamps reach half a segment further in than clamps do: some 0.6/n of \
                the amplitude, twice that allowed";
            // from the straight saddle, up to thirty thousand times beyond the critical load, and from a bow
            for (from, bow) in [("from the straight saddle", 0.0), ("from a bow", expected)] {
                match equilibrium(&rod, &supports, &Loads::default(), 0.0, &guess(bow)) {
                    Ok((rest, report)) => {
                        let amplitude = rest.vertices.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
                        let (work, note) = statics(&report);
                        let error = (amplitude / expected - 1.0).abs();
                        let what = format!("{from}: amplitude, relative error against the elastica");
                        case.at_most(&what, error, 0.015, "-")
                            .because(reason)
                            .computed(amplitude)
                            .work(work)
                            .note(note);
                    }
                    // Newton's way from the saddle may be longer than it is allowed to be, from a bow it is
                    // not
                    Err(error) => {
                        let names = if bow == 0.0 { "step 0" } else { "no error" };
                        refused(
                            case,
                            &format!(
                                "{from}: refused, naming the \
                            step"
                            ),
                            Err::<(), _>(error),
                            names,
                        );
                    }
                }
            }
            Ok(())
        });
    }
}

/// The same column in motion: its end clamp moves in within a second, the rod is exactly straight, and what
/// follows is damped (α = 2/s). It must leave the straight saddle, and all others in time, and end in the
/// first mode.
fn pushed(rows: &mut Rows) {
    let pushed = [(0.01, 1.0), (0.1, 1.0), (0.3, 1.0), (0.01, 0.02), (0.1, 0.02), (0.3, 0.02)];
    for (shortening, dt) in rows.grid("columns pushed together in time", pushed) {
        let name =
            format!("column pushed together by {:.0} % within 1 s, steps of {dt} s", 100.0 * shortening);
        rows.case(&name, |case| {
            let n = 40;
            let rod = Rod::uniform(1.0, n, &Section::circle(&SILICONE, 0.001))?;
            let end = Clamp::new(
                ClampAt::Edge,
                move |t: f64| [0.0, 0.0, shortening * t.min(1.0) - 1.0],
                DOWN,
                [1.0, 0.0, 0.0],
            );
            let supports = Supports { start: Some(fixed_clamp()), end: Some(end), ..Supports::default() };
            let damping = Damping { mass: 2.0, ..Damping::default() };
            let step = RodStep::new(rod, supports, Loads::default(), damping)?;
            let mut model = Counted::new(ImplicitModel::new(step, 0, dt));
            let straight: Vec<[f64; 3]> = (0..=n).map(|v| [0.0, 0.0, -(v as f64) / n as f64]).collect();
            match run_from(&mut model, &straight, (100.0 / dt) as usize) {
                Ok(x) => {
                    let places = x[..3 * (n - 3)].chunks_exact(3);
                    let amplitude = places.map(|x| x[0].hypot(x[1])).fold(0.0, f64::max);
                    let error = (amplitude / clamped_elastica(shortening) - 1.0).abs();
                    case.at_most(
                        "amplitude after 100 s, relative error against the \
                        elastica",
                        error,
                        0.03,
                        "-",
                    )
                    .because(
                        "the discrete clamps reach half a segment further in than clamps do: some 0.6/n \
                                of the amplitude, twice that allowed",
                    )
                    .computed(amplitude)
                    .work(work(&model, f64::NAN));
                }
                Err(error) => refused(case, "refused, naming the step", Err::<(), _>(error), "step 0"),
            }
            Ok(())
        });
    }
}

/// Amplitude over L of the first mode of an inextensible column clamped at both ends: four quarter waves of
/// the elastica with modulus p, shortening 2 − 2 E(p)/K(p), amplitude p/K(p).
fn clamped_elastica(shortening: f64) -> f64 {
    let integrals = |p: f64| {
        // midpoint sums over a period of smooth functions: exact to rounding at 200 points
        let points = 400;
        let step = 0.5 * PI / points as f64;
        (0..points).fold((0.0, 0.0), |(k, e), i| {
            let root = (1.0 - (p * (step * (i as f64 + 0.5)).sin()).powi(2)).sqrt();
            (k + step / root, e + step * root)
        })
    };
    let (mut low, mut high) = (1e-9_f64, 0.9999);
    for _ in 0..100 {
        let p = 0.5 * (low + high);
        let (k, e) = integrals(p);
        if 2.0 - 2.0 * e / k < shortening { low = p } else { high = p }
    }
    low / integrals(low).0
}
