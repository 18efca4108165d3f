//! A rod at rest wherever it is held: a shape that meets the supports, then its clamps turned, step by step.

use std::sync::Arc;

use nalgebra::{Rotation3, Unit, Vector3};

use super::guess::{Held, along, rest_shape, sideways};
use super::reactions::Reaction;
use crate::Error;
use crate::equilibrium::{Rest, Work, equilibrium_within};
use crate::load::{Load, scaled::Scaled};
use crate::rod::Rod;
use crate::support::{Clamp, Loads, Supports};

/// Newton iterations of one stage; a stage that wants more is cut into smaller ones.
const STAGE: usize = 80;
/// Iterations of the first stage at each stretching stiffness, and of the last stage.
const FIRST: usize = 300;
/// Largest turn of a clamp between two stages \[rad\].
const TURN: f64 = 0.4;
/// The smallest stage, as a share of the whole way.
const SMALLEST: f64 = 1.0 / 128.0;
/// A stage shorter than this share of the whole way snaps through: it gets the iterations that takes.
const SNAP: f64 = 1.0 / 32.0;
/// Iterations of a snap.
const SNAPPING: usize = 2000;
/// Stretching stiffness over ten bending stiffnesses and the weight, where a first shape is looked for …
const SOFT: f64 = 30.0;
/// … and where clamps turn.
const STIFF: f64 = 1e4;
/// Weight × length³ over bending stiffness from which clamps bend a cable near themselves only: it is laid
/// with them as they are.
const HEAVY: f64 = 1e4;
/// Shapes beside one where a search stalled, as shares of the length.
const KICKS: [f64; 3] = [0.003, -0.01, 0.03];
/// Multiple of the twisting stiffness on a second way.
const MORE_TWIST: f64 = 30.0;
/// Newton iterations of a whole search.
const MOST: usize = 20_000;
/// Whole turning of the natural curvature from which a rod with one held place starts from its rest shape
/// \[rad\].
const CURLED: f64 = 0.5;

/// What a search for a rod at rest may be told.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct Search {
    /// A shape near the one looked for, angles included: it picks the branch where there are several. It is
    /// moved to the places that are held.
    pub initial_shape: Option<Rest>,
    /// The turn \[rad\], right-handed about its tangent, by which the end clamp came to its present director;
    /// more than π counts. Zero: the twist nearest to none. Turns that clamps say of themselves
    /// ([`Clamp::turns`]) are added.
    pub end_turn: f64,
}

impl Search {
    /// The same from another [`initial_shape`](Self::initial_shape).
    #[must_use]
    pub fn with_initial_shape(mut self, initial_shape: Rest) -> Self {
        self.initial_shape = Some(initial_shape);
        self
    }

    /// The same with another [`end_turn`](Self::end_turn).
    #[must_use]
    pub fn with_end_turn(mut self, end_turn: f64) -> Self {
        self.end_turn = end_turn;
        self
    }
}

/// What [`rest`] found, and what it cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The shape.
    pub rest: Rest,
    /// Total potential energy \[J\]: elastic, of the weight (zero at the origin) and of the dead forces.
    pub energy: f64,
    /// What its supports exert on it, by ascending vertices.
    pub reactions: Vec<Reaction>,
    /// Calls of Newton's method, failed ones included.
    pub solves: usize,
    /// Newton iterations over all calls.
    pub iterations: usize,
    /// The minimum is not isolated (see [`varda_implicit::NewtonReport::neutral`]).
    pub neutral: bool,
}

