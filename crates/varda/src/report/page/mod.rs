//! report.html as one file that opens offline: text, and the data of its figures with the programs that draw
//! them. Charts are drawn by uPlot, a rod by three.js; a page carries only what it needs of these.

mod data;
pub(super) mod rod;

use std::fmt::Write;

use serde::Serialize;

use self::data::FORMAT;
pub(super) use self::data::{PageData, Unfit};
use self::rod::RodView;
use super::chart::Figure;
use super::markup::escape;

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

    /// The whole page as plain data.
    pub(super) fn finish(self) -> PageData {
        let Page { title, body, data } = self;
        // Figures hold finite numbers and text: nothing of them cannot be written as JSON.
        let figures = serde_json::value::to_raw_value(&data).unwrap_or_default();
        PageData { format: FORMAT, version: env!("CARGO_PKG_VERSION").to_string(), title, body, figures }
    }
}
