//! Charts drawn as SVG text.

use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::chart::{Corner, Figure, Image, Panel, Style};
use crate::Error;

/// Figures are drawn this much larger than they are shown: the SVG backend rounds coordinates to whole
/// pixels.
const FINE: u32 = 4;

type Drawing = DrawingAreaErrorKind<<SVGBackend<'static> as DrawingBackend>::ErrorType>;

const PALETTE: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(240, 228, 66),
    RGBColor(0, 0, 0),
    RGBColor(130, 130, 130),
];

impl Style {
    /// Lengths of dash and gap; `None` for a solid line. Lines that share a colour differ here.
    fn dash(self) -> Option<(u32, u32)> {
        match self {
            Style::Truth => Some((2 * FINE, 3 * FINE)),
            Style::Background => Some((7 * FINE, 4 * FINE)),
            Style::Line(i) | Style::Marked(i) | Style::Dots(i) => match i / PALETTE.len() {
                0 => None,
                1 => Some((8 * FINE, 4 * FINE)),
                _ => Some((2 * FINE, 3 * FINE)),
            },
            Style::Analysis | Style::Observation | Style::Withheld | Style::Refused => None,
        }
    }

    fn colour(self) -> RGBColor {
        match self {
            Style::Truth => RGBColor(60, 60, 60),
            Style::Background => PALETTE[1],
            Style::Analysis => PALETTE[0],
            Style::Observation => RGBColor(0, 120, 90),
            Style::Withheld => PALETTE[3],
            Style::Refused => RGBColor(192, 0, 0),
            Style::Line(i) | Style::Marked(i) | Style::Dots(i) => PALETTE[i % PALETTE.len()],
        }
    }
}

impl Figure {
    /// The figure as a standalone SVG document.
    ///
    /// # Errors
    /// [`Error::Plot`] where it cannot be drawn.
    pub fn svg(&self) -> Result<String, Error> {
        let rows = self.panels.len().div_ceil(self.columns);
        let size = (FINE * self.panel_size.0 * self.columns as u32, FINE * self.panel_size.1 * rows as u32);
        let mut text = String::new();
        {
            let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
            self.draw(&root, rows)
                .map_err(|e| Error::Plot { figure: self.name.clone(), reason: e.to_string() })?;
        }
        Ok(accessible(&text, size, &self.title))
    }

    fn draw(&self, root: &DrawingArea<SVGBackend, Shift>, rows: usize) -> Result<(), Drawing> {
        root.fill(&WHITE)?;
        for (panel, area) in self.panels.iter().zip(root.split_evenly((rows, self.columns))) {
            panel.draw(&area)?;
        }
        root.present()?;
        Ok(())
    }
}

impl Panel {
    /// The names of the series, each next to a piece of its line.
    fn draw_key(&self, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), Drawing> {
        let fine = FINE as i32;
        let font = ("sans-serif", FINE * 13).into_font().color(&RGBColor(40, 40, 40));
        for (i, series) in self.series.iter().enumerate() {
            let y = fine * (24 + 20 * i as i32);
            let thick = series.style.colour().stroke_width(2 * FINE);
            let line = [(fine * 16, y), (fine * 56, y)];
            match series.style.dash() {
                Some((on, off)) => area.draw(&DashedPathElement::new(line, on, off, thick))?,
                None => area.draw(&PathElement::new(line, thick))?,
            }
            area.draw(&Text::new(series.label.as_str(), (fine * 66, y - fine * 7), font.clone()))?;
        }
        Ok(())
    }

