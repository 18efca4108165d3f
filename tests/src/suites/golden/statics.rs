//! Static shapes of elastic rods by collocation of the Kirchhoff equations: places, order of the mesh,
//! reactions.

use super::fixture::{Fixture, expect_length, greater};
use crate::row::{Case, Outcome};
use nalgebra::{Rotation3, Vector3};
use serde::Deserialize;
use std::path::Path;
use std::sync::Arc;
use varda_rod::{Clamp, ClampAt, Found, Loads, Motion, Rod, Search, Section, Supports, rest};

type V = [f64; 3];

#[derive(Deserialize)]
pub(super) struct Given {
    length: f64,
    ei: f64,
    gj: f64,
    ea: f64,
    mass_per_length: f64,
    gravity: V,
    natural_curvature: [f64; 2],
    start: End,
    end: End,
    s: Vec<f64>,
    r: Vec<V>,
    reactions_on_rod: Reactions,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum End {
    Clamp {
        position: V,
        tangent: V,
        director: V,
        #[serde(default)]
        turn_rad: f64,
    },
    Pin {
        position: V,
    },
    Free {
        force: V,
    },
}

#[derive(Deserialize)]
struct Reactions {
    start: Wrench,
    end: Wrench,
}

#[derive(Deserialize)]
struct Wrench {
    force: V,
    moment: V,
}

/// Largest distance at the stations over L, with 100 segments.
const SHAPE: f64 = 2e-3;
/// Second order from 50 to 200 segments within this …
const ORDER: f64 = 0.3;
/// … or this where bending is confined to layers √(EI/T) of a few of 50 segments.
const ORDER_OF_LAYERS: f64 = 0.8;
/// Reactions extrapolated in the mesh, relative.
const REACTION: f64 = 1e-3;

impl Fixture for Given {
    fn validate(&self) -> Result<(), String> {
        expect_length("r", self.r.len(), self.s.len())?;
        if self.s.len() < 3 || !self.s.windows(2).all(|w| w[1] > w[0]) {
            return Err("s must ascend, with three stations or more".into());
        }
        if !(self.s[0] >= 0.0 && self.s[self.s.len() - 1] <= self.length * (1.0 + 1e-12)) {
            return Err("s must lie on the rod".into());
        }
        if let End::Free { .. } = self.start {
            return Err("start must be held".into());
        }
        Ok(())
    }
}

pub(super) fn check(case: &mut Case, path: &Path) -> Outcome {
    let given = Given::read(path)?;
    case.reason("tolerance stated with the fixtures (their README)");
    let found = [50, 100, 200].map(|n| given.solve(n));
    let [a, b, c] = found;
    let meshes = [a?, b?, c?];
    let error = [0, 1, 2].map(|i: usize| meshes[i].error(&given));
    case.at_most("shape", error[1], SHAPE, "-").computed(meshes[1].found.energy);
    let order = 0.5 * (error[0] / error[2]).log2();
    let clamped = [&given.start, &given.end].iter().any(|end| matches!(end, End::Clamp { .. }));
    let layers = clamped && given.weight_number() > 500.0;
    let bound = if layers { ORDER_OF_LAYERS } else { ORDER };
    case.at_most("order", (order - 2.0).abs(), bound, "-").computed(order);
    // layers ask for a finer mesh before its errors are those of second order
    let finer = if layers { Some([given.solve(400)?, given.solve(800)?]) } else { None };
    let [coarse, fine] = finer.as_ref().map_or([&meshes[1], &meshes[2]], |[a, b]| [a, b]);
    case.at_most("reaction", reaction(&given, coarse, fine), REACTION, "-");
    Ok(())
}

/// Whether the rod can be made, for property tests and fuzzing.
pub(super) fn prepare(text: &str) -> Result<(), Box<dyn std::error::Error>> {
    Given::parse(text)?.rod(10)?;
    Ok(())
}

/// A rod at rest, and how its mesh lies on the reference.
struct Solved {
    found: Found,
    /// Arc lengths of its vertices.
    s: Vec<f64>,
    /// Turn about x to the reference's plane, where a weightless rod between clamps in line has none of its
    /// own.
    turn: f64,
}

impl Given {
    /// w L³/EI.
    fn weight_number(&self) -> f64 {
        self.mass_per_length * Vector3::from(self.gravity).norm() * self.length.powi(3) / self.ei
    }

