//! `[limits]`: how much of the machine a run may use.

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use varda_implicit::Storage;

/// Most bytes a run may plan for by default: half of the memory of an ordinary machine.
pub const DEFAULT_MEMORY: usize = 8_000_000_000;

/// How much of the machine a run may use.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Most memory a run may plan for, such as "200 MB" (B, kB, MB, GB; KiB, MiB, GiB); "8 GB" where it is
    /// not given. What covariances, Hessians and tables leave of it is for the states and linearizations of a
    /// window: where that is too little to keep all, a strong constraint computes linearizations and then
    /// states again, the same bits in more time. A run that needs more than the limit is refused.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub memory: String,
    /// Most seconds of a run \[s\], reading files and setting up included: looked at after every iteration
    /// and, once there is a J, at every step of the model and during large decompositions (of cycles, after
    /// every window). A run that takes longer ends with the best point so far, status "interrupted", and
    /// writes its report, without posterior; for a forecast and the report it takes the
    /// time it needs. None where it is not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub seconds: Option<f64>,
}

impl Limits {
    /// The limit in bytes.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn bytes(&self) -> Result<usize, String> {
        let text = self.memory.trim();
        if text.is_empty() {
            return Ok(DEFAULT_MEMORY);
        }
        let unit = text.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
        let number: f64 = text[..text.len() - unit.len()].parse().unwrap_or(f64::NAN);
        let factor = match unit.trim() {
            "" | "B" => 1.0,
            "kB" => 1e3,
            "MB" => 1e6,
            "GB" => 1e9,
            "KiB" => 1024.0,
            "MiB" => 1024.0 * 1024.0,
            "GiB" => 1024.0 * 1024.0 * 1024.0,
            _ => f64::NAN,
        };
        let bytes = number * factor;
        if (1.0..1e18).contains(&bytes) {
            Ok(bytes as usize)
        } else {
            Err(format!(
                "{:?} is not an amount of memory; write a number and B, kB, MB or GB: \"200 MB\"",
                self.memory
            ))
        }
    }

    /// Whether a run that has taken so long is to end.
    pub fn over(&self, elapsed: Duration) -> bool {
        self.seconds.is_some_and(|most| elapsed.as_secs_f64() >= most)
    }

    /// That it ended for that reason.
    pub fn remark(&self) -> Option<String> {
        let seconds = self.seconds?;
        Some(format!("the run ended after the {seconds} s that limits.seconds allows"))
    }

    /// What a storage leaves out of a window of `steps` steps, in words; nothing where all is kept.
    pub fn left_out(&self, storage: Storage, steps: usize) -> Option<String> {
        let limit = if self.memory.is_empty() { "8 GB" } else { &self.memory };
        let for_limit = format!("limits.memory = {limit:?}");
        match storage {
            Storage::States => Some(format!(
                "linearizations of all steps but one: every sweep makes them again ({for_limit})"
            )),
            Storage::Checkpoints { states } => Some(format!(
                "all states but {states} of {}: a gradient runs {} steps ({for_limit})",
                steps + 1,
                storage.executed_steps(steps)
            )),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_of_memory_are_read_with_their_units() {
        let bytes = |text: &str| Limits { memory: text.to_string(), ..Limits::default() }.bytes();
        assert_eq!(bytes(""), Ok(8_000_000_000));
        for (text, expected) in
            [("200 MB", 200_000_000), ("1.5GB", 1_500_000_000), ("64 KiB", 65_536), ("512", 512)]
        {
            assert_eq!(bytes(text), Ok(expected), "{text}");
        }
        for text in ["200 mb", "MB", "-3 MB", "1.2.3 MB", "0 B", "much", "9e9 GB"] {
            assert!(bytes(text).is_err(), "{text}");
        }
    }
}
