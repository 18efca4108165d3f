//! Checks of a load of your own: are its derivatives those of its forces, and has it the potential it claims?

use nalgebra::{Vector3, Vector6};
use varda_implicit::Error;
use varda_implicit::check::{Random, differing, taylor};

use crate::geometry::{Turn, any_perpendicular};
use crate::load::{EdgeLoad, EdgeMotion, Load, second_along_each};
use crate::rod::Rod;

pub use varda_implicit::check::{Finding, Report};

/// Share of the largest entry of ∂F/∂(places) by which two mirror images may differ: some thousand
/// roundings.
const SYMMETRY: f64 = 1e-12;
/// Share of the largest second derivative by which two ways to it may differ: divided by lengths twice.
const SECOND: f64 = 1e-11;

/// Every check of a load, on the first, the middle and the last of its edges: they are edges of the rod; same
/// input, same result; all values are finite; ∂F/∂(places), ∂F/∂(velocities) and ∂F/∂θ are
/// derivatives of the forces, and those of the moment are its own (Taylor), directors being carried with the
/// edge; second derivatives, where there are any, are derivatives of all of that; without
/// [`Load::uses_directors`] nothing depends on them, without [`Load::has_moment`] there is none. Of a load
/// that says it has a potential: F = −∂W/∂(places) and m = −∂W/∂θ (Taylor), ∂F/∂(places)
/// is symmetric (but for the part that carried directors bring), and nothing depends on velocities. Of one
/// without: its energy is zero.
///
/// A load that claims a potential which it has not is not found while a rod moves: a symmetric band keeps one
/// half of its Jacobian, and Newton's method looks for a minimum that is none.
///
/// Edges are drawn from `seed` in any direction, stretched by at most a tenth, within a length of the rod
/// from the origin, with velocities of the size of `speed` \[m/s\], at time `time` \[s\].
///
/// ```
/// use nalgebra::Matrix6;
/// use varda_rod::{EdgeLoad, EdgeMotion, Load, Material, Rod, Section, check};
///
/// /// A force on the second vertex, across the edge: F = k ẑ × e. It claims a potential.
/// struct Across(f64);
///
/// impl Load for Across {
///     fn has_potential(&self) -> bool {
///         true
///     }
///     fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
///         let e = motion.places[1] - motion.places[0];
///         let mut load = EdgeLoad::zero();
///         (load.forces[3], load.forces[4]) = (-self.0 * e.y, self.0 * e.x);
///         (load.by_places[(3, 1)], load.by_places[(3, 4)]) = (self.0, -self.0);
///         (load.by_places[(4, 0)], load.by_places[(4, 3)]) = (-self.0, self.0);
///         load
///     }
/// }
///
/// let rod = Rod::uniform(1.0, 10, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// let report = check::load(&Across(3.0), &rod, 0.0, 1.0, 1)?;
/// assert!(report.failed().any(|f| f.what.contains("symmetry of ∂F/∂(places)")), "{report}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::EmptyTest`] where a Taylor test finds no range of steps between truncation and rounding.
pub fn load(load: &dyn Load, rod: &Rod, time: f64, speed: f64, seed: u64) -> Result<Report, Error> {
    let edges = load.edges(rod.segments());
    let outside = edges.end.saturating_sub(rod.segments());
    let mut findings = vec![Finding::at_most("edges beyond the rod", outside as f64, 0.0)];
    if outside > 0 || edges.is_empty() {
        return Ok(Report { findings });
    }
    let mut random = Random(seed);
    let mut chosen = vec![edges.start, (edges.start + edges.end) / 2, edges.end - 1];
    chosen.dedup();
    for edge in chosen {
        let found = on_edge(load, rod, edge, [time, speed], &mut random)?;
        findings.extend(found.into_iter().map(|finding| finding.of(&format!("edge {edge}"))));
    }
    Ok(Report { findings })
}

/// A motion with its thirteen numbers in one row: places, velocities, θ. Directors are carried from those of
/// `motion`, and turned by θ.
fn with(motion: &EdgeMotion, numbers: &[f64]) -> Result<EdgeMotion, Error> {
    let at = |i: usize| Vector3::from_column_slice(&numbers[3 * i..3 * i + 3]);
    let mut moved = EdgeMotion { places: [at(0), at(1)], velocities: [at(2), at(3)], ..*motion };
    let (before, now) = (motion.tangent().0, moved.tangent().0);
    let refused = |e: crate::Error| Error::Refused { step: 0, reason: e.into() };
    let turn = Turn::between(&before, &now, motion.edge).map_err(refused)?;
    let (sin, cos) = numbers[12].sin_cos();
    let [m1, m2] = motion.directors.map(|m| turn.transport(&now, &m));
    moved.directors = [m1 * cos + m2 * sin, m2 * cos - m1 * sin];
    Ok(moved)
}

fn vector(random: &mut Random, size: f64) -> Vector3<f64> {
    size * Vector3::from_fn(|_, _| random.draw())
}

