//! Supports that parameters move: clamps turned in their own axes, drives of another size or phase,
//! displacements in time.

use std::fmt;
use std::sync::Arc;

use nalgebra::Vector3;
use varda_implicit::Law;

use crate::support::{EllipseDrive, Motion};

/// A support of a rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeldAt {
    /// The clamp at arc length 0.
    Start,
    /// The clamp at arc length L.
    End,
    /// A prescribed vertex.
    Vertex(usize),
}

/// What a parameter does to a support, times g(p) of its [`Law`].
///
/// ```
/// use varda_rod::{Change, HeldAt, Law, Moved, MovedBy, Parameter, Vector3};
///
/// // a clamp that was glued on a little askew, about m₁ of its section
/// let askew = Moved { of: HeldAt::Start, by: MovedBy::Turn(Vector3::x()) };
/// let change = Change { supports: vec![askew], ..Change::default() };
/// let parameter = Parameter { change, law: Law::Linear };
/// assert!(parameter.change.supports[0].of == HeldAt::Start);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Moved {
    /// The support.
    pub of: HeldAt,
    /// How it moves.
    pub by: MovedBy,
}

impl Moved {
    /// The same by a multiple of g.
    #[must_use]
    pub fn times(self, factor: f64) -> Moved {
        let by = match self.by {
            MovedBy::Turn(by) => MovedBy::Turn(by * factor),
            MovedBy::Drive { drive, radii, phase } => {
                MovedBy::Drive { drive, radii: radii.map(|r| r * factor), phase: phase * factor }
            }
            MovedBy::Along(along) => MovedBy::Along(along.times(factor)),
            MovedBy::TurnAlong { along, arm } => MovedBy::TurnAlong { along: along.times(factor), arm },
        };
        Moved { of: self.of, by }
    }
}

/// How a parameter moves a support.
#[derive(Debug, Clone, PartialEq)]
pub enum MovedBy {
    /// A clamp is turned about its place, by a rotation vector \[rad\] in its own axes (m₁, m₂, t) before
    /// [`Clamp::turns`](crate::Clamp::turns), which may move: those of several parameters are added.
    Turn(Vector3<f64>),
    /// The drive that moves it has other semi-axes \[m\] and another phase \[rad\].
    Drive {
        /// The drive where all parameters are zero.
        drive: EllipseDrive,
        /// Change of its semi-axes.
        radii: [f64; 2],
        /// Change of its phase.
        phase: f64,
    },
    /// It is displaced \[m\] in time.
    Along(Displacement),
    /// A clamp is turned in time with the body that carries it, by a rotation vector \[rad\] in the
    /// clamp's own axes (m₁, m₂, t) before [`Clamp::turns`](crate::Clamp::turns): those of several
    /// parameters are added, to those of `Turn` too.
    TurnAlong {
        /// The rotation vector in time.
        along: Displacement,
        /// The place of the clamp from the point that the body turns about, in the clamp's own axes
        /// \[m\]; one for all parameters that turn a clamp.
        arm: Vector3<f64>,
    },
}

impl MovedBy {
    /// The rotation vector by which it turns a clamp at time t, of a multiple of one.
    pub(crate) fn turns(&self, t: f64) -> Option<Vector3<f64>> {
        match self {
            MovedBy::Turn(by) => Some(*by),
            MovedBy::TurnAlong { along, .. } => Some(along.0.at(t)),
            MovedBy::Along(_) | MovedBy::Drive { .. } => None,
        }
    }
}

/// A displacement in time, equal to itself and to copies of it alone.
#[derive(Clone)]
pub struct Displacement(pub Arc<dyn Motion>);

impl Displacement {
    fn times(self, factor: f64) -> Displacement {
        Displacement(Arc::new(move |t: f64| self.0.at(t) * factor))
    }
}

impl fmt::Debug for Displacement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Displacement({:?} at 0)", self.0.at(0.0))
    }
}

