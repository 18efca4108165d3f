//! Which runs a study has: the product of the values of its keys, times the seeds.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::scene::SceneFile;
use crate::setup::files::checksum;
use crate::setup::{Inputs, Recordings};

/// The most runs of a study.
const MOST_RUNS: usize = 1_000_000;

/// A key and its values, as they are written after `--set`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Swept {
    /// The dotted key.
    pub key: String,
    /// Its values as TOML.
    pub values: Vec<String>,
}

/// What a study is: sweep.json.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the scene.
    pub scene: String,
    /// Its title.
    pub title: String,
    /// Version of Varda.
    pub version: String,
    /// The keys; the last one changes fastest.
    pub swept: Vec<Swept>,
    /// The seeds of each combination.
    pub seeds: Vec<u64>,
    /// Of each combination, a checksum of the data files that it reads.
    pub data: Vec<String>,
    /// The text of the scene.
    pub text: String,
}

/// One run of a study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Run {
    /// Its place in the grid, from 0: combination by combination, seeds within each.
    pub index: usize,
    /// `key=value`, for each key.
    pub settings: Vec<String>,
    /// Its seed.
    pub seed: u64,
    /// Of all that its result follows from: scene, settings, seed, data files and version.
    pub checksum: String,
}

impl Plan {
    /// The study of a scene. `sets` are `key=a,b,c`; `seeds` is as `0..99` (99 included), `3` or `0,3,7`, by
    /// default the seed of the scene. Every combination is checked as `varda check` checks a scene's text.
    ///
    /// ```
    /// use varda::sweep::grid::Plan;
    ///
    /// let sets = ["observations.sigma=1.0,2.0".to_string(), "observations.every=5,10".to_string()];
    /// let plan = Plan::new("lorenz63", &sets, Some("0..2"))?;
    /// assert_eq!((plan.combinations(), plan.count()), (4, 12));
    /// assert_eq!(plan.run(4).settings, ["observations.sigma=1.0", "observations.every=10"]);
    /// assert_eq!(plan.run(4).seed, 1);
    /// # Ok::<(), varda::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Scene`] naming the `--set`, the `--seeds` or the line of the scene; as [`SceneFile::open`].
    pub fn new(scene: &str, sets: &[String], seeds: Option<&str>) -> Result<Plan, Error> {
        let mut swept: Vec<Swept> = Vec::new();
        for set in sets {
            let one = Swept::parse(set)?;
            let given = |message: &str| Err(wrong(format!("--set {set}"), message.into()));
            if swept.iter().any(|other| other.key == one.key) {
                return given(&format!("{} is given twice: write all its values in one list", one.key));
            }
            if one.key == "seed" {
                return given("seeds have an option of their own, for example --seeds 0..99");
            }
            swept.push(one);
        }
        let first = SceneFile::open(scene, &[])?;
        let seeds = seeds.map_or_else(|| Ok(vec![first.scene.seed]), parse_seeds)?;
        let mut counts = swept.iter().map(|s| s.values.len()).chain([seeds.len()]);
        let count = counts.try_fold(1_usize, |all, n| all.checked_mul(n));
        if count.is_none_or(|count| count > MOST_RUNS) {
            return Err(wrong("sweep".into(), format!("a sweep has at most {MOST_RUNS} runs")));
        }
        let mut plan = Plan {
            scene: first.name.clone(),
            title: first.scene.title.clone(),
            version: env!("CARGO_PKG_VERSION").into(),
            swept,
            seeds,
            data: Vec::new(),
            text: first.text().to_string(),
        };
        let largest = plan.seeds.iter().max().copied().unwrap_or(0);
        for combination in 0..plan.combinations() {
            let mut settings = plan.settings(combination);
            settings.push(format!("seed={largest}"));
            plan.data.push(data_files(&SceneFile::open(scene, &settings)?));
        }
        Ok(plan)
    }

    /// How many combinations of values.
    pub fn combinations(&self) -> usize {
        self.swept.iter().map(|s| s.values.len()).product()
    }

    /// How many runs.
    pub fn count(&self) -> usize {
        self.combinations() * self.seeds.len()
    }