/// A rod at rest, held anywhere: by clamps, at points, at one place or several, nearer than its length or
/// not.
///
/// A minimum of the total potential energy E(u) − F·x \[J\] with the supports where they are at time t
/// \[s\]: ∂E/∂u = F of places \[m\] and angles \[rad\] to a last update below 10⁻¹¹ of the length, or
/// to rounding, and no negative curvature there. Which minimum, where there are several, is decided by the
/// way to it:
///
/// 1. A clamped rod with a free end starts as [`straight_guess`](crate::straight_guess) lays it; one whose
///    natural curvature turns by more than half a radian starts from its rest shape without loads, which then
///    grow.
/// 2. Between held places a catenary (a cable: weight × L³ > 50 EI) or a bow (a beam) of the right length
///    is laid, with clamps along its chord and no natural strain. A rod much stiffer in stretch than in
///    everything else comes to rest first with less of that stiffness, which then grows tenfold a stage.
/// 3. Clamps, director, the turn of the end and natural strains go to their values together, in stages that
///    are halved where Newton's method fails.
///
/// Every stage ends in a minimum, not in a saddle, and the way is cut off at 20 000 Newton iterations. Energy
/// and angles are those of Bergou et al. (2008).
///
/// # Errors
/// [`varda_implicit::Error`] where no way led to a shape at rest, or wrapping an [`Error`] of the rod
/// ([`Error::NothingHolds`] where nothing holds it, [`Error::NotAtRest`] where the iterations ran out).
///
/// # Panics
/// If [`Search::initial_shape`] has the wrong number of vertices or angles.
///
/// # Examples
/// A cable of one metre hung by its ends at 0.6 m:
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Loads, Rod, Search, Section, Supports, Vector3, rest};
///
/// let cable = Section { ea: 1e4, ei1: 1e-4, ei2: 1e-4, gj: 1e-4, mass_per_length: 0.05 };
/// let rod = Rod::uniform(1.0, 40, &cable)?;
/// let mut supports = Supports::default();
/// supports.prescribed.push((0, Arc::new([0.0, 0.0, 0.0])));
/// supports.prescribed.push((40, Arc::new([0.6, 0.0, 0.0])));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
/// // the catenary's sag
/// assert!((found.rest.vertices[20].z + 0.3628).abs() < 2e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn rest(
    rod: &Rod,
    supports: &Supports,
    loads: &Loads,
    t: f64,
    search: &Search,
) -> Result<Found, varda_implicit::Error> {
    let refuse = |e: Error| varda_implicit::Error::Refused { step: 0, reason: e.into() };
    let held = Held::at(rod, supports, t).map_err(refuse)?;
    let rod = &rod.clone().with_faces(supports.faces());
    let mut way = Way {
        rod,
        supports,
        loads,
        t,
        held,
        end_turn: search.end_turn + std::f64::consts::TAU * supports.turns_at(t),
        twist: 1.0,
        motion: 1.0,
        work: Work::default(),
    };
    let found = if let Some(shape) = &search.initial_shape {
        way.starting_at(shape)
    } else if way.held.spans() {
        way.between().or_else(|failure| {
            // half a turn of twist at one vertex hides its bend from the energy: a way on which twist costs
            // more
            way.twist = MORE_TWIST;
            if way.end_turn == 0.0 { way.between() } else { Err(failure) }
        })
    } else {
        way.hanging()
    };
    found.map(|rest| Found {
        rest,
        energy: way.work.energy,
        reactions: way.work.reactions,
        solves: way.work.solves,
        iterations: way.work.iterations,
        neutral: way.work.report.neutral,
    })
}

struct Way<'a> {
    rod: &'a Rod,
    supports: &'a Supports,
    loads: &'a Loads,
    t: f64,
    held: Held,
    end_turn: f64,
    /// Twisting stiffness on the way, as a multiple of the rod's.
    twist: f64,
    /// Share of the loads of the motion.
    motion: f64,
    work: Work,
}

type Solved = Result<Rest, varda_implicit::Error>;

