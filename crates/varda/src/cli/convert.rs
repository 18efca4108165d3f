//! `varda convert`: a recording of a motion-capture system to a table, and what is in it.

use std::path::{Path, PathBuf};

use super::style;
use crate::Error;
use crate::convert::{Options, Recording, Unit, Up, read};

pub(super) fn up(name: &str) -> Result<Up, String> {
    match name {
        "x" => Ok(Up::X),
        "y" => Ok(Up::Y),
        "z" => Ok(Up::Z),
        _ => Err("expected x, y or z".into()),
    }
}

pub(super) fn unit(name: &str) -> Result<Unit, String> {
    Unit::named(name).ok_or_else(|| "expected mm, cm or m".into())
}

pub(super) fn convert(file: &Path, out: Option<PathBuf>, options: &Options) -> Result<(), Error> {
    let bytes = super::bytes_of(file).map_err(|reason| Error::Read {
        place: "convert".into(),
        path: file.to_path_buf(),
        reason,
    })?;
    let recording = read(&file.display().to_string(), &bytes, options)?;
    let (out, chosen) = out.map_or_else(|| (beside(file), false), |out| (out, true));
    let failed = |reason| Error::Write { path: out.clone(), reason };
    if out == file || (!chosen && out.exists()) {
        return Err(failed(std::io::Error::other("it is there already: choose a name with --out")));
    }
    std::fs::write(&out, recording.to_csv()).map_err(failed)?;
    style::print(&table(&recording));
    style::line(format_args!("\nwrote {}", out.display()));
    Ok(())
}

/// The default name of the table.
fn beside(file: &Path) -> PathBuf {
    if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
        let stem = file.file_stem().map_or("recording".into(), |s| s.to_string_lossy());
        file.with_file_name(format!("{stem}-varda.csv"))
    } else {
        file.with_extension("csv")
    }
}

/// The markers of a recording with their rows and gaps, and what there is to say.
fn table(recording: &Recording) -> String {
    let width = recording.tracks.iter().map(|t| t.name.chars().count()).max().unwrap_or(0).max(6);
    let mut text = format!("{}: {} markers\n\n", recording.kind, recording.tracks.len());
    text += &format!(
        "{:width$} {:>8} {:>10} {:>10} {:>6} {:>15}\n",
        "marker", "rows", "from s", "to s", "gaps", "longest, frames"
    );
    for track in &recording.tracks {
        let (gaps, longest) = track.gaps();
        let ends = [track.rows.first(), track.rows.last()]
            .map(|row| row.map_or(String::new(), |r| format!("{:.3}", r.1)));
        let [from, to] = ends;
        let (name, rows) = (&track.name, track.rows.len());
        text += &format!("{name:width$} {rows:>8} {from:>10} {to:>10} {gaps:>6} {longest:>15}\n");
    }
    for remark in &recording.remarks {
        text += &format!("\n{remark}");
    }
    if recording.remarks.is_empty() { text } else { text + "\n" }
}
