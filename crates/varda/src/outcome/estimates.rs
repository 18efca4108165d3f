//! Constants that were estimated, as plain data.

use serde::Serialize;

/// A constant whose σ_a is more than this share of its σ_b is not identifiable, and neither is its interval
/// narrower than this share of the prior's: the observations say nothing of it.
pub const IDENTIFIABLE: f64 = 0.9;
/// Two constants whose posterior correlation is at least this are seen together only.
const COLLINEAR: f64 = 0.95;

/// Whether this is the name of one value of an error in time of what was recorded.
pub(crate) fn is_of_input(name: &str) -> bool {
    name.contains("(t = ")
}

/// An estimated constant: prior and posterior in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimated {
    /// Name, as `ei[0]`.
    pub name: String,
    /// Its place on the rod \[m\], of one number of a field along it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arc_length: Option<f64>,
    /// SI unit; "1" for none.
    pub unit: &'static str,
    /// Value before the observations.
    pub prior: f64,
    /// Its σ.
    pub prior_sigma: f64,
    /// Value of the analysis.
    pub value: f64,
    /// Its σ, with an allowance for the mesh where there is one; `null` without a posterior.
    pub sigma: Option<f64>,
    /// σ that observations and priors leave, with the segments and the step of the scene.
    pub sigma_on_mesh: Option<f64>,
    /// What half the step and twice the segments say of the mesh's error of `value`; `null` in twins, and
    /// where it was not computed.
    pub mesh: Option<f64>,
    /// Ends of the interval that holds the constant with 95 %: by J along it where it was followed (up to 16
    /// constants, strong constraint), else by σ of a normal or log-normal constant.
    pub interval: Option<[f64; 2]>,
    /// Whether the observations say more of it than the prior: σ_a ≤ 0.9 σ_b, or an interval by J of less
    /// than 0.9 of the prior's; `null` without a posterior.
    pub identifiable: Option<bool>,
    /// Whether the interval alone says so: σ is that of the curvature of J at the analysis, and J grows
    /// faster away from it. Its posterior is not Gaussian.
    pub by_interval_alone: bool,
    /// Its value in the truth of a twin experiment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<f64>,
    /// Correlations with the other constants under the posterior, in their order; empty without a posterior.
    pub correlations: Vec<f64>,
}

impl Estimated {
    /// The field along the rod that it is a number of.
    pub fn field(&self) -> Option<&str> {
        self.arc_length.and_then(|_| self.name.split("(s = ").next())
    }

    /// Whether it is one value of a field along the rod, or of an error in time.
    pub(crate) fn is_of_field(&self) -> bool {
        self.arc_length.is_some() || self.is_of_input()
    }

    /// Whether it is one value of an error in time of what was recorded: whether the observations see each is
    /// no question.
    pub(crate) fn is_of_input(&self) -> bool {
        is_of_input(&self.name)
    }

    /// Whether more of σ is the mesh's than the observations'.
    pub fn is_of_mesh(&self) -> bool {
        self.mesh.zip(self.sigma_on_mesh).is_some_and(|(mesh, sigma)| mesh > sigma)
    }

    /// Its value with σ and unit, in words.
    pub fn in_words(&self) -> String {
        let unit = if self.unit == "1" { String::new() } else { format!(" {}", self.unit) };
        let number = short;
        let prior = format!("prior {} ± {}", number(self.prior), number(self.prior_sigma));
        let truth = self.truth.map_or(String::new(), |t| format!("; truth {}", number(t)));
        match (self.sigma, self.identifiable) {
            (Some(_), Some(false)) => format!("not identifiable ({prior}{unit}{truth})"),
            (Some(_), _) if self.by_interval_alone => {
                let [low, high] = self.interval.unwrap_or([self.value; 2]).map(number);
                format!("{low} to {high}{unit} with 95 %, not Gaussian ({prior}{truth})")
            }
            (Some(sigma), _) => {
                let mesh = match self.mesh.filter(|_| self.is_of_mesh()) {
                    Some(mesh) => format!("; {} of it for the mesh", number(mesh)),
                    None => String::new(),
                };
                format!("{} ± {}{unit} ({prior}{mesh}{truth})", number(self.value), number(sigma))
            }
            (None, _) => format!("{}{unit} ({prior}{truth})", number(self.value)),
        }
    }
}

