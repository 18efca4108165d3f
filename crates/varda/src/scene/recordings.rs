//! `[[recordings]]`: several recordings of one system, and what differs between them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::defaults::is_default;
use super::tree::{self, Node};

/// Keys of a scene, in place of or beside its own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Keys(pub(super) Map<String, Value>);

/// One of several recordings of one system: its state at the start is its own, and the constants of
/// `[estimate]` are those of all. Its tables have the keys that differ from the scene's; a table with another
/// `kind` stands in place of the scene's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OneRecording {
    /// Its name, that of its folder in the result: letters, digits, "-" and "_".
    pub name: String,
    /// Keys of [observations].
    #[serde(default, skip_serializing_if = "is_default")]
    pub observations: Keys,
    /// Keys of [time].
    #[serde(default, skip_serializing_if = "is_default")]
    pub time: Keys,
    /// Keys of [background].
    #[serde(default, skip_serializing_if = "is_default")]
    pub background: Keys,
    /// Keys of [model]: what holds the rod and moves it, its shape at the start.
    #[serde(default, skip_serializing_if = "is_default")]
    pub model: Keys,
    /// Constants of this recording alone, beside those of all in [estimate]: how its camera was mounted, how
    /// its clamps were set.
    #[serde(default, skip_serializing_if = "is_default")]
    pub estimate: Keys,
}

const TABLES: [&str; 5] = ["observations", "time", "background", "model", "estimate"];

/// The scenes of the recordings, as trees: each the whole with one recording's keys.
pub(super) fn trees(root: &Node, count: usize) -> Vec<Node> {
    let mut whole = root.clone();
    whole.remove("recordings");
    let Some(all) = root.child("recordings") else { return Vec::new() };
    let one = |i: usize| {
        let mut part = whole.clone();
        for table in TABLES {
            if let Some(keys) = all.item(i).and_then(|item| item.child(table)) {
                tree::merge(part.child_or_table(table, &keys.place), keys);
            }
        }
        part
    };
    (0..count).map(one).collect()
}
