//! What a benchmark gives: tables, a figure, and what to read beside them.

use super::machine;
use std::fmt::Write;
use std::path::Path;
use varda::report::chart::{Figure, Panel};

/// The result of one benchmark.
#[derive(Default)]
pub struct Page {
    /// Heading.
    pub title: &'static str,
    /// What is measured, and how: paragraphs in front of the tables.
    pub text: String,
    /// The tables; the first is written as NAME.csv, others as NAME-KEY.csv.
    pub tables: Vec<Table>,
    /// Drawn into NAME.svg, side by side; none where there is nothing to draw.
    pub panels: Vec<Panel>,
    /// What follows from the numbers: paragraphs behind the tables.
    pub remarks: String,
}

/// One table.
pub struct Table {
    /// Part of the name of its CSV file.
    pub key: &'static str,
    /// Heading; may be empty.
    pub title: String,
    /// Names of the columns, with their units.
    pub columns: Vec<&'static str>,
    /// As many cells as columns in each.
    pub rows: Vec<Vec<Cell>>,
}

/// One cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Words, to the left.
    Text(String),
    /// Exact.
    Count(usize),
    /// Rounded in text, whole in CSV. What is not finite is a dash.
    Number(f64),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Cell {
        Cell::Text(text.to_string())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Cell {
        Cell::Text(text)
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Cell {
        Cell::Count(count)
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Cell {
        Cell::Number(number)
    }
}

impl From<Option<f64>> for Cell {
    fn from(number: Option<f64>) -> Cell {
        Cell::Number(number.unwrap_or(f64::NAN))
    }
}

/// A row of a table from values of any kind a cell takes.
#[macro_export]
macro_rules! cells {
    ($($value:expr),* $(,)?) => { vec![$($crate::page::Cell::from($value)),*] };
}

impl Cell {
    fn text(&self) -> String {
        match self {
            Cell::Text(text) => text.clone(),
            Cell::Count(count) => count.to_string(),
            Cell::Number(number) => short(*number),
        }
    }

    fn csv(&self) -> String {
        match self {
            Cell::Text(text) if text.contains([',', '"', '\n']) => {
                format!("\"{}\"", text.replace('"', "\"\""))
            }
            Cell::Number(number) if !number.is_finite() => String::new(),
            Cell::Number(number) if (1e-4..1e15).contains(&number.abs()) => number.to_string(),
            Cell::Number(number) => format!("{number:e}"),
            other => other.text(),
        }
    }
}

/// Three significant digits.
fn short(number: f64) -> String {
    let size = number.abs();
    match size {
        _ if !number.is_finite() => "–".into(),
        0.0 => "0".into(),
        _ if !(9.995e-4..99_950.0).contains(&size) => format!("{number:.2e}"),
        _ => {
            let digits = (2.0 - size.log10().floor()).max(0.0) as usize;
            format!("{number:.digits$}")
        }
    }
}

impl Table {
    /// No rows yet.
    pub fn new(key: &'static str, title: impl Into<String>, columns: &[&'static str]) -> Table {
        Table { key, title: title.into(), columns: columns.to_vec(), rows: Vec::new() }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// If it has not one cell for every column.
    pub fn push(&mut self, row: Vec<Cell>) {
        assert_eq!(row.len(), self.columns.len(), "cells in a row of {}", self.title);
        self.rows.push(row);
    }

    /// Lines of cells, aligned; numbers to the right. `between` stands between them; with `ruled` a line of
    /// dashes under the head.
    fn lines(&self, between: [&str; 3], ruled: bool) -> String {
        let head: Vec<String> = self.columns.iter().map(|c| c.to_string()).collect();
        let body: Vec<Vec<String>> = self.rows.iter().map(|r| r.iter().map(Cell::text).collect()).collect();
        let width: Vec<usize> = (0..head.len())
            .map(|i| body.iter().chain([&head]).map(|r| r[i].chars().count()).max().unwrap_or(0))
            .collect();
        let right: Vec<bool> = (0..head.len())
            .map(|i| !self.rows.is_empty() && self.rows.iter().all(|r| !matches!(r[i], Cell::Text(_))))
            .collect();
        let line = |cells: &[String]| {
            let padded = cells.iter().zip(&width).zip(&right).map(|((cell, &w), &right)| {
                if right { format!("{cell:>w$}") } else { format!("{cell:<w$}") }
            });
            let joined = padded.collect::<Vec<_>>().join(between[1]);
            format!("{}{joined}{}", between[0], between[2]).trim_end().to_string() + "\n"
        };
        let mut text = line(&head);
        if ruled {
            let rule = |(&w, &right): (&usize, &bool)| {
                if right { "-".repeat(w.max(2) - 1) + ":" } else { "-".repeat(w) }
            };
            text.push_str(&line(&width.iter().zip(&right).map(rule).collect::<Vec<_>>()));
        }
        body.iter().for_each(|row| text.push_str(&line(row)));
        text
    }

    fn csv(&self) -> String {
        let mut text = self.columns.join(",") + "\n";
        for row in &self.rows {
            let _ = writeln!(text, "{}", row.iter().map(Cell::csv).collect::<Vec<_>>().join(","));
        }
        text
    }
}

impl Page {
    /// For a terminal.
    pub fn plain(&self) -> String {
        let mut text = format!("{}\n", self.title);
        for table in &self.tables {
            let _ = write!(text, "\n{}\n\n{}", table.title, table.lines(["", "  ", ""], false));
        }
        if !self.remarks.is_empty() {
            let _ = write!(text, "\n{}\n", self.remarks);
        }
        text
    }

    /// As Markdown, for the files of the benchmark `name`.
    fn markdown(&self, name: &str) -> String {
        let mut text = format!("# {}\n\n{}\n\n", self.title, self.text.trim());
        let _ = writeln!(text, "Repeat: `cargo xtask bench {name}`. {}.\n", machine::description());
        if let Some(load) = machine::load().filter(|load| *load > 1.5) {
            let _ = writeln!(text, "Other programs shared the machine (load average {load:.0}).\n");
        }
        if !self.panels.is_empty() {
            let _ = writeln!(text, "![{}]({name}.svg)\n", self.title);
        }
        for (i, table) in self.tables.iter().enumerate() {
            if !table.title.is_empty() {
                let _ = writeln!(text, "## {}\n", table.title);
            }
            let file = csv_name(name, i, table);
            let _ = writeln!(text, "{}\n[{file}]({file})\n", table.lines(["| ", " | ", " |"], true));
        }
        if !self.remarks.is_empty() {
            let _ = writeln!(text, "{}", self.remarks.trim());
        }
        text.trim_end().to_string() + "\n"
    }

    /// Writes NAME.md, the CSV files and NAME.svg.
    ///
    /// # Errors
    /// A file that cannot be written, a figure that cannot be drawn.
    pub fn write(&self, name: &'static str, folder: &Path) -> crate::options::Result<()> {
        let write = |file: &str, text: &str| {
            let path = folder.join(file);
            std::fs::write(&path, text).map_err(|e| format!("{}: {e}", path.display()))
        };
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        write(&format!("{name}.md"), &self.markdown(name))?;
        for (i, table) in self.tables.iter().enumerate() {
            write(&csv_name(name, i, table), &table.csv())?;
        }
        if !self.panels.is_empty() {
            write(&format!("{name}.svg"), &self.figure(name).svg()?)?;
        }
        Ok(())
    }

    fn figure(&self, name: &'static str) -> Figure {
        Figure {
            name: name.into(),
            title: self.title.to_string(),
            panels: self.panels.clone(),
            columns: self.panels.len().min(2),
            panel_size: (560, 460),
        }
    }
}

fn csv_name(name: &str, i: usize, table: &Table) -> String {
    if i == 0 { format!("{name}.csv") } else { format!("{name}-{}.csv", table.key) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Table {
        let mut table = Table::new("extra", "Sample", &["method", "error", "steps"]);
        table.push(cells!["midpoint", 1.5e-7, 100usize]);
        table.push(cells!["a, \"b\"", Some(0.0123456), 5usize]);
        table.push(cells!["none", None, 0usize]);
        table
    }

    #[test]
    fn numbers_have_three_digits() {
        let text = [0.0, 1234.5, 0.5, 99_999.0, 9.9951e-4, 1e-9, -2.0, f64::NAN].map(short);
        assert_eq!(text, ["0", "1234", "0.500", "1.00e5", "0.001000", "1.00e-9", "-2.00", "–"]);
    }

    #[test]
    fn lines_are_aligned_and_csv_is_whole() {
        let plain = sample().lines(["", "  ", ""], false);
        let at: Vec<usize> = plain.lines().map(|l| l.chars().count()).collect();
        assert!(at.iter().all(|a| *a == at[0]), "{plain}");
        let csv = sample().csv();
        assert_eq!(csv.lines().nth(1), Some("midpoint,1.5e-7,100"));
        assert_eq!(csv.lines().nth(2), Some("\"a, \"\"b\"\"\",0.0123456,5"));
        assert_eq!(csv.lines().nth(3), Some("none,,0"));
        let markdown = sample().lines(["| ", " | ", " |"], true);
        assert!(markdown.lines().nth(1).unwrap().ends_with(": |"), "{markdown}");
    }

    #[test]
    #[should_panic(expected = "cells in a row")]
    fn a_row_has_a_cell_for_every_column() {
        sample().push(cells!["short"]);
    }

    #[test]
    fn a_page_leaves_all_its_files() {
        let folder = std::env::temp_dir().join(format!("varda-bench-page-{}", std::process::id()));
        let page = Page { title: "T", tables: vec![sample(), sample()], ..Page::default() };
        page.write("sample", &folder).unwrap();
        let mut files: Vec<String> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|f| f.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(files, ["sample-extra.csv", "sample.csv", "sample.md"]);
    }
}