/// Four digits.
fn short(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let digits = (3 - v.abs().log10().floor() as i64).clamp(0, 12) as usize;
    if v.abs() < 1e-4 || v.abs() >= 1e6 { format!("{v:.3e}") } else { format!("{v:.digits$}") }
}

/// What is to be said of the estimates: σ of a run that does not fit, constants that the observations do not
/// see, and such as they see together only.
pub fn remarks(all: &[Estimated], fits: bool) -> Vec<String> {
    let mut out = Vec::new();
    if !all.is_empty() && !fits {
        out.push(
            "σ of the estimated constants supposes that the run fits, and it does not: do not believe it"
                .into(),
        );
    }
    let mut unseen: Vec<String> = Vec::new();
    for e in all.iter().filter(|e| e.identifiable == Some(false) && !e.is_of_input()) {
        let name = match e.field() {
            Some(field) => {
                let of_it = |o: &&Estimated| o.field() == Some(field);
                let places = all.iter().filter(of_it);
                let dark = places.clone().filter(|o| o.identifiable == Some(false)).count();
                format!("{field} at {dark} of {} places", places.count())
            }
            None => e.name.clone(),
        };
        if unseen.last() != Some(&name) {
            unseen.push(name);
        }
    }
    if !unseen.is_empty() {
        out.push(format!(
            "not identifiable: {}: these observations leave more than {:.0} % of the prior's σ, and what is \
             printed is the prior",
            few(&unseen),
            100.0 * IDENTIFIABLE
        ));
    }
    let skewed: Vec<String> = all.iter().filter(|e| e.by_interval_alone).map(|e| e.name.clone()).collect();
    if !skewed.is_empty() {
        out.push(format!(
            "not Gaussian: {}: J is flat at the analysis and grows away from it, so that σ is more than \
             {:.0} % of the prior's while the 95 % interval is less: take the interval",
            few(&skewed),
            100.0 * IDENTIFIABLE
        ));
    }
    let mut seen = vec![false; all.len()];
    for i in 0..all.len() {
        // numbers of a field beside each other are alike by its prior
        let apart = |j: usize| all[i].field().is_none() || all[i].field() != all[j].field();
        let correlated = |j: usize| all[i].correlations.get(j).is_some_and(|c| c.abs() >= COLLINEAR);
        let like = |j: &usize| apart(*j) && correlated(*j) && !all[*j].is_of_input();
        let group: Vec<usize> = (i..all.len()).filter(|j| !seen[*j] && (*j == i || like(j))).collect();
        if seen[i] || all[i].is_of_input() || group.len() < 2 {
            continue;
        }
        group.iter().for_each(|j| seen[*j] = true);
        let names: Vec<String> = group.iter().map(|j| all[*j].name.clone()).collect();
        let least = group[1..].iter().map(|j| all[i].correlations[*j].abs()).fold(1.0, f64::min);
        out.push(format!(
            "{} are seen together only (correlation {least:.3} or more): their combination is known better \
             than each",
            few(&names)
        ));
    }
    out.extend(of_inputs(all));
    out
}

/// How far recorded places were moved: the root mean squares of the numbers of an error in time.
fn of_inputs(all: &[Estimated]) -> Vec<String> {
    let mut out = Vec::new();
    let inputs: Vec<&Estimated> = all.iter().filter(|e| e.is_of_input()).collect();
    let support = |e: &Estimated| e.name.split_inclusive(']').next().unwrap_or_default().to_string();
    for of in inputs.chunk_by(|a, b| support(a) == support(b)) {
        let mean = |of_one: &dyn Fn(&Estimated) -> f64| {
            (of.iter().map(|e| of_one(e).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
        };
        let unit = of[0].unit;
        let sigma = match of.iter().all(|e| e.sigma.is_some()) {
            true => format!(
                ", σ of each {:.2e} {unit} before and {:.2e} {unit} after",
                of[0].prior_sigma,
                mean(&|e| { e.sigma.unwrap_or(f64::NAN) })
            ),
            false => String::new(),
        };
        out.push(format!(
            "{}: the recorded {} by an error of {} numbers, {:.2e} {unit} in the root mean square{sigma}",
            support(of[0]),
            if unit == "rad" { "rotation is turned" } else { "place is moved" },
            of.len(),
            mean(&|e| e.value)
        ));
    }
    out
}

fn few(names: &[String]) -> String {
    const SHOWN: usize = 6;
    match names.len() {
        n if n <= SHOWN => names.join(", "),
        n => format!("{} and {} others", names[..SHOWN].join(", "), n - SHOWN),
    }
}