    /// Cells of colour, and beside them the scale of colours.
    fn draw_image(&self, image: &Image, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), Drawing> {
        let font = |size: u32| ("sans-serif", FINE * size).into_font().color(&RGBColor(40, 40, 40));
        let (wide, _) = area.dim_in_pixel();
        let (picture, scale) = area.split_horizontally(wide - FINE * 78);
        let (rows, columns) = (image.values.len() / image.columns, image.columns);
        let y = if image.downwards { image.y[1]..image.y[0] } else { image.y[0]..image.y[1] };
        let mut builder = ChartBuilder::on(&picture);
        builder.margin(FINE * 8).x_label_area_size(FINE * 36).y_label_area_size(FINE * 52);
        if !self.title.is_empty() {
            builder.caption(&self.title, font(15));
        }
        let mut chart = builder.build_cartesian_2d(image.x[0]..image.x[1], y)?;
        let digits = |[low, high]: [f64; 2]| decimals((low.min(high), high.max(low)));
        let (x_digits, y_digits) = (digits(image.x), digits(image.y));
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels(5)
            .y_labels(6)
            .x_label_formatter(&|x| fixed(*x, x_digits))
            .y_label_formatter(&|y| fixed(*y, y_digits))
            .label_style(font(12))
            .axis_desc_style(font(13))
            .draw()?;
        let at = |[low, high]: [f64; 2], i: usize, n: usize| low + (high - low) * i as f64 / n as f64;
        chart.draw_series(image.runs().into_iter().map(|(row, from, to, shade)| {
            let corners = [
                (at(image.x, from, columns), at(image.y, row, rows)),
                (at(image.x, to, columns), at(image.y, row + 1, rows)),
            ];
            Rectangle::new(corners, shade_colour(shade).filled())
        }))?;
        let mut scale = ChartBuilder::on(&scale)
            .margin(FINE * 8)
            .margin_bottom(FINE * 44)
            .margin_top(FINE * if self.title.is_empty() { 8 } else { 34 })
            .right_y_label_area_size(FINE * 46)
            .build_cartesian_2d(0.0..1.0, image.range[0]..image.range[1])?;
        let scale_digits = digits(image.range);
        scale
            .configure_mesh()
            .disable_mesh()
            .disable_x_axis()
            .y_labels(5)
            .y_desc(&image.label)
            .y_label_formatter(&|v| fixed(*v, scale_digits))
            .label_style(font(11))
            .axis_desc_style(font(12))
            .draw()?;
        scale.draw_series((0..SHADES).map(|i| {
            let corners = [(0.0, at(image.range, i, SHADES)), (1.0, at(image.range, i + 1, SHADES))];
            Rectangle::new(corners, shade_colour(i).filled())
        }))?;
        Ok(())
    }

