//! The index page: the picture of the crates and three ways in.

use super::{read, write};
use crate::root;
use std::path::Path;

/// Writes `index.html` into the folder of the site.
pub(crate) fn write_index(site: &Path) -> Result<(), String> {
    let picture = read(&root().join("docs/figures/crates.svg"))?;
    write(&site.join("index.html"), &PAGE.replace("{picture}", &picture))
}

const PAGE: &str = include_str!("front.html");
