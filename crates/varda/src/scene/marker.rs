//! Markers of a rod.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;

/// A marker and its place on the rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Its name in the column `marker`.
    pub name: String,
    /// Arc length of its section [m].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// Its place in the frame of the section, along (m₁, m₂, t) [m].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "m"))]
    pub offset: [f64; 3],
    /// What it is used for.
    #[serde(default, rename = "use")]
    pub used: Use,
}

/// What a marker is used for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Use {
    /// Assimilated.
    #[default]
    Assimilate,
    /// Kept back: the report compares the analysis with it.
    Withhold,
}