    fn draw(&self, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), Drawing> {
        if self.is_key {
            return self.draw_key(area);
        }
        if let Some(image) = &self.image {
            return self.draw_image(image, area);
        }
        let y_of = |y: f64| if self.log_y { y.log10() } else { y };
        let x_of = |x: f64| if self.log_x { x.log10() } else { x };
        let usable = |p: &&(f64, f64)| x_of(p.0).is_finite() && y_of(p.1).is_finite();
        let all: Vec<(f64, f64)> = self
            .series
            .iter()
            .flat_map(|s| s.points.iter().filter(usable))
            .map(|p| (x_of(p.0), y_of(p.1)))
            .chain(self.bands.iter().flat_map(|b| &b.points).flat_map(|p| [(p.0, p.1), (p.0, p.2)]))
            .collect();
        let (x_range, y_range) = match self.equal {
            Some([x, y]) => (x, y),
            None => (range(all.iter().map(|p| p.0), 0.02), range(all.iter().map(|p| p.1), 0.06)),
        };
        let y_range = match (self.legend, self.equal) {
            (Some(Corner::Top), None) => {
                // A line of the legend is about 16 px high; the curves keep the rest.
                let legend = f64::from(FINE) * (16.0 * (self.series.len() + self.bands.len()) as f64 + 12.0);
                let plot = f64::from(area.dim_in_pixel().1) - 60.0 * f64::from(FINE);
                (
                    y_range.0,
                    y_range.1
                        + (y_range.1 - y_range.0) * legend / (plot - legend).max(40.0 * f64::from(FINE)),
                )
            }
            _ => y_range,
        };
        let grey = RGBColor(120, 120, 120);
        let font = |size: u32| ("sans-serif", FINE * size).into_font().color(&RGBColor(40, 40, 40));
        let mut builder = ChartBuilder::on(area);
        let labels = if self.equal.is_some() { 44 } else { 64 };
        builder
            .margin(FINE * 8)
            .margin_right(FINE * 14)
            .x_label_area_size(FINE * 36)
            .y_label_area_size(FINE * labels);
        if !self.title.is_empty() {
            builder.caption(&self.title, font(15));
        }
        let mut chart = builder.build_cartesian_2d(x_range.0..x_range.1, y_range.0..y_range.1)?;
        let decimals = decimals(y_range);
        let text = |value: f64, log: bool, range: (f64, f64), decimals: usize| match log {
            true if (value - value.round()).abs() < 1e-6 => format!("1e{}", value.round() as i64),
            true if range.1 - range.0 < 2.5 => format!("{:.1e}", 10f64.powf(value)),
            true => String::new(),
            false => fixed(value, decimals),
        };
        let y_text = |y: &f64| text(*y, self.log_y, y_range, decimals);
        let x_decimals = self::decimals(x_range);
        let x_text = |x: &f64| text(*x, self.log_x, x_range, x_decimals);
        let (wide, high) = area.dim_in_pixel();
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(228, 228, 228).stroke_width(FINE))
            .axis_style(grey.stroke_width(FINE))
            .set_all_tick_mark_size(FINE * 4)
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels((wide / FINE / 90).clamp(3, 10) as usize)
            .y_labels((high / FINE / 45).clamp(3, 10) as usize)
            .x_label_formatter(&x_text)
            .y_label_formatter(&y_text)
            .label_style(font(12))
            .axis_desc_style(font(13))
            .draw()?;
        let wide_mark = 18 * FINE as i32;
        for band in &self.bands {
            let fill = band.style.colour().mix(0.18).filled();
            let upper = band.points.iter().map(|p| (p.0, p.2));
            let outline: Vec<(f64, f64)> =
                band.points.iter().map(|p| (p.0, p.1)).chain(upper.rev()).collect();
            chart.draw_series(std::iter::once(Polygon::new(outline, fill)))?.label(&band.label).legend(
                move |(x, y)| {
                    Rectangle::new([(x, y - 5 * FINE as i32), (x + wide_mark, y + 5 * FINE as i32)], fill)
                },
            );
        }
        for series in &self.series {
            let colour = series.style.colour();
            let points: Vec<(f64, f64)> =
                series.points.iter().filter(usable).map(|p| (x_of(p.0), y_of(p.1))).collect();
            match series.style {
                Style::Observation => chart
                    .draw_series(points.iter().map(|p| Circle::new(*p, FINE * 3, colour.filled())))?
                    .label(&series.label)
                    .legend(move |(x, y)| Circle::new((x + wide_mark / 2, y), FINE * 3, colour.filled())),
                Style::Dots(_) => chart
                    .draw_series(points.iter().map(|p| Circle::new(*p, FINE * 2, colour.mix(0.7).filled())))?
                    .label(&series.label)
                    .legend(move |(x, y)| Circle::new((x + wide_mark / 2, y), FINE * 3, colour.filled())),
                Style::Withheld | Style::Refused => chart
                    .draw_series(
                        points.iter().map(|p| Cross::new(*p, FINE * 3, colour.stroke_width(2 * FINE))),
                    )?
                    .label(&series.label)
                    .legend(move |(x, y)| {
                        Cross::new((x + wide_mark / 2, y), FINE * 3, colour.stroke_width(2 * FINE))
                    }),
                Style::Background | Style::Truth | Style::Analysis | Style::Line(_) | Style::Marked(_) => {
                    let thick = colour.stroke_width(2 * FINE);
                    if points.len() == 1 || matches!(series.style, Style::Marked(_)) {
                        chart
                            .draw_series(points.iter().map(|p| Circle::new(*p, FINE * 3, colour.filled())))?;
                    }
                    match series.style.dash() {
                        Some((on, off)) => chart
                            .draw_series(DashedLineSeries::new(points, on, off, thick))?
                            .label(&series.label)
                            .legend(move |(x, y)| {
                                DashedPathElement::new([(x, y), (x + wide_mark, y)], on, off, thick)
                            }),
                        None => chart
                            .draw_series(LineSeries::new(points, thick))?
                            .label(&series.label)
                            .legend(move |(x, y)| PathElement::new([(x, y), (x + wide_mark, y)], thick)),
                    }
                }
            };
        }
        if let Some(corner) = self.legend {
            chart
                .configure_series_labels()
                .position(match corner {
                    Corner::Top => SeriesLabelPosition::UpperRight,
                    Corner::LowerLeft => SeriesLabelPosition::LowerLeft,
                    Corner::LowerRight => SeriesLabelPosition::LowerRight,
                })
                .background_style(WHITE.mix(0.85))
                .border_style(RGBColor(210, 210, 210).stroke_width(FINE))
                .legend_area_size(FINE * 24)
                .margin(FINE * 8)
                .label_font(font(12))
                .draw()?;
        }
        Ok(())
    }
}

