//! What kind of value was observed.

use serde::Serialize;

/// What the values of a site are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Coordinates x, y, z of a point of a rod \[m\].
    Place,
    /// Pixel (u, v) of a point of a rod in a camera \[px\].
    Pixels,
    /// Components of a force \[N\].
    Force,
    /// A force along the rod \[N\].
    AxialForce,
    /// Components of the moment of a clamp \[N m\].
    SupportMoment,
    /// Moments within a rod that bend it as κ₁ and κ₂, and that which twists it \[N m\].
    Moment,
    /// Components of an acceleration, or of one less gravity [m/s²].
    Acceleration,
    /// Two angles from a direction that was read \[rad\].
    Direction,
    /// A rotation vector from an orientation that was read, along the axes of the body \[rad\].
    Orientation,
    /// Angular rates along m₁ and m₂ of a section [rad/s].
    AngularRate,
    /// The angular rate about its tangent [rad/s].
    Spin,
    /// A component of a state, or a field at a place, in its own unit.
    Component,
}

impl Quantity {
    /// Those of what is observed of a rod.
    pub const OF_RODS: [Quantity; 11] = [
        Quantity::Place,
        Quantity::Pixels,
        Quantity::Force,
        Quantity::AxialForce,
        Quantity::SupportMoment,
        Quantity::Moment,
        Quantity::Acceleration,
        Quantity::Direction,
        Quantity::Orientation,
        Quantity::AngularRate,
        Quantity::Spin,
    ];

    /// Names of its values; one without a name of a component.
    pub fn axes(self) -> &'static [&'static str] {
        match self {
            Quantity::Place => &["x", "y", "z"],
            Quantity::Pixels => &["u", "v"],
            Quantity::Force => &["fx", "fy", "fz"],
            Quantity::AxialForce => &["f"],
            Quantity::SupportMoment => &["mx", "my", "mz"],
            Quantity::Moment => &["m1", "m2", "t"],
            Quantity::Acceleration => &["ax", "ay", "az"],
            Quantity::Direction => &["r1", "r2"],
            Quantity::Orientation => &["rx", "ry", "rz"],
            Quantity::AngularRate => &["w1", "w2"],
            Quantity::Spin => &["w"],
            Quantity::Component => &[""],
        }
    }

    /// The unit of its values; nothing where the scene does not say.
    pub fn unit(self) -> &'static str {
        match self {
            Quantity::Place => "m",
            Quantity::Pixels => "px",
            Quantity::Force | Quantity::AxialForce => "N",
            Quantity::SupportMoment | Quantity::Moment => "N m",
            Quantity::Acceleration => "m/s²",
            Quantity::Direction | Quantity::Orientation => "rad",
            Quantity::AngularRate | Quantity::Spin => "rad/s",
            Quantity::Component => "",
        }
    }

    /// The unit that distances are shown in, and how many of it one of [`unit`](Self::unit) is.
    pub fn shown(self) -> (f64, &'static str) {
        match self {
            Quantity::Place => (1e3, "mm"),
            Quantity::Pixels => (1.0, "px"),
            Quantity::Force | Quantity::AxialForce => (1e3, "mN"),
            Quantity::SupportMoment | Quantity::Moment => (1e3, "mN m"),
            Quantity::Acceleration => (1.0, "m/s²"),
            Quantity::Direction | Quantity::Orientation => (1e3, "mrad"),
            Quantity::AngularRate | Quantity::Spin => (1e3, "mrad/s"),
            Quantity::Component => (1.0, ""),
        }
    }

    /// The unit after a space; nothing where there is none.
    pub fn unit_after(self) -> &'static str {
        match self {
            Quantity::Place => " m",
            Quantity::Pixels => " px",
            Quantity::Force | Quantity::AxialForce => " N",
            Quantity::SupportMoment | Quantity::Moment => " N m",
            Quantity::Acceleration => " m/s²",
            Quantity::Direction | Quantity::Orientation => " rad",
            Quantity::AngularRate | Quantity::Spin => " rad/s",
            Quantity::Component => "",
        }
    }
}
