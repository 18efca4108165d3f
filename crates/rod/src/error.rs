//! Errors of the rod: typed, with numbers, naming the edge, vertex or field.

/// What can be wrong with a rod, its supports or a configuration of it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Two neighbouring edges fold back on each other: curvature is infinite there.
    #[error("edges {} and {vertex} are folded onto each other at vertex {vertex} (turning angle within 1e-6 \
        rad of pi)", vertex - 1)]
    Fold {
        /// The vertex between the two edges.
        vertex: usize,
    },
    /// The first edge points exactly against its reference direction, where its frame is undefined.
    #[error("the first edge points against its rest direction: its frame is undefined")]
    FrameUndefined,
    /// An edge has no length.
    #[error("edge {edge} has length {length:e} m")]
    ZeroEdge {
        /// Number of the edge (that of its first vertex).
        edge: usize,
        /// Its length \[m\].
        length: f64,
    },
    /// A force of a support is asked for where there is none.
    #[error("no {what} holds the rod at s = {} m", rounded(*s))]
    NotHeld {
        /// The arc length \[m\].
        s: f64,
        /// Support or clamp.
        what: &'static str,
    },
    /// A moment within the rod beside the vertices that bend.
    #[error(
        "the moment at s = {} m is beside the vertices that bend, from {} to {} m: take a place between \
             them, or the moment of a clamp",
        rounded(*s),
        rounded(*from),
        rounded(*to)
    )]
    NoMoment {
        /// The arc length \[m\].
        s: f64,
        /// That of the first bent vertex \[m\].
        from: f64,
        /// That of the last \[m\].
        to: f64,
    },
    /// A sensor on a section of a chain, whose edges have no sections.
    #[error("a chain has no sections that a sensor could be fixed to, and no moments")]
    NoFrames,
    /// The orientation of a section of a rod that has no angle about its tangent.
    #[error(
        "the rod has no angle about its tangent that an orientation could be of: it is a chain, or twists \
             nowhere and no clamp holds a director; observe its `direction`"
    )]
    NoAngle,
    /// The spin of a section is not in the state.
    #[error(
        "the spin of edge {edge} is not in the state: give the rod inertia against it, and take an edge \
             that no clamp holds"
    )]
    NoSpin {
        /// Number of the edge.
        edge: usize,
    },
    /// Forces of a state need strain rates that it does not have.
    #[error(
        "forces of a rod that twists with strain-rate damping need the angles of the state before, which \
         backward Euler does not keep: the schemes of second order, BDF2 and midpoint, do"
    )]
    NoRates,
    /// A coordinate, angle or prescribed value is not finite.
    #[error("{what} {index} is not finite")]
    NonFinite {
        /// Kind of quantity.
        what: &'static str,
        /// Its number.
        index: usize,
    },
    /// The twist equilibrium is (nearly) not a minimum: the step is discontinuous there and has no tangent.
    #[error(
        "the twist equilibrium folds at edge {edge}: pivot of the twist Hessian {pivot:e} of its natural size"
    )]
    TwistFold {
        /// The edge where the pivot vanishes.
        edge: usize,
        /// The pivot over GJ/l + EI/l there.
        pivot: f64,
    },
    /// An edge points against its direction at the start of a step: the spin of its section is undefined.
    #[error("edge {edge} turns over within one step, where its spin is undefined: a shorter step helps")]
    TurnedOver {
        /// Number of the edge.
        edge: usize,
    },
    /// A clamp turned so far within a step that whole turns cannot be told from none.
    #[error(
        "a clamp turns by {turn:.3} rad in the step from t = {} s to {} s, and more than a quarter \
         turn leaves its whole turns undecided: a shorter step or a slower drive helps",
        rounded(*from),
        rounded(*to)
    )]
    ClampTurns {
        /// Its turn about its tangent \[rad\].
        turn: f64,
        /// Start of the step \[s\].
        from: f64,
        /// Its end \[s\].
        to: f64,
    },
    /// No support at all: an equilibrium would fall or drift away.
    #[error("nothing holds the rod: it has no clamp and no prescribed vertex")]
    NothingHolds,
    /// A load turns sections, or follows them, or sections have inertia, of a rod without any stiffness that
    /// would hold them.
    #[error(
        "a moment, a force across the section that follows it, or twist inertia is asked of a rod without \
         sections: it has one segment, or neither bending nor twisting stiffness (a chain)"
    )]
    NoSections,
    /// The search for a shape at rest used up its iterations.
    #[error("no shape at rest was found in {iterations} Newton iterations: a first shape near it would help")]
    NotAtRest {
        /// Newton iterations of all stages together.
        iterations: usize,
    },
    /// A load without a potential, where modes are asked for.
    #[error("a load has no potential (drag, a follower force, a moment): the rod has no natural modes")]
    NoPotential,
    /// Natural modes that were not found.
    #[error(
        "{converged} of {count} natural modes converged: is stretching too stiff beside all else, by more \
         than 1e10?"
    )]
    Modes {
        /// Modes that converged.
        converged: usize,
        /// Modes asked for.
        count: usize,
    },
    /// A field of a description has an impossible value.
    #[error("{field}: {value} is not allowed (expected {expected})")]
    Value {
        /// Which field.
        field: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// An array of a description has the wrong length.
    #[error("{field} has {found} entries, expected {expected}")]
    Count {
        /// Which field.
        field: &'static str,
        /// How many were given.
        found: usize,
        /// How many are needed.
        expected: usize,
    },
    /// A place along the rod is outside it.
    #[error("{what} at arc length {} m is off the rod (0 to {} m)", rounded(*s), rounded(*length))]
    OffRod {
        /// What was placed.
        what: &'static str,
        /// Where \[m\].
        s: f64,
        /// Length of the rod \[m\].
        length: f64,
    },
    /// Two supports prescribe the same vertex, or a vertex that does not exist.
    #[error("vertex {vertex} cannot be prescribed: {reason}")]
    Support {
        /// Which vertex.
        vertex: usize,
        /// Why not.
        reason: &'static str,
    },
}

/// A number with the ten digits that matter in a message: 0.6, not 0.6000000000000001.
fn rounded(value: f64) -> f64 {
    format!("{value:.9e}").parse().unwrap_or(value)
}