    /// The values of a combination, key by key.
    ///
    /// # Panics
    /// If the plan has no such combination.
    pub fn values(&self, combination: usize) -> Vec<&str> {
        assert!(combination < self.combinations(), "{combination} of {}", self.combinations());
        let mut rest = combination;
        let value = |s: &'_ Swept| {
            let at = rest % s.values.len();
            rest /= s.values.len();
            at
        };
        let mut places: Vec<usize> = self.swept.iter().rev().map(value).collect();
        places.reverse();
        self.swept.iter().zip(places).map(|(s, at)| s.values[at].as_str()).collect()
    }

    /// One of the runs.
    ///
    /// # Panics
    /// If the plan has no such run.
    pub fn run(&self, index: usize) -> Run {
        let combination = index / self.seeds.len();
        let settings = self.settings(combination);
        let seed = self.seeds[index % self.seeds.len()];
        let all =
            format!("{}\n{settings:?}\n{seed}\n{}\n{}", self.text, self.data[combination], self.version);
        Run { index, settings, seed, checksum: format!("{:016x}", checksum(&all)) }
    }

    fn settings(&self, combination: usize) -> Vec<String> {
        let values = self.values(combination);
        self.swept.iter().zip(values).map(|(s, value)| format!("{}={value}", s.key)).collect()
    }

    /// What another plan has otherwise, in words; `None` where they are the same.
    pub fn difference(&self, other: &Plan) -> Option<String> {
        let keys = |plan: &Plan| plan.swept.iter().map(|s| s.key.clone()).collect::<Vec<_>>().join(", ");
        if self.scene != other.scene {
            return Some(format!("its scene is {}, not {}", self.scene, other.scene));
        }
        if self.version != other.version {
            return Some(format!("version {} has made it, this is {}", self.version, other.version));
        }
        if self.text != other.text {
            return Some("the text of the scene has changed".into());
        }
        if keys(self) != keys(other) {
            return Some(format!("its keys are [{}], not [{}]", keys(self), keys(other)));
        }
        for (a, b) in self.swept.iter().zip(&other.swept) {
            if a.values != b.values {
                return Some(format!("its {} is {}, not {}", a.key, a.values.join(","), b.values.join(",")));
            }
        }
        if self.seeds != other.seeds {
            return Some(format!("it has {} other seeds, from {}", self.seeds.len(), self.seeds[0]));
        }
        (self.data != other.data).then(|| "a data file of the scene has changed".into())
    }
}

/// The checksum of the data files of a scene. Where they cannot be read its run will say why.
fn data_files(file: &SceneFile) -> String {
    let inputs = match file.has_recordings() {
        true => Recordings::inputs(file),
        false => Inputs::read(file).map(|inputs| vec![inputs]),
    };
    let read = inputs.unwrap_or_default();
    let files = read.iter().flat_map(|inputs| &inputs.files);
    let all: String = files.map(|f| format!("{} {:016x}\n", f.key, f.checksum)).collect();
    format!("{:016x}", checksum(&all))
}

impl Swept {
    /// Of `key=a,b,c`. A comma within quotes, brackets or braces divides nothing.
    fn parse(set: &str) -> Result<Swept, Error> {
        let bad = |message: &str| wrong(format!("--set {set}"), message.into());
        let (key, text) = set
            .split_once('=')
            .ok_or_else(|| bad("expected key=a,b,c, for example --set observations.sigma=0.01,0.02"))?;
        let values = divided(text).ok_or_else(|| bad("a quote, bracket or brace is not closed"))?;
        if values.iter().any(String::is_empty) {
            return Err(bad("one of the values is empty"));
        }
        if let Some(i) = (1..values.len()).find(|i| values[..*i].contains(&values[*i])) {
            return Err(bad(&format!("{} is there twice", values[i])));
        }
        Ok(Swept { key: key.trim().to_string(), values })
    }
}

/// The parts between commas outside quotes, brackets and braces; `None` where one of these is not closed.
fn divided(text: &str) -> Option<Vec<String>> {
    let (mut parts, mut open, mut quote) = (vec![String::new()], Vec::new(), None);
    let mut escaped = false;
    for c in text.chars() {
        match (quote, c) {
            (Some('"'), '\\') if !escaped => {
                escaped = true;
                parts.last_mut()?.push(c);
                continue;
            }
            (Some(q), _) if c == q && !escaped => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[') => open.push(']'),
            (None, '{') => open.push('}'),
            (None, ']' | '}') if open.pop() != Some(c) => return None,
            (None, ',') if open.is_empty() => {
                parts.push(String::new());
                continue;
            }
            _ => {}
        }
        escaped = false;
        parts.last_mut()?.push(c);
    }
    let closed = open.is_empty() && quote.is_none();
    closed.then(|| parts.iter().map(|part| part.trim().to_string()).collect())
}

