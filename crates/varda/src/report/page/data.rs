//! A page as plain data, report.json, and the page that is drawn from it.

use std::fmt::Write as _;
use std::io::Write;

use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::report::markup::escape;

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

/// Number of the form in which a page is kept; another one cannot be drawn.
pub(super) const FORMAT: u32 = 1;

/// What report.json holds: the page without the style and the programs that draw it.
#[derive(Serialize, Deserialize)]
pub(in crate::report) struct PageData {
    /// See [`FORMAT`].
    pub(super) format: u32,
    /// Version of Varda that made the result.
    pub(super) version: String,
    pub(super) title: String,
    /// Texts and tables as HTML, with places for figures.
    pub(super) body: String,
    /// The figures in their order, and the rod.
    pub(super) figures: Box<RawValue>,
}

/// Which figures there are.
#[derive(Deserialize)]
struct Present {
    charts: Vec<IgnoredAny>,
    rod: Option<IgnoredAny>,
}

/// Why a text is no page that can be drawn.
pub(in crate::report) enum Unfit {
    /// It is not what this or another version writes.
    Broken(serde_json::Error),
    /// Another version wrote it in another form.
    Form { version: String, format: u32 },
}

impl PageData {
    /// Writes report.json.
    pub(in crate::report) fn write(&self, file: &mut dyn Write) -> std::io::Result<()> {
        serde_json::to_writer(&mut *file, self)?;
        file.write_all(b"\n")
    }

    /// What the text of report.json says.
    pub(in crate::report) fn read(text: &str) -> Result<PageData, Unfit> {
        #[derive(Deserialize)]
        struct Form {
            format: u32,
            version: String,
        }
        let Form { format, version } = serde_json::from_str(text).map_err(Unfit::Broken)?;
        if format != FORMAT {
            return Err(Unfit::Form { version, format });
        }
        let page: PageData = serde_json::from_str(text).map_err(Unfit::Broken)?;
        serde_json::from_str::<Present>(page.figures.get()).map_err(Unfit::Broken)?;
        Ok(page)
    }

    /// report.html.
    pub(in crate::report) fn html(&self) -> String {
        let PageData { title, body, figures, .. } = self;
        let title = escape(title);
        let mut scripts = String::new();
        let mut script = |text: &str| {
            let _ = writeln!(scripts, "<script>\n{text}\n</script>");
        };
        let present = serde_json::from_str::<Present>(figures.get());
        let (charts, rod) = present.map_or((false, false), |p| (!p.charts.is_empty(), p.rod.is_some()));
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
        // "</" would end the element.
        let json = figures.get().replace("</", "<\\/");
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