/// The numbers of what a load does.
fn numbers(load: &EdgeLoad) -> Vec<f64> {
    let by_places = load.by_places.iter().chain(&load.moment_by_places);
    let derivatives = by_places.chain(&load.by_velocities).chain(&load.by_angle);
    let scalars = [load.energy, load.moment, load.moment_by_angle];
    scalars.into_iter().chain(load.forces.iter().chain(derivatives).copied()).collect()
}

/// An edge of any direction, stretched by at most a tenth, in motion.
fn any_motion(rod: &Rod, edge: usize, [time, speed]: [f64; 2], random: &mut Random) -> EdgeMotion {
    let l = rod.rest_lengths[edge];
    let sideways: Vector3<f64> = vector(random, 1.0) + 1e-3 * Vector3::x();
    let along = sideways.normalize();
    let first = vector(random, rod.length());
    let places = [first, first + along * (l * (1.0 + 0.1 * random.draw()))];
    let velocities = [(); 2].map(|()| vector(random, speed));
    let across = any_perpendicular(&along);
    EdgeMotion { edge, time, places, velocities, directors: [across, along.cross(&across)], rest_length: l }
}

fn on_edge(
    load: &dyn Load,
    rod: &Rod,
    edge: usize,
    [time, speed]: [f64; 2],
    random: &mut Random,
) -> Result<Vec<Finding>, Error> {
    let motion = any_motion(rod, edge, [time, speed], random);
    let l = motion.rest_length;
    let row = motion.places.iter().chain(&motion.velocities).flat_map(|v| v.iter().copied());
    let x: Vec<f64> = row.chain([0.0]).collect();
    let acts = load.on_edge(&motion);
    let mut findings = Vec::new();
    let mut at_most =
        |what: &str, value: f64, bound: f64| findings.push(Finding::at_most(what, value, bound));

    let values = numbers(&acts);
    let wild = values.iter().filter(|v| !v.is_finite()).count();
    at_most("values not finite", wild as f64, 0.0);
    if wild > 0 {
        return Ok(findings);
    }
    let differs = |other: &EdgeMotion| differing(&values, &numbers(&load.on_edge(other)));
    let elsewhere: Vec<f64> = x.iter().map(|x| x + 0.1 * l).collect();
    let _ = load.on_edge(&with(&motion, &elsewhere)?);
    at_most("values that differ when run again", differs(&motion), 0.0);

    let mut direction = |size: f64, moved: std::ops::Range<usize>| -> Vec<f64> {
        (0..13).map(|i| if moved.contains(&i) { size * random.draw() } else { 0.0 }).collect()
    };
    // Both vertices together by a tenth of the rod, each by a tenth of the edge.
    let (mut by_place, by_velocity) = (direction(0.1 * l, 0..6), direction(speed, 6..12));
    let together = direction(0.1 * rod.length(), 0..3);
    by_place[..6].iter_mut().enumerate().for_each(|(i, d)| *d += together[i % 3]);
    let weights = Vector6::from_column_slice(&direction(1.0, 0..6)[..6]);
    let by_angle = direction(0.3, 12..13);
    let gradient: Vec<f64> = (acts.by_places.tr_mul(&weights).iter())
        .chain(acts.by_velocities.tr_mul(&weights).iter())
        .copied()
        .chain([acts.by_angle.dot(&weights)])
        .collect();
    let at = |x: &[f64]| Ok::<_, Error>(load.on_edge(&with(&motion, x)?));
    let mut weighted = |x: &[f64]| Ok(weights.dot(&at(x)?.forces));
    for (what, direction) in
        [("∂F/∂(places)", &by_place), ("∂F/∂(velocities)", &by_velocity), ("∂F/∂θ", &by_angle)]
    {
        let (value, bound) = remainder(&mut weighted, &gradient, &x, direction)?;
        at_most(&format!("2 − Taylor slope of {what}"), value, bound);
    }
    let change = |i: usize| Vector3::from_column_slice(&by_velocity[6 + 3 * i..9 + 3 * i]);
    let faster = EdgeMotion { velocities: [0, 1].map(|i| motion.velocities[i] + change(i)), ..motion };
    let by_place_and_angle: Vec<f64> = by_place.iter().zip(&by_angle).map(|(p, a)| p + a).collect();
    if load.has_moment() {
        let gradient: Vec<f64> =
            acts.moment_by_places.iter().copied().chain([0.0; 6]).chain([acts.moment_by_angle]).collect();
        let mut moment = |x: &[f64]| Ok(at(x)?.moment);
        let (value, bound) = remainder(&mut moment, &gradient, &x, &by_place_and_angle)?;
        at_most("2 − Taylor slope of the moment", value, bound);
        let change = load.on_edge(&faster).moment - acts.moment;
        at_most("change of the moment with velocities", change.abs(), 0.0);
    } else {
        let moments = acts.moment_by_places.iter().chain([&acts.moment, &acts.moment_by_angle]);
        let largest = moments.fold(0.0, |m: f64, v| m.max(v.abs()));
        at_most("moment of a load that has none", largest, 0.0);
    }
    if !load.uses_directors() {
        at_most(
            "values that depend on directors",
            differs(&with(&motion, &[&x[..12], &[0.3]].concat())?),
            0.0,
        );
        at_most("∂F/∂θ without directors", acts.by_angle.abs().max(), 0.0);
    }
    if load.has_second_derivatives() {
        findings.extend(of_second_derivatives(load, &motion, &x, [&by_place, &by_velocity, &by_angle])?);
    }
    let mut at_most =
        |what: &str, value: f64, bound: f64| findings.push(Finding::at_most(what, value, bound));
    if load.has_potential() {
        let minus: Vec<f64> = acts.forces.iter().map(|f| -f).chain([0.0; 6]).chain([-acts.moment]).collect();
        let mut energy = |x: &[f64]| Ok(at(x)?.energy);
        let (value, bound) = remainder(&mut energy, &minus, &x, &by_place_and_angle)?;
        at_most("2 − Taylor slope of the potential, whose gradient is −F", value, bound);
        let by_places = acts.by_places_of_carried(&motion);
        let skew = (by_places - by_places.transpose()).abs().max();
        let largest = by_places.abs().max();
        at_most("symmetry of ∂F/∂(places)", share(skew, largest), SYMMETRY);
        let mixed = (acts.by_angle - acts.moment_by_places).abs().max();
        at_most("∂F/∂θ − ∂m/∂(places)", share(mixed, acts.by_angle.abs().max()), SYMMETRY);
        at_most("values that depend on velocities", differs(&faster), 0.0);
    } else {
        at_most("energy of a load without potential", acts.energy.abs(), 0.0);
    }
    Ok(findings)
}

