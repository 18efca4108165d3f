//! The scenes that come with the binary, and the data they name.

use super::schema_check;
use crate::Error;

/// A scene that comes with the binary.
#[derive(Debug, Clone, Copy)]
pub struct Shipped {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its TOML.
    pub text: &'static str,
}

macro_rules! shipped {
    ($($name:literal)*) => {
        &[$(Shipped { name: $name, text: include_str!(concat!("../../scenes/", $name, ".toml")) }),*]
    };
}

/// All of them, in the order in which they are listed. `hanging-rod` stands for `hanging-rod-case1`.
pub const SHIPPED: &[Shipped] = shipped![
    "hanging-rod-case1"
    "hanging-rod-case2"
    "hanging-rod-case3"
    "hanging-rod-case4"
    "hanging-rod-case4-plain"
    "hanging-rod-csv"
    "hanging-rod-cycling"
    "hanging-rod-weak"
    "beam-release"
    "hose"
    "soft-arm"
    "cable-between-posts"
    "tether-on-base"
    "twisted-rod"
    "rope-two-cameras"
    "tether-in-current"
    "wire"
    "wires"
    "lorenz63"
    "lorenz63-window"
    "lorenz96"
    "lorenz96-cycling-3dvar"
    "lorenz96-cycling-4dvar"
    "lorenz96-cycling-4denvar"
    "lorenz96-4denvar"
    "linear-advection"
    "burgers"
];

/// What `varda new` writes.
pub const STARTER: &str = include_str!("../../scenes/starter.toml");

const DATA: &[(&str, &str)] = &[
    ("data/beam-release.csv", include_str!("../../scenes/data/beam-release.csv")),
    ("data/cable-between-posts.csv", include_str!("../../scenes/data/cable-between-posts.csv")),
    ("data/hanging-rod-background.csv", include_str!("../../scenes/data/hanging-rod-background.csv")),
    ("data/hanging-rod-observations.csv", include_str!("../../scenes/data/hanging-rod-observations.csv")),
    ("data/hose.csv", include_str!("../../scenes/data/hose.csv")),
    ("data/soft-arm.csv", include_str!("../../scenes/data/soft-arm.csv")),
    ("data/tether-on-base-poses.csv", include_str!("../../scenes/data/tether-on-base-poses.csv")),
    ("data/tether-on-base.csv", include_str!("../../scenes/data/tether-on-base.csv")),
    ("data/rope-pixels.csv", include_str!("../../scenes/data/rope-pixels.csv")),
    ("data/tether-pull.csv", include_str!("../../scenes/data/tether-pull.csv")),
    ("data/wire-white-0.csv", include_str!("../../scenes/data/wire-white-0.csv")),
    ("data/wire-white-2.csv", include_str!("../../scenes/data/wire-white-2.csv")),
    ("data/wire.csv", include_str!("../../scenes/data/wire.csv")),
];

/// The shipped scene of a name.
///
/// # Errors
/// [`Error::NoScene`] with the nearest name.
pub fn shipped_scene(name: &str) -> Result<&'static Shipped, Error> {
    find(name).ok_or_else(|| not_found(name))
}

/// The files that the text of a shipped scene names, and their texts.
pub fn shipped_data(scene: &str) -> impl Iterator<Item = (&'static str, &'static str)> {
    DATA.iter().copied().filter(move |(file, _)| scene.contains(&format!("\"{file}\"")))
}

/// That there is no scene of a name, with the nearest one.
pub(super) fn not_found(name: &str) -> Error {
    let names: Vec<&str> = SHIPPED.iter().map(|s| s.name).collect();
    let suggestion =
        schema_check::nearest(name, &names).map_or(String::new(), |n| format!(", did you mean {n:?}?"));
    Error::NoScene { name: name.to_string(), suggestion }
}

pub(super) fn find(name: &str) -> Option<&'static Shipped> {
    let name = if name == "hanging-rod" { "hanging-rod-case1" } else { name };
    SHIPPED.iter().find(|s| s.name == name)
}

pub(super) fn data(file: &str) -> Option<&'static str> {
    DATA.iter().find(|d| d.0 == file).map(|d| d.1)
}
