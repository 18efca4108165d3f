//! What constants that are taken for known do to results.

use serde::Serialize;

/// One number of the result, and how it depends on the constants of `[consider]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Considered {
    /// What it is, as "x at s = 1 m, t = 2 s", or the name of an estimated constant.
    pub of: String,
    /// SI unit.
    pub unit: &'static str,
    /// Its σ, constants known and on this mesh; `null` without a posterior.
    pub sigma: Option<f64>,
    /// The same with σ of all constants that are considered, independent of each other; the analysis
    /// stays as it is.
    pub sigma_with_considered: Option<f64>,
    /// Constant by constant.
    pub by: Vec<ByConstant>,
}

impl Considered {
    /// What these constants do to it, in words.
    pub fn in_words(&self) -> String {
        let unit = if self.unit == "1" { String::new() } else { format!(" {}", self.unit) };
        let by: Vec<String> = self.by.iter().map(|c| format!("{} {:+.3e}", c.name, c.moves)).collect();
        let sigma = match (self.sigma, self.sigma_with_considered) {
            (Some(sigma), Some(with)) => format!("σ {sigma:.3e} -> {with:.3e}{unit} "),
            _ => String::new(),
        };
        format!("{}: {sigma}(by one σ of {})", self.of, by.join(", "))
    }
}

/// The derivative of a number of the result by a constant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByConstant {
    /// The constant.
    pub name: String,
    /// Its SI unit.
    pub unit: &'static str,
    /// Its value in the scene.
    pub value: f64,
    /// What the scene says of its σ, in its unit.
    pub sigma: f64,
    /// The derivative of the number by the constant, the minimum moving with it; in the unit of the number
    /// over that of the constant.
    pub derivative: f64,
    /// How far the number moves with one σ of the constant.
    pub moves: f64,
}
