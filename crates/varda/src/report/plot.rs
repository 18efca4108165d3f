//! The page of a result, drawn from report.json: when it is written, and again at any time after.

use std::path::{Path, PathBuf};

use super::folder::ResultFolder;
use super::page::{PageData, Unfit};
use crate::Error;
use crate::sweep::runs::write_whole;

/// The page.
pub(super) const PAGE: &str = "report.html";
/// What it is drawn from.
pub(super) const PAGE_DATA: &str = "report.json";

/// Writes a page and what it is drawn from, with this in front of their names.
pub(super) fn write_page(out: &ResultFolder, at: &str, page: &PageData) -> Result<(), Error> {
    out.write_with(&format!("{at}{PAGE_DATA}"), |file| page.write(file))?;
    out.write(&format!("{at}{PAGE}"), &page.html())
}

/// Draws report.html of a result again, and those of its recordings, without running anything: from
/// report.json, with the style and the programs of this version. The pages that were written.
///
/// ```
/// use varda::report::{plot, write};
/// use varda::run::{Listener, assimilate};
/// use varda::scene::SceneFile;
/// use varda::setup::Problem;
///
/// let problem = Problem::from_scene(&SceneFile::open("lorenz63", &[])?)?;
/// let folder = std::env::temp_dir().join(format!("varda-plot-{}", std::process::id()));
/// write(&assimilate(&problem, &mut Listener::silent())?, &folder)?;
/// let page = folder.join("report.html");
/// let before = std::fs::read(&page).expect("a result has a page");
/// std::fs::remove_file(&page).expect("it can be deleted");
/// assert_eq!(plot::draw_again(&folder)?, [page.clone()]);
/// assert!(std::fs::read(&page).is_ok_and(|again| again == before));
/// # std::fs::remove_dir_all(&folder).expect("it can be deleted");
/// # Ok::<(), varda::Error>(())
/// ```
///
/// # Errors
/// [`Error::Page`] where the folder has no page or one that this version cannot draw; [`Error::Write`].
pub fn draw_again(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut pages = vec![(folder.join(PAGE), read(folder)?)];
    let inside = |reason| Error::Page { path: folder.to_path_buf(), reason: format!("{reason}") };
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(inside)? {
        let path = entry.map_err(inside)?.path();
        if path.join(PAGE_DATA).is_file() {
            folders.push(path);
        }
    }
    folders.sort();
    for of_recording in folders {
        pages.push((of_recording.join(PAGE), read(&of_recording)?));
    }
    // all or none
    for (path, page) in &pages {
        write_whole(path, &page.html())?;
    }
    Ok(pages.into_iter().map(|(path, _)| path).collect())
}

/// What a folder's page is drawn from.
fn read(folder: &Path) -> Result<PageData, Error> {
    let refuse = |reason: String| Error::Page { path: folder.to_path_buf(), reason };
    let text = std::fs::read_to_string(folder.join(PAGE_DATA)).map_err(|e| refuse(missing(folder, &e)))?;
    PageData::read(&text).map_err(|unfit| {
        refuse(match unfit {
            Unfit::Broken(e) => format!("{PAGE_DATA} is not as Varda writes it: {e}"),
            Unfit::Form { version, format } => format!(
                "{PAGE_DATA} has form {format} of version {version}, and this is version {}: run the scene \
                 again, or use that version",
                env!("CARGO_PKG_VERSION")
            ),
        })
    })
}

/// What a folder is that has no report.json which can be read.
fn missing(folder: &Path, error: &std::io::Error) -> String {
    if !folder.is_dir() {
        return "it is no folder".into();
    }
    if error.kind() != std::io::ErrorKind::NotFound {
        return format!("{PAGE_DATA} cannot be read: {error}");
    }
    let summary = std::fs::read_to_string(folder.join("summary.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap_or_default();
    match (summary["version"].as_str(), summary["method"].as_str()) {
        (None, _) => "it has no summary.json of Varda's: it is no result".into(),
        (_, Some("simulate")) => "it is that of a forward run, which has tables and no page".into(),
        (Some(version), _) => format!(
            "it has no {PAGE_DATA}, from which its page is drawn: it was deleted, or version {version} did \
             not write one yet; run the scene again"
        ),
    }
}