impl PartialEq for Displacement {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// A motion of a support by a parameter.
#[derive(Clone)]
pub(crate) struct Item {
    parameter: usize,
    law: Law,
    pub(crate) moved: Moved,
    /// g, g′ and g″ at the present values.
    g: f64,
    pub(crate) slope: f64,
    pub(crate) curvature: f64,
}

/// All of them, and where they have the supports at the present values.
#[derive(Clone, Default)]
pub(crate) struct Moves {
    items: Vec<Item>,
    /// Rotation vectors of the two clamps in their own axes.
    turns: [Vector3<f64>; 2],
    /// Drives where all parameters are zero, and as they are.
    drives: Vec<(HeldAt, [EllipseDrive; 2])>,
}

impl Moves {
    /// Of parameters with these laws, in their order.
    pub(crate) fn of<'a>(parameters: impl IntoIterator<Item = (Law, &'a [Moved])>) -> Moves {
        let mut all = Moves::default();
        for (parameter, (law, supports)) in parameters.into_iter().enumerate() {
            for moved in supports {
                if let MovedBy::Drive { drive, .. } = moved.by
                    && all.drives.iter().all(|known| known.0 != moved.of)
                {
                    all.drives.push((moved.of, [drive; 2]));
                }
                let moved = moved.clone();
                all.items.push(Item { parameter, law, moved, g: 0.0, slope: 1.0, curvature: 0.0 });
            }
        }
        all
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Those that move something, ascending.
    pub(crate) fn parameters(&self) -> Vec<usize> {
        let mut all: Vec<usize> = self.items.iter().map(|item| item.parameter).collect();
        all.dedup();
        all
    }

    /// One more than the last parameter that moves something.
    pub(crate) fn span(&self) -> usize {
        self.items.iter().map(|item| item.parameter + 1).max().unwrap_or(0)
    }

    /// Takes the values of the parameters.
    pub(crate) fn take(&mut self, p: &[f64]) {
        let Moves { items, turns, drives } = self;
        turns.fill(Vector3::zeros());
        drives.iter_mut().for_each(|(_, [prior, now])| *now = *prior);
        for item in items {
            let p = p[item.parameter];
            (item.g, item.slope, item.curvature) =
                (item.law.value(p), item.law.slope(p), item.law.curvature(p));
            match &item.moved.by {
                MovedBy::Turn(by) => turns[usize::from(item.moved.of == HeldAt::End)] += by * item.g,
                MovedBy::Drive { radii, phase, .. } => {
                    for (_, [_, now]) in drives.iter_mut().filter(|known| known.0 == item.moved.of) {
                        now.radii.iter_mut().zip(radii).for_each(|(r, by)| *r += by * item.g);
                        now.phase += phase * item.g;
                    }
                }
                MovedBy::Along(_) | MovedBy::TurnAlong { .. } => {}
            }
        }
    }

    /// Writes those that may move something at time t, ascending: errors in time are zero at most times.
    pub(crate) fn acting(&self, t: f64, all: &mut Vec<usize>) {
        let acts = |item: &&Item| match &item.moved.by {
            MovedBy::Turn(_) | MovedBy::Drive { .. } => true,
            MovedBy::Along(along) | MovedBy::TurnAlong { along, .. } => along.0.at(t) != Vector3::zeros(),
        };
        all.clear();
        all.extend(self.items.iter().filter(acts).map(|item| item.parameter));
        all.dedup();
    }

    /// What one of them does.
    pub(crate) fn of_parameter(&self, parameter: usize) -> impl Iterator<Item = &Item> {
        let first = self.items.partition_point(|item| item.parameter < parameter);
        self.items[first..].iter().take_while(move |item| item.parameter == parameter)
    }

    /// The rotation vector of a clamp in its own axes at time t.
    pub(crate) fn turn(&self, end: bool, t: f64) -> Vector3<f64> {
        self.turns[usize::from(end)] + self.turned(end, t).map_or_else(Vector3::zeros, |(turn, _)| turn)
    }

    /// The part of it by which the body turns that carries the clamp, and the clamp's place in that body.
    pub(crate) fn turned(&self, end: bool, t: f64) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let of = if end { HeldAt::End } else { HeldAt::Start };
        let mut sum: Option<(Vector3<f64>, Vector3<f64>)> = None;
        for item in self.items.iter().filter(|item| item.moved.of == of) {
            if let MovedBy::TurnAlong { along, arm } = &item.moved.by {
                sum.get_or_insert((Vector3::zeros(), *arm)).0 += along.0.at(t) * item.g;
            }
        }
        sum
    }

    /// The place of a prescribed vertex at time t.
    pub(crate) fn place(&self, vertex: usize, motion: &dyn Motion, t: f64) -> Vector3<f64> {
        let place = motion.at(t);
        if self.is_empty() { place } else { place + self.displaced(HeldAt::Vertex(vertex), t) }
    }

    /// How far a support is displaced at time t.
    pub(crate) fn displaced(&self, of: HeldAt, t: f64) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for item in self.items.iter().filter(|item| item.moved.of == of) {
            if let MovedBy::Along(along) = &item.moved.by {
                sum += along.0.at(t) * item.g;
            }
        }
        for (_, [prior, now]) in self.drives.iter().filter(|known| known.0 == of) {
            sum += now.at(t) - prior.at(t);
        }
        sum
    }

    /// ∂(place)/∂p at time t.
    pub(crate) fn rate(&self, item: &Item, t: f64) -> Vector3<f64> {
        let by = match &item.moved.by {
            MovedBy::Turn(_) | MovedBy::TurnAlong { .. } => Vector3::zeros(),
            MovedBy::Along(along) => along.0.at(t),
            MovedBy::Drive { radii, phase, .. } => {
                let known = self.drives.iter().find(|known| known.0 == item.moved.of);
                known.map_or_else(Vector3::zeros, |(_, [_, now])| now.rate_by(*radii, *phase, t))
            }
        };
        by * item.slope
    }

    /// ∂²(place)/∂p∂q at time t of two items of one support; g″ is in that of an item with itself.
    pub(crate) fn second_rate(&self, [a, b]: [&Item; 2], t: f64) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        if std::ptr::eq(a, b) && a.curvature != 0.0 {
            sum += self.rate(a, t) * (a.curvature / a.slope);
        }
        if let (MovedBy::Drive { radii, phase, .. }, MovedBy::Drive { radii: others, phase: other, .. }) =
            (&a.moved.by, &b.moved.by)
            && let Some((_, [_, now])) = self.drives.iter().find(|known| known.0 == a.moved.of)
        {
            sum += now.second_by([*radii, *others], [*phase, *other], t) * (a.slope * b.slope);
        }
        sum
    }
}
