//! `cargo xtask package` and `cargo xtask external`: the crates as others get them.

use crate::{cargo, root, run};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Packages the crates as crates.io would get them, and sees that each has its licences and its README
/// inside.
pub(crate) fn package() -> Result<Vec<PathBuf>, String> {
    let arguments = ["package", "--workspace", "--no-verify", "--allow-dirty", "--quiet"];
    run(cargo().args(arguments).current_dir(root()))?;
    let version = env!("CARGO_PKG_VERSION");
    let mut archives = Vec::new();
    for name in crates()? {
        let archive = target().join("package").join(format!("{name}-{version}.crate"));
        let output =
            Command::new("tar").arg("-tzf").arg(&archive).output().map_err(|e| format!("tar: {e}"))?;
        let listed = String::from_utf8_lossy(&output.stdout).into_owned();
        for file in ["LICENSE-MIT", "LICENSE-APACHE", "README.md", "Cargo.toml", "src/lib.rs"] {
            if !listed.lines().any(|line| line == format!("{name}-{version}/{file}")) {
                return Err(format!("{}: no {file} inside", archive.display()));
            }
        }
        archives.push(archive);
    }
    println!("{} crates packaged, each with its licences and README", archives.len());
    Ok(archives)
}

/// Builds and runs the programs of tests/external with the packaged crates.
pub(crate) fn external() -> Result<(), String> {
    let archives = package()?;
    let unpacked = target().join("external-crates");
    let _ = std::fs::remove_dir_all(&unpacked);
    std::fs::create_dir_all(&unpacked).map_err(|e| format!("{}: {e}", unpacked.display()))?;
    let mut patches = Vec::new();
    for archive in &archives {
        // -m: archives say 2006, and cargo builds again what is newer.
        run(Command::new("tar").arg("-xzmf").arg(archive).arg("-C").arg(&unpacked))?;
        let folder = unpacked.join(archive.file_stem().unwrap_or_default());
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = name.trim_end_matches(env!("CARGO_PKG_VERSION")).trim_end_matches('-').to_string();
        patches.push(format!("patch.crates-io.{name}.path = \"{}\"", folder.display()));
    }
    let folder = root().join("tests/external");
    // The versions of dependencies that the workspace is tested with.
    let lock = folder.join("Cargo.lock");
    std::fs::copy(root().join("Cargo.lock"), &lock).map_err(|e| format!("{}: {e}", lock.display()))?;
    let programs = programs(&folder.join("src/bin"))?;
    // Unpacked crates in the place of those of crates.io.
    let config = unpacked.join("patches.toml");
    std::fs::write(&config, patches.join("\n") + "\n").map_err(|e| format!("{}: {e}", config.display()))?;
    let with_patches = |arguments: &[&str]| {
        let mut command = cargo();
        command.args(arguments).arg("--config").arg(&config).current_dir(&folder);
        command.env("CARGO_TARGET_DIR", target().join("external"));
        command
    };
    run(&mut with_patches(&["build", "--quiet", "--bins"]))?;
    for program in &programs {
        run(&mut with_patches(&["run", "--quiet", "--bin", program]))?;
    }
    println!("{} programs built and run with the packaged crates", programs.len());
    Ok(())
}

/// Most lines of a program that shows how little it takes.
const LINES: usize = 60;

/// The names of the programs in a folder; an error if one is too long.
fn programs(folder: &Path) -> Result<Vec<String>, String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut names = Vec::new();
    for path in entries.flatten().map(|e| e.path()) {
        let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        if text.lines().count() >= LINES {
            return Err(format!("{}: not under {LINES} lines", path.display()));
        }
        names.push(path.file_stem().unwrap_or_default().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

/// The names of the packages in crates/ that are published; the Python module has a way of its own.
fn crates() -> Result<Vec<String>, String> {
    let folder = root().join("crates");
    let entries = std::fs::read_dir(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut names = Vec::new();
    for path in entries.flatten().map(|e| e.path().join("Cargo.toml")).filter(|p| p.is_file()) {
        let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        if text.lines().any(|line| line == "publish = false") {
            continue;
        }
        let name = text.lines().find_map(|l| l.strip_prefix("name = "));
        names.push(name.ok_or(format!("{}: no name", path.display()))?.trim_matches('"').to_string());
    }
    names.sort();
    Ok(names)
}

/// The folder of what is built.
fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), Into::into)
}
