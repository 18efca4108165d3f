//! Charts as plain data: curves, bands, points and images with labelled axes, one panel or several side by
//! side. `svg` draws them as files, the page of a result in the browser.

use serde::{Serialize, Serializer};

/// A chart of one or more panels.
#[derive(Clone, Serialize)]
pub struct Figure {
    /// Its file name, without ending.
    pub name: String,
    /// Title, and alternative text of the picture.
    pub title: String,
    /// Row by row.
    pub panels: Vec<Panel>,
    /// Panels in a row.
    pub columns: usize,
    /// Size of one panel in the file \[px\].
    pub panel_size: (u32, u32),
}

/// One set of axes.
#[derive(Clone, Default, Serialize)]
pub struct Panel {
    /// Written above; may be empty.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// x on a logarithmic scale; points without a logarithm are left out.
    pub log_x: bool,
    /// y on a logarithmic scale; points without a logarithm are left out.
    pub log_y: bool,
    /// On the page y is linear near 0 and logarithmic far from it.
    pub symlog_y: bool,
    /// Both axes have the same scale, and these ranges.
    pub equal: Option<[(f64, f64); 2]>,
    /// Where the legend is; `None` for no legend.
    pub legend: Option<Corner>,
    /// Areas behind the curves.
    pub bands: Vec<Band>,
    /// The curves, those drawn last on top.
    pub series: Vec<Series>,
    /// Numbers drawn as colours, in place of curves.
    pub image: Option<Image>,
    /// No axes: the names of the series, a line each.
    pub is_key: bool,
}

/// Where a legend is. At the top it gets room of its own above the curves.
#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Corner {
    /// Above the curves.
    Top,
    /// Over the curves, lower left.
    LowerLeft,
    /// Over the curves, lower right.
    LowerRight,
}

/// One curve or cloud of points.
#[derive(Clone, Serialize)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// How it is drawn.
    pub style: Style,
    /// (x, y), in the order they are joined.
    #[serde(serialize_with = "columns")]
    pub points: Vec<(f64, f64)>,
}

/// The area between two curves, as the 95 % interval of a curve.
#[derive(Clone, Serialize)]
pub struct Band {
    /// Its name in the legend.
    pub label: String,
    /// That of the curve it belongs to.
    pub style: Style,
    /// (x, lower, upper) by ascending x.
    #[serde(serialize_with = "three_columns")]
    pub points: Vec<(f64, f64, f64)>,
}

/// Numbers on a grid, drawn as colours.
#[derive(Clone, Serialize)]
pub struct Image {
    /// Ends of x: the first and the last column, cells included.
    pub x: [f64; 2],
    /// Ends of y: of the first row, which is drawn at the bottom unless `downwards`, and the last.
    pub y: [f64; 2],
    /// The first row at the top, as a matrix is written.
    pub downwards: bool,
    /// Columns.
    pub columns: usize,
    /// Row by row; no number where nothing is known.
    #[serde(serialize_with = "short_numbers")]
    pub values: Vec<f64>,
    /// What the colours mean, with its unit.
    pub label: String,
    /// Ends of the scale of colours.
    pub range: [f64; 2],
}

/// How a series is drawn. Colours are Okabe and Ito's (2008), which colour-blind readers can tell apart;
/// lines differ in dash too.
#[derive(Clone, Copy, PartialEq)]
pub enum Style {
    /// Dotted, grey.
    Truth,
    /// Dashed.
    Background,
    /// A line.
    Analysis,
    /// Dots.
    Observation,
    /// Crosses.
    Withheld,
    /// Crosses, red.
    Refused,
    /// A line of colour i.
    Line(usize),
    /// A line of colour i with a dot at every point, dashed once the colours begin again.
    Marked(usize),
    /// Small dots of colour i.
    Dots(usize),
}

impl Serialize for Style {
    /// The name of the kind and the number of the colour, as "line 2".
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Style::Truth => serializer.serialize_str("truth"),
            Style::Background => serializer.serialize_str("background"),
            Style::Analysis => serializer.serialize_str("analysis"),
            Style::Observation => serializer.serialize_str("observation"),
            Style::Withheld => serializer.serialize_str("withheld"),
            Style::Refused => serializer.serialize_str("refused"),
            Style::Line(i) => serializer.collect_str(&format_args!("line {i}")),
            Style::Marked(i) => serializer.collect_str(&format_args!("marked {i}")),
            Style::Dots(i) => serializer.collect_str(&format_args!("dots {i}")),
        }
    }
}

/// Six digits are more than a screen shows.
fn rounded(value: f64) -> Option<f64> {
    value.is_finite().then(|| format!("{value:.5e}").parse().unwrap_or(value))
}

fn short_numbers<S: Serializer>(values: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(values.iter().map(|v| rounded(*v)))
}

fn columns<S: Serializer>(points: &[(f64, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    let column = |of: fn(&(f64, f64)) -> f64| points.iter().map(|p| rounded(of(p))).collect::<Vec<_>>();
    [column(|p| p.0), column(|p| p.1)].serialize(serializer)
}

fn three_columns<S: Serializer>(points: &[(f64, f64, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    let column = |of: fn(&(f64, f64, f64)) -> f64| points.iter().map(|p| rounded(of(p))).collect::<Vec<_>>();
    [column(|p| p.0), column(|p| p.1), column(|p| p.2)].serialize(serializer)
}