/// Seeds as `0..99` (99 included), `3`, or a list of these.
fn parse_seeds(text: &str) -> Result<Vec<u64>, Error> {
    let bad = |message: String| wrong(format!("--seeds {text}"), message);
    let number = |part: &str| -> Result<u64, Error> {
        let seed = part.trim().parse::<u64>();
        seed.map_err(|_| bad(format!("{part:?} is no seed; expected 0..99, 3 or 0,3,7")))
    };
    let mut seeds = Vec::new();
    for part in text.split(',') {
        let (first, last) = match part.split_once("..") {
            Some((first, last)) => (number(first)?, number(last)?),
            None => (number(part)?, number(part)?),
        };
        if last < first {
            return Err(bad(format!("{part} has no seeds: its end is before its start")));
        }
        if last - first >= (MOST_RUNS - seeds.len()) as u64 {
            return Err(bad(format!("a sweep has at most {MOST_RUNS} runs")));
        }
        seeds.extend(first..=last);
    }
    let mut sorted = seeds.clone();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(bad(format!("seed {} is there twice", pair[0]))),
        None => Ok(seeds),
    }
}

/// The share of one job among several: runs `which − 1`, `which − 1 + of`, …
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Which share, from 1.
    pub which: usize,
    /// Among how many.
    pub of: usize,
}

impl Part {
    /// All runs.
    pub const WHOLE: Part = Part { which: 1, of: 1 };

    /// Of `3/20`.
    ///
    /// # Errors
    /// [`Error::Scene`] naming the option.
    pub fn parse(text: &str) -> Result<Part, Error> {
        let numbers = text.split_once('/').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        match numbers {
            Some((which, of)) if 1 <= which && which <= of => Ok(Part { which, of }),
            _ => Err(wrong(format!("--part {text}"), "expected a share as 3/20: the third of twenty".into())),
        }
    }

    /// The runs of this share, by their places in a grid of so many.
    pub fn runs(self, count: usize) -> impl Iterator<Item = usize> {
        (self.which - 1..count).step_by(self.of)
    }
}

fn wrong(place: String, message: String) -> Error {
    Error::Scene { place, message, excerpt: String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commas_within_quotes_brackets_and_braces_divide_nothing() {
        let parts = |text| divided(text).unwrap();
        assert_eq!(parts("1, 2.5 ,x"), ["1", "2.5", "x"]);
        assert_eq!(parts("[1,2],[3,[4,5]]"), ["[1,2]", "[3,[4,5]]"]);
        assert_eq!(parts(r#""a,b",'c,"d',e"#), [r#""a,b""#, r#"'c,"d'"#, "e"]);
        assert_eq!(parts(r#""a\",b",c"#), [r#""a\",b""#, "c"]);
        assert_eq!(parts("{ k = [1,2], s = 3 },0"), ["{ k = [1,2], s = 3 }", "0"]);
        for text in ["[1,2", "1]", "\"a", "{1,2]", "'a"] {
            assert_eq!(divided(text), None, "{text}");
        }
    }

    #[test]
    fn seeds_are_ranges_numbers_and_lists() {
        assert_eq!(parse_seeds("0..3").unwrap(), [0, 1, 2, 3]);
        assert_eq!(parse_seeds("7").unwrap(), [7]);
        assert_eq!(parse_seeds("9,0..1, 4").unwrap(), [9, 0, 1, 4]);
        for text in ["", "a", "3..1", "0..", "..4", "-1", "1,1", "0..3,2", "0..18446744073709551615"] {
            assert!(parse_seeds(text).is_err(), "{text}");
        }
    }

    #[test]
    fn parts_take_every_run_once() {
        let mut all: Vec<usize> = (1..=3).flat_map(|which| Part { which, of: 3 }.runs(10)).collect();
        all.sort_unstable();
        assert_eq!(all, (0..10).collect::<Vec<_>>());
        for text in ["0/3", "4/3", "1", "a/b", "1/0"] {
            assert!(Part::parse(text).is_err(), "{text}");
        }
    }
}
