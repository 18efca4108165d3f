//! What a recording holds, and where its rows went.

use std::fmt;

use serde::Serialize;

use super::quantity::Quantity;

/// A recording as its file has it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingSummary {
    /// What its sites are.
    pub sites_are: SitesAre,
    /// Where its rows went.
    pub rows: RowCount,
    /// Times of the first and last row, as the file has them \[s\].
    pub span: [f64; 2],
    /// The window in the file's time \[s\].
    pub window: [f64; 2],
    /// Its markers or arc lengths, in the order of the scene and the file.
    pub tracks: Vec<TrackSummary>,
    /// Neighbours along the rod that were seen at the same times.
    pub neighbours: Vec<Neighbours>,
}

/// What a recording observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SitesAre {
    /// Points of a rod, with values in metres.
    Markers,
    /// Components of a state.
    Components,
    /// Places on the line of a field.
    Places,
}

impl SitesAre {
    /// What they are called.
    pub fn name(self) -> &'static str {
        match self {
            SitesAre::Markers => "markers",
            SitesAre::Components => "components",
            SitesAre::Places => "places",
        }
    }
}

/// Numbers of rows: `all` is the sum of the others.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RowCount {
    /// Rows of the file.
    pub all: usize,
    /// Assimilated.
    pub used: usize,
    /// In the window, of markers that are kept back.
    pub withheld: usize,
    /// After the window, where the forecast is judged.
    pub forecast: usize,
    /// Before the window, or after it and its forecast.
    pub outside: usize,
    /// Refused: they cannot be true.
    pub refused: usize,
    /// The same time, place and values as another row.
    pub repeated: usize,
    /// Of markers that are ignored, or that move a support.
    pub ignored: usize,
    /// Nothing was seen.
    pub empty: usize,
}

impl RowCount {
    /// The sum of all parts.
    pub fn parts(&self) -> usize {
        self.named().iter().map(|(count, _)| count).sum()
    }

    fn named(&self) -> [(usize, &'static str); 8] {
        [
            (self.used, "used"),
            (self.withheld, "kept back"),
            (self.forecast, "of the forecast"),
            (self.outside, "outside"),
            (self.refused, "refused"),
            (self.repeated, "repeated"),
            (self.ignored, "ignored"),
            (self.empty, "empty"),
        ]
    }
}

/// "918 rows = 612 used + 306 outside"; used, refused and outside are always there.
impl fmt::Display for RowCount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let always = ["used", "refused", "outside"];
        let shown = self.named().into_iter().filter(|(n, what)| *n > 0 || always.contains(what));
        let parts: Vec<String> = shown.map(|(n, what)| format!("{n} {what}")).collect();
        write!(f, "{} rows = {}", self.all, parts.join(" + "))
    }
}

/// A marker, a component, or a place, as a recording has it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackSummary {
    /// Its name.
    pub label: String,
    /// What its values are.
    pub quantity: Quantity,
    /// Rows in which it was seen.
    pub rows: usize,
    /// Median time from one row to the next \[s\]; 0 for a single row.
    pub interval: f64,
    /// Begin and length of the longest gap \[s\], where one is longer than two rows.
    pub gap: Option<[f64; 2]>,
    /// Scatter of a coordinate or value about a smooth motion, in its unit, from third differences in
    /// time: noise, and what moves within a few rows. `None` where rows are few or not at even times.
    pub scatter: Option<f64>,
    /// Mean σ of its rows, in their unit.
    pub sigma: f64,
}

/// Two neighbours along the rod.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Neighbours {
    /// Their names, in the order of arc length.
    pub labels: [String; 2],
    /// The arc length between them \[m\].
    pub arc: f64,
    /// The largest distance at which they were seen \[m\].
    pub farthest: f64,
    /// The largest that the rod between them allows, with its strain, offsets and 4 σ \[m\].
    pub allowed: f64,
}

#[cfg(test)]
mod tests {
    use super::RowCount;

    #[test]
    fn rows_are_the_sum_of_their_parts() {
        let rows = RowCount { all: 10, used: 6, outside: 3, ignored: 1, ..RowCount::default() };
        assert_eq!(rows.to_string(), "10 rows = 6 used + 3 outside + 0 refused + 1 ignored");
        assert_eq!(rows.parts(), rows.all);
    }
}