/// What a load does to an edge that moves on: the same forces and derivatives, and how they change.
fn of_second_derivatives(
    load: &dyn Load,
    motion: &EdgeMotion,
    x: &[f64],
    directions: [&Vec<f64>; 3],
) -> Result<Vec<Finding>, Error> {
    let values = numbers(&load.on_edge(motion));
    let sizes: Vec<f64> = values.iter().map(|v| if *v == 0.0 { 1.0 } else { v.abs() }).collect();
    // irregular weights, each number in units of its size
    let weigh = |of: &[f64]| -> f64 {
        (1..).zip(of.iter().zip(&sizes)).map(|(i, (v, size))| (1.7 * f64::from(i)).sin() * v / size).sum()
    };
    let (mut findings, mut departure) = (Vec::new(), 0.0_f64);
    for (what, direction) in ["places", "velocities", "θ"].into_iter().zip(directions) {
        let (row, angle) = direction.split_at(12);
        let by: [f64; 13] = std::array::from_fn(|i| match i {
            6 => angle[0],
            0..6 => row[i],
            _ => row[i - 1],
        });
        let acts = load.on_moved_edge(&motion.moved(&by));
        let off = |(real, value): (&f64, &f64)| (real - value).abs();
        let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let here = numbers(&acts.part(|d| d.re));
        departure = departure.max(share(here.iter().zip(&values).map(off).fold(0.0, f64::max), largest));
        let slope = weigh(&numbers(&acts.part(|d| d.eps)));
        let length: f64 = direction.iter().map(|d| d * d).sum();
        let gradient: Vec<f64> = direction.iter().map(|d| d * slope / length).collect();
        let mut sum = |x: &[f64]| Ok(weigh(&numbers(&load.on_edge(&with(motion, x)?))));
        let (value, bound) = remainder(&mut sum, &gradient, x, direction)?;
        findings.push(Finding::at_most(
            format!("2 − Taylor slope of all at an edge whose {what} move"),
            value,
            bound,
        ));
    }
    findings.push(Finding::at_most("departure of a moved edge from one at rest", departure, SYMMETRY));
    let multipliers = std::array::from_fn(|i| (2.3 * (i + 1) as f64).cos());
    let along_each = second_along_each(load, motion, &multipliers);
    let off = (load.second_on_edge(motion, &multipliers) - along_each).abs().max();
    findings.push(Finding::at_most(
        "departure of second derivatives from those of moved edges",
        share(off, along_each.abs().max()),
        SECOND,
    ));
    Ok(findings)
}

fn share(part: f64, whole: f64) -> f64 {
    if part == 0.0 { 0.0 } else { part / whole }
}

/// 2 − the Taylor slope and its bound. Of a function that does not change: zero, or 2 where it claims a
/// derivative.
fn remainder(
    function: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
    gradient: &[f64],
    x: &[f64],
    direction: &[f64],
) -> Result<(f64, f64), Error> {
    let slope: f64 = gradient.iter().zip(direction).map(|(g, d)| g * d).sum();
    let moved: Vec<f64> = x.iter().zip(direction).map(|(x, d)| x + d).collect();
    if function(&moved)? == function(x)? {
        return Ok((if slope == 0.0 { 0.0 } else { 2.0 }, 0.0));
    }
    taylor(function, gradient, x, direction).map(|test| (2.0 - test.slope, 2.0 - test.bound))
}
