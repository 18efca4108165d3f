//! report.html as one file that opens offline: text, and the data of its figures with the programs that draw
//! them. Charts are drawn by uPlot, a rod by three.js; a page carries only what it needs of these.

pub(super) mod rod;

use std::fmt::Write;

use serde::Serialize;

use self::rod::RodView;
use super::chart::Figure;
use super::markup::escape;

const STYLE: &str = include_str!("style.css");
const UPLOT_STYLE: &str = include_str!("vendor/uplot.css");
const UPLOT: &str = include_str!("vendor/uplot.js");
const THREE: &str = include_str!("vendor/three.js");
const COLOURS_SCRIPT: &str = include_str!("colours.js");
const TABLES_SCRIPT: &str = include_str!("tables.js");
const CHARTS_SCRIPT: &str = include_str!("charts.js");
const ROD_SCRIPT: &str = include_str!("rod.js");

/// Nothing may be loaded from anywhere: the page is whole, and a name or text of a user that became markup
/// could not load anything either.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                      img-src data: blob:; base-uri 'none'; form-action 'none'";

/// A page while it is put together, from top to bottom.
pub(super) struct Page {
    title: String,
    body: String,
    data: Data,
}

/// What the programs of a page draw.
#[derive(Default, Serialize)]
struct Data {
    /// Figures by their place in the page: element `chart-i` shows figure i.
    charts: Vec<Figure>,
    rod: Option<RodView>,
}

impl Page {
    /// An empty page.
    pub(super) fn new(title: &str) -> Self {
        Page { title: title.to_string(), body: String::new(), data: Data::default() }
    }

    /// Adds HTML, whose texts must be escaped already.
    pub(super) fn push(&mut self, html: &str) {
        self.body.push_str(html);
    }

    /// Adds a chart with its title below.
    pub(super) fn figure(&mut self, figure: Figure) {
        let chart = self.chart(figure);
        let title = &self.data.charts[chart].title;
        let figure = format!(
            "<figure><div class=\"chart\" id=\"chart-{chart}\"></div><figcaption>{}</figcaption></figure>",
            escape(title)
        );
        self.body.push_str(&figure);
    }

    /// Adds one of several charts, which the reader chooses by name.
    pub(super) fn one_of(&mut self, label: &str, figures: Vec<(String, Figure)>) {
        let name = self.data.charts.len();
        let mut options = String::new();
        let mut titles = String::new();
        for (i, (option, figure)) in figures.into_iter().enumerate() {
            let chart = self.chart(figure);
            let hidden = if i == 0 { "" } else { " hidden" };
            let _ = write!(options, "<option value=\"chart-{chart}\">{}</option>", escape(&option));
            let _ = write!(
                titles,
                "<div{hidden}><div class=\"chart\" id=\"chart-{chart}\"></div><p \
                 class=\"caption\">{}</p></div>",
                escape(&self.data.charts[chart].title)
            );
        }
        let _ = write!(
            self.body,
            "<figure class=\"one-of\"><p class=\"controls\"><label for=\"choice-{name}\">{}</label> <select \
             id=\"choice-{name}\">{options}</select></p>{titles}</figure>",
            escape(label)
        );
    }

    fn chart(&mut self, figure: Figure) -> usize {
        self.data.charts.push(figure);
        self.data.charts.len() - 1
    }

    /// Adds the view of a rod, and a picture of it for readers without WebGL and for paper.
    pub(super) fn rod(&mut self, view: RodView, caption: &str, picture: &str) {
        let _ = write!(
            self.body,
            "<figure class=\"rod\"><div class=\"view\" id=\"rod\"></div><figcaption>{}</figcaption><details \
             class=\"picture\"><summary>The same as a picture</summary><div \
             class=\"scroll\">{picture}</div></details></figure>",
            escape(caption)
        );
        self.data.rod = Some(view);
    }

    /// The whole page.
    pub(super) fn finish(self) -> String {
        let Page { title, body, data } = self;
        let title = escape(&title);
        let mut scripts = String::new();
        let mut script = |text: &str| {
            let _ = writeln!(scripts, "<script>\n{text}\n</script>");
        };
        let (charts, rod) = (!data.charts.is_empty(), data.rod.is_some());
        script(TABLES_SCRIPT);
        if charts || rod {
            script(COLOURS_SCRIPT);
        }
        if rod {
            script(THREE);
            script(ROD_SCRIPT);
        }
        if charts {
            script(UPLOT);
            script(CHARTS_SCRIPT);
        }
        let more_style = if charts { UPLOT_STYLE } else { "" };
        // Figures hold finite numbers and text: nothing of them cannot be written as JSON. "</" would end the
        // element.
        let json = serde_json::to_string(&data).unwrap_or_default().replace("</", "<\\/");
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n\
             <title>{title} – Varda</title>\n<style>\n{more_style}\n{STYLE}</style>\n</head>\n\
             <body>\n<main>{body}</main>\n<noscript><p class=\"noscript\">Figures are drawn by scripts of \
             this page; as pictures they are in the folder figures/.</p></noscript>\n\
             <script type=\"application/json\" id=\"data\">{json}</script>\n{scripts}</body>\n</html>\n"
        )
    }
}
