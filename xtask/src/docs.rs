//! `cargo xtask docs`.

use crate::{cargo, root, run};
use std::fmt::Write;

/// Crates of the index, in suggested reading order, with a line on each.
const CRATES: [(&str, &str); 5] = [
    ("varda_covariance", "background and observation errors: products, square roots, inverses"),
    ("varda_implicit", "steps given implicitly, with tangent and adjoint; checks of both"),
    ("varda_rod", "discrete elastic rods: energies, dynamics, statics, markers"),
    ("varda_assimilation", "4D-Var: costs, observation operators, minimizers, posterior"),
    ("varda", "scenes, twin experiments, reports, the command line"),
];

/// Builds the documentation of all crates, warnings denied, and an index page beside them.
pub(crate) fn build() -> Result<(), String> {
    let mut command = cargo();
    command.args(["doc", "--workspace", "--no-deps", "--lib"]).env("RUSTDOCFLAGS", "--deny warnings");
    run(command.current_dir(root()))?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), Into::into);
    let folder = target.join("doc");
    let mut list = String::new();
    for (name, what) in CRATES {
        if !folder.join(name).join("index.html").is_file() {
            return Err(format!("{}: no documentation of {name}", folder.display()));
        }
        let _ = writeln!(list, "<li><a href=\"{name}/index.html\">{name}</a>: {what}</li>");
    }
    let page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>Varda</title>\n\
         <h1>Varda</h1>\n<p>Variational data assimilation.</p>\n<ul>\n{list}</ul>\n</html>\n"
    );
    let file = folder.join("index.html");
    std::fs::write(&file, page).map_err(|e| format!("{}: {e}", file.display()))?;
    println!("{}", file.display());
    Ok(())
}