impl Way<'_> {
    /// At rest with clamps turned by the share λ, this share of the loads and of the stretching stiffness.
    fn solve(&mut self, lambda: f64, load: f64, stretch: f64, guess: &Rest, iterations: usize) -> Solved {
        if self.work.iterations >= MOST {
            let reason = Error::NotAtRest { iterations: self.work.iterations };
            return Err(varda_implicit::Error::Refused { step: 0, reason: reason.into() });
        }
        if [lambda, load, stretch, self.motion] == [1.0; 4] {
            let (rod, supports, loads) = (self.rod, self.supports, self.loads);
            return equilibrium_within(rod, supports, loads, self.t, guess, iterations, &mut self.work);
        }
        let mut rod = self.rod.clone();
        rod.ea.iter_mut().for_each(|k| *k *= stretch);
        rod.gj.iter_mut().for_each(|k| *k *= self.twist);
        if self.held.spans() {
            rod.natural_curvature.iter_mut().flatten().for_each(|k| *k *= lambda);
            rod.natural_twist.iter_mut().for_each(|k| *k *= lambda);
        }
        let clamp = |f: &crate::clamp_frame::ClampFrame, at: (Vector3<f64>, Vector3<f64>)| {
            Clamp::new(f.at, f.position, at.0, at.1)
        };
        let supports = Supports {
            start: self.held.start.as_ref().map(|f| clamp(f, self.frame(true, lambda))),
            end: self.held.end.as_ref().map(|f| clamp(f, self.frame(false, lambda))),
            ..self.supports.clone()
        };
        let t = self.t;
        let point_forces = self.loads.point_forces.iter().map(|(s, f)| {
            let force = f.at(t) * load;
            (*s, Arc::new(force) as Arc<dyn crate::Motion>)
        });
        let loads = Loads {
            gravity: self.loads.gravity * load,
            point_forces: point_forces.collect(),
            of_motion: if lambda == 1.0 && stretch == 1.0 { self.share_of_motion() } else { Vec::new() },
        };
        equilibrium_within(&rod, &supports, &loads, t, guess, iterations, &mut self.work)
    }

    /// The present share of the loads of the motion.
    fn share_of_motion(&self) -> Vec<Arc<dyn Load>> {
        let factor = self.motion;
        let scaled = |load: &Arc<dyn Load>| Arc::new(Scaled { load: load.clone(), factor }) as Arc<dyn Load>;
        self.loads.of_motion.iter().filter(|_| factor != 0.0).map(scaled).collect()
    }

    /// Loads of the motion grow, from a shape at rest without them.
    fn with_growing_motion(&mut self, rest: Rest, mut weight: impl FnMut(f64) -> f64) -> Solved {
        let grown = self.stages(rest, 0.25, |way, share, guess, most| {
            way.motion = share;
            way.solve(1.0, weight(share), 1.0, guess, most)
        });
        self.motion = 1.0;
        grown
    }

    /// The turn from the chord to a clamp's tangent.
    fn turn(&self, first: bool) -> (Unit<Vector3<f64>>, f64) {
        let f = if first { self.held.start.as_ref() } else { self.held.end.as_ref() };
        let (Some(f), true) = (f, self.held.spans()) else { return (Vector3::x_axis(), 0.0) };
        let chord = self.held.chord(first, self.rod);
        let cross = chord.cross(&f.tangent);
        let angle = cross.norm().atan2(chord.dot(&f.tangent));
        let axis = Unit::try_new(cross, 1e-9).unwrap_or_else(|| {
            Unit::new_normalize(chord.cross(&sideways(&self.held, &chord, &self.loads.gravity)))
        });
        (axis, angle)
    }

    /// Tangent and director of a clamp on its way: along the chord at λ = 0, its own at λ = 1.
    fn frame(&self, first: bool, lambda: f64) -> (Vector3<f64>, Vector3<f64>) {
        let f = if first { self.held.start.as_ref() } else { self.held.end.as_ref() };
        let f = f.expect("a clamp at this end");
        let (axis, angle) = self.turn(first);
        let back = Rotation3::from_axis_angle(&axis, (lambda - 1.0) * angle);
        let (tangent, mut director) = (back * f.tangent, back * f.director);
        if !first {
            let along = Unit::new_normalize(tangent);
            director = Rotation3::from_axis_angle(&along, (lambda - 1.0) * self.end_turn) * director;
        }
        (tangent, director)
    }

    /// A shape that was given, moved to the places that are held: as it is, or first with less stretching
    /// stiffness.
    fn starting_at(&mut self, shape: &Rest) -> Solved {
        let mut shape = shape.clone();
        let s = self.rod.arc_lengths();
        let off: Vec<_> =
            self.held.points.iter().map(|&(v, place)| (s[v], place - shape.vertices[v])).collect();
        for (x, s) in shape.vertices.iter_mut().zip(&s) {
            let after = off.partition_point(|o| o.0 <= *s);
            let (a, b) = (off[after.saturating_sub(1)], off[after.min(off.len() - 1)]);
            let share = if b.0 > a.0 { ((s - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) } else { 0.0 };
            *x += a.1 + (b.1 - a.1) * share;
        }
        self.solve(1.0, 1.0, 1.0, &shape, SNAPPING)
            .or_else(|_| self.stiffen(1.0, self.share_of_stretch(SOFT), 1.0, &shape))
    }

    /// One held place.
    fn hanging(&mut self) -> Solved {
        let n = self.rod.segments();
        let curl: f64 = self.rod.natural_curvature.iter().map(|k| k[0].hypot(k[1])).sum();
        let gravity = self.loads.gravity;
        let (shape, straight) = if let (Some(f), true) = (&self.held.start, curl > CURLED) {
            let (vertices, theta) = rest_shape(self.rod, f.position, f.tangent, f.director);
            (Rest { vertices, theta }, false)
        } else if self.held.start.is_some() || self.held.end.is_some() {
            let refuse = |e: Error| varda_implicit::Error::Refused { step: 0, reason: e.into() };
            (crate::straight_guess(self.rod, self.supports, self.t, Vector3::x()).map_err(refuse)?, true)
        } else {
            let vertices = along(self.rod, &self.held, None, None, &gravity);
            (Rest { vertices, theta: vec![0.0; n] }, true)
        };
        // a straight rod goes its old way first; a curled one is lost when all of its weight comes at once
        if straight && let Ok(rest) = self.solve(1.0, 1.0, 1.0, &shape, SNAPPING) {
            return Ok(rest);
        }
        self.motion = 0.0;
        let rest = self.solve(1.0, 0.0, 1.0, &shape, FIRST)?;
        self.with_growing_motion(rest, |share| share)
    }

    /// Two held places or more.
    fn between(&mut self) -> Solved {
        if self.is_heavy() && self.end_turn == 0.0 {
            let tangents = [&self.held.start, &self.held.end].map(|f| f.as_ref().map(|f| f.tangent));
            let [start, end] = tangents.each_ref().map(Option::as_ref);
            let vertices = along(self.rod, &self.held, start, end, &self.loads.gravity);
            let shape = Rest { vertices, theta: vec![0.0; self.rod.segments()] };
            let laid = self.stiffen(1.0, self.share_of_stretch(SOFT), 1.0, &shape);
            if laid.is_ok() {
                return laid;
            }
        }
        let start = self.held.start.is_some().then(|| self.frame(true, 0.0).0);
        let end = self.held.end.is_some().then(|| self.frame(false, 0.0).0);
        let vertices = along(self.rod, &self.held, start.as_ref(), end.as_ref(), &self.loads.gravity);
        let shape = Rest { vertices, theta: vec![0.0; self.rod.segments()] };
        let largest = [self.turn(true).1, self.turn(false).1, self.end_turn.abs(), 0.5 * self.curl()];
        let largest = largest.into_iter().fold(0.0, f64::max);
        let cap = self.share_of_stretch(STIFF);
        let aligned = self.stiffen(0.0, self.share_of_stretch(SOFT), cap, &shape).or_else(|failure| {
            // the softest one sags too far for some: start as it is
            if cap < 1.0 { self.kicked(0.0, cap, &shape) } else { Err(failure) }
        })?;
        let first = (TURN / largest).min(1.0);
        let mut before = 0.0;
        let turned = self.stages(aligned, first, |way, lambda, guess, most| {
            let carried = way.carry(guess, before, lambda);
            let rest = way.solve(lambda, 1.0, cap, &carried, most).or_else(|failure| {
                if most == STAGE { Err(failure) } else { way.kicked(lambda, cap, &carried) }
            })?;
            before = lambda;
            Ok(rest)
        })?;
        if cap < 1.0 || !self.loads.of_motion.is_empty() {
            let stiff = self.stiffen(1.0, cap, 1.0, &turned);
            if stiff.is_ok() || self.loads.of_motion.is_empty() {
                return stiff;
            }
            self.motion = 0.0;
            let rest = self.stiffen(1.0, cap, 1.0, &turned)?;
            self.with_growing_motion(rest, |_| 1.0)
        } else {
            Ok(turned)
        }
    }

    /// A clamped cable whose weight is all that decides its shape.
    fn is_heavy(&self) -> bool {
        let bend = self.rod.ei.iter().fold(0.0, |m: f64, k| m.max(k[0]).max(k[2]));
        let weight = self.loads.gravity.norm() * self.rod.masses.iter().sum::<f64>();
        let clamped = self.held.start.is_some() || self.held.end.is_some();
        clamped && self.curl() == 0.0 && weight * self.rod.length().powi(2) > HEAVY * bend
    }

    /// Sum of natural curvature and twist \[rad\].
    fn curl(&self) -> f64 {
        self.rod.natural_curvature.iter().map(|k| k[0].hypot(k[1])).sum::<f64>()
            + self.rod.natural_twist.iter().map(|t| t.abs()).sum::<f64>()
    }

    /// The share of the stretching stiffness that is `stiff` times what bends and weighs; at most all of it.
    fn share_of_stretch(&self, stiff: f64) -> f64 {
        let rod = self.rod;
        let most = rod.ea.iter().fold(0.0, |m: f64, k| m.max(*k));
        let bend = rod.ei.iter().fold(0.0, |m: f64, k| m.max(k[0]).max(k[2]));
        let weight = self.loads.gravity.norm() * rod.masses.iter().sum::<f64>();
        (stiff * (10.0 * bend / rod.length().powi(2)).max(weight) / most).clamp(1e-9, 1.0)
    }

    /// At rest with ever more stretching stiffness, tenfold a stage or less.
    fn stiffen(&mut self, lambda: f64, from: f64, to: f64, guess: &Rest) -> Solved {
        let mut share = from;
        let mut rest = self.kicked(lambda, share, guess)?;
        let mut factor: f64 = 10.0;
        while share < to {
            let next = if share * factor * 1.01 >= to { to } else { share * factor };
            match self.solve(lambda, 1.0, next, &rest, FIRST) {
                Ok(found) => {
                    (rest, share) = (found, next);
                    factor = (factor * factor).min(10.0);
                }
                Err(_) if factor > 1.5 => factor = factor.sqrt(),
                Err(_) => {
                    rest = self.kicked(lambda, next, &rest)?;
                    share = next;
                }
            }
        }
        Ok(rest)
    }

    /// At rest from a guess; where the search stalls, as it does at a saddle whose way out the energy hardly
    /// shows, on from a shape a little beside.
    fn kicked(&mut self, lambda: f64, stretch: f64, guess: &Rest) -> Solved {
        let mut result = self.solve(lambda, 1.0, stretch, guess, FIRST);
        for kick in KICKS {
            if result.is_ok() {
                break;
            }
            let Some(mut shape) = self.work.stopped.take() else { break };
            let s = self.rod.arc_lengths();
            let length = self.rod.length();
            for (x, s) in shape.vertices.iter_mut().zip(&s) {
                let u = std::f64::consts::PI * s / length;
                let side = Vector3::new((u + 0.3).sin(), (2.0 * u + 1.1).sin(), (3.0 * u - 0.7).cos());
                *x += side * (kick * length);
            }
            result = self.solve(lambda, 1.0, stretch, &shape, SNAPPING);
        }
        result
    }

    /// From λ = 0 to 1 in stages, halved where one fails.
    fn stages(
        &mut self,
        mut rest: Rest,
        mut stage: f64,
        mut solve: impl FnMut(&mut Self, f64, &Rest, usize) -> Solved,
    ) -> Solved {
        let mut lambda = 0.0;
        while lambda < 1.0 {
            let next = if lambda + 1.01 * stage >= 1.0 { 1.0 } else { lambda + stage };
            let most = if stage < SNAP { SNAPPING } else { STAGE };
            match solve(self, next, &rest, most) {
                Ok(found) => {
                    (rest, lambda) = (found, next);
                    stage *= 1.5;
                }
                Err(failure) if stage < SMALLEST => return Err(failure),
                Err(_) => stage *= 0.5,
            }
        }
        Ok(rest)
    }

    /// A shape carried along with its clamps from one λ to the next: their turn fades out along the span.
    fn carry(&self, rest: &Rest, from: f64, to: f64) -> Rest {
        let mut carried = rest.clone();
        let s = self.rod.arc_lengths();
        let n = self.rod.segments();
        let points = &self.held.points;
        for first in [true, false] {
            let clamp = if first { &self.held.start } else { &self.held.end };
            let Some(f) = clamp else { continue };
            let (axis, angle) = self.turn(first);
            let turn = Rotation3::from_axis_angle(&axis, (to - from) * angle);
            let (a, b) = if first { (0, points[1].0) } else { (points[points.len() - 2].0, n) };
            for v in a..=b {
                let u = if first { s[v] - s[a] } else { s[b] - s[v] } / (s[b] - s[a]);
                let fade = (1.0 - u).powi(2) * (1.0 + 2.0 * u);
                let arm = rest.vertices[v] - f.position;
                carried.vertices[v] += (turn * arm - arm) * fade;
            }
        }
        if self.held.end.is_some() {
            let turn = (to - from) * self.end_turn;
            for (e, angle) in carried.theta.iter_mut().enumerate() {
                *angle += turn * (e + 1) as f64 / n as f64;
            }
        }
        carried
    }
}