    /// A uniform rod of n segments between these ends.
    fn rod(&self, n: usize) -> Result<Rod, varda_rod::Error> {
        let clamped = [&self.start, &self.end].map(|end| matches!(end, End::Clamp { .. }));
        let section = Section {
            ea: self.ea,
            ei1: self.ei,
            ei2: self.ei,
            gj: self.gj,
            mass_per_length: self.mass_per_length,
        };
        Ok(Rod::uniform_between(self.length, n, &section, clamped)?.naturally(self.natural_curvature, 0.0))
    }

    fn solve(&self, n: usize) -> Result<Solved, Box<dyn std::error::Error>> {
        let rod = self.rod(n)?;
        let mut supports = Supports::default();
        let mut loads = Loads { gravity: self.gravity.into(), ..Loads::default() };
        let mut search = Search::default();
        for (end, vertex) in [(&self.start, 0), (&self.end, n)] {
            match *end {
                End::Clamp { position, tangent, director, turn_rad } => {
                    let clamp = Clamp::new(ClampAt::Face, position, tangent, director);
                    if vertex == 0 {
                        supports.start = Some(clamp);
                    } else {
                        supports.end = Some(clamp);
                        search.end_turn = turn_rad;
                    }
                }
                End::Pin { position } => supports.prescribed.push((vertex, Arc::new(position))),
                End::Free { force } => {
                    loads.point_forces.push((rod.length(), Arc::new(force) as Arc<dyn Motion>));
                }
            }
        }
        let found = rest(&rod, &supports, &loads, 0.0, &search)?;
        let mut solved = Solved { found, s: rod.arc_lengths(), turn: 0.0 };
        if self.gravity == [0.0; 3] && !matches!(self.end, End::Free { .. }) {
            let (middle, x) = (self.r[self.r.len() / 2], solved.at(self.s[self.s.len() / 2]));
            solved.turn = middle[2].atan2(middle[1]) - x.z.atan2(x.y);
        }
        Ok(solved)
    }
}

impl Solved {
    fn turned(&self, x: &Vector3<f64>) -> Vector3<f64> {
        Rotation3::from_axis_angle(&Vector3::x_axis(), self.turn) * x
    }

    /// The place at an arc length, by the cubic through four vertices.
    fn at(&self, s: f64) -> Vector3<f64> {
        let x = &self.found.rest.vertices;
        let first = self.s.partition_point(|v| *v < s).saturating_sub(2).min(x.len() - 4);
        let four = first..first + 4;
        let weight = |i: usize| {
            let others = four.clone().filter(|j| *j != i);
            others.map(|j| (s - self.s[j]) / (self.s[i] - self.s[j])).product::<f64>()
        };
        four.clone().map(|i| x[i] * weight(i)).sum()
    }

    fn longest_segment(&self) -> f64 {
        self.s.windows(2).map(|w| w[1] - w[0]).fold(0.0, greater)
    }

    /// Largest distance at the stations, over the length.
    fn error(&self, given: &Given) -> f64 {
        let off =
            given.s.iter().zip(&given.r).map(|(s, r)| (self.turned(&self.at(*s)) - Vector3::from(*r)).norm());
        off.fold(0.0, greater) / given.length
    }

    /// Force and moment at an end.
    fn wrench(&self, first: bool) -> [Vector3<f64>; 2] {
        let vertex = if first { 0 } else { self.s.len() - 1 };
        let of_end = self.found.reactions.iter().find(|r| r.vertex == vertex);
        of_end.map_or([Vector3::zeros(); 2], |r| [r.force, r.moment].map(|v| self.turned(&v)))
    }
}

/// Largest difference of the supports' reactions from the reference, over its largest; extrapolated from two
/// meshes.
fn reaction(given: &Given, coarse: &Solved, fine: &Solved) -> f64 {
    let theirs = [&given.reactions_on_rod.start, &given.reactions_on_rod.end];
    let theirs = theirs.map(|w| [Vector3::from(w.force), Vector3::from(w.moment)]);
    let factor = (coarse.longest_segment() / fine.longest_segment()).powi(2);
    let ours = [true, false].map(|first| {
        let (a, b) = (coarse.wrench(first), fine.wrench(first));
        [0, 1].map(|i| b[i] + (b[i] - a[i]) / (factor - 1.0))
    });
    let mut worst = 0.0;
    for kind in [0, 1] {
        let scale = theirs[0][kind].norm().max(theirs[1][kind].norm());
        let held = if matches!(given.end, End::Free { .. }) { 1 } else { 2 };
        for end in 0..held {
            let off = (ours[end][kind] - theirs[end][kind]).norm();
            worst = greater(worst, if scale > 0.0 { off / scale } else { off });
        }
    }
    worst
}