/// Colours of the scale viridis (Van der Walt and Smith 2015), dark to bright.
const VIRIDIS: [[f64; 3]; 9] = [
    [68.0, 1.0, 84.0],
    [71.0, 44.0, 122.0],
    [59.0, 81.0, 139.0],
    [44.0, 113.0, 142.0],
    [33.0, 144.0, 141.0],
    [39.0, 173.0, 129.0],
    [92.0, 200.0, 99.0],
    [170.0, 220.0, 50.0],
    [253.0, 231.0, 37.0],
];

/// Colours of an image in a file: cells side by side that share one are drawn as one.
const SHADES: usize = 40;

impl Image {
    /// Cells that are known, as (row, first column, column after the last, shade).
    fn runs(&self) -> Vec<(usize, usize, usize, usize)> {
        let [low, high] = self.range;
        let shade = |v: f64| {
            let place = ((v - low) / (high - low).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            ((place * SHADES as f64) as usize).min(SHADES - 1)
        };
        let mut runs: Vec<(usize, usize, usize, usize)> = Vec::new();
        for (row, cells) in self.values.chunks_exact(self.columns).enumerate() {
            for (column, v) in cells.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                match runs.last_mut() {
                    Some(run) if run.0 == row && run.2 == column && run.3 == shade(*v) => run.2 += 1,
                    _ => runs.push((row, column, column + 1, shade(*v))),
                }
            }
        }
        runs
    }
}

fn shade_colour(shade: usize) -> RGBColor {
    let at = shade as f64 / (SHADES - 1) as f64 * (VIRIDIS.len() - 1) as f64;
    let i = (at as usize).min(VIRIDIS.len() - 2);
    let mix = |c: usize| VIRIDIS[i][c] + (at - i as f64) * (VIRIDIS[i + 1][c] - VIRIDIS[i][c]);
    let [red, green, blue] = [mix(0), mix(1), mix(2)].map(|v| v.round() as u8);
    RGBColor(red, green, blue)
}

/// The range of some values with a margin; around 0 where there are none.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let width = if high > low { high - low } else { 1e-3 * high.abs().max(1e-3) };
    (low - margin * width, high + margin * width)
}

/// Digits after the point that tell neighbouring labels apart.
fn decimals((low, high): (f64, f64)) -> usize {
    (1.0 - (high - low).max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize
}

fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    // −0.00 is 0.00.
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        text.trim_start_matches('-').to_string()
    } else {
        text
    }
}

/// Gives an SVG a title for screen readers, and a size that follows the page.
fn accessible(svg: &str, (wide, high): (u32, u32), title: &str) -> String {
    let (width, height) = (wide / FINE, high / FINE);
    let body = svg.find("<svg").map_or(svg, |i| &svg[i..]);
    let inner = body.find('>').map_or("", |i| &body[i + 1..]);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {wide} {high}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\" \
         aria-label=\"{0}\">\n<title>{0}</title><style>rect{{shape-rendering:crispEdges}}</style>{inner}",
        super::markup::escape(title)
    )
}
