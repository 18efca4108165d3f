//! `varda plot`: the page of a result again, the same bytes, and what is said where it cannot be drawn.

mod support {
    pub(crate) mod program;
}

use support::program::{Folder, text};

/// Deletes pages of a result and has them drawn again: the same bytes, and their names printed.
fn again(folder: &Folder, result: &str, pages: &[&str]) {
    let path = |page: &str| folder.0.join(result).join(page);
    let read = |page: &&str| std::fs::read(path(page)).unwrap_or_else(|e| panic!("{page}: {e}"));
    let before: Vec<Vec<u8>> = pages.iter().map(read).collect();
    assert!(before.iter().all(|page| page.len() > 2000 && page.ends_with(b"</html>\n")));
    pages.iter().for_each(|page| std::fs::remove_file(path(page)).unwrap());
    let printed = text(&folder.varda(&["plot", result]));
    let expected: Vec<String> = pages.iter().map(|page| format!("{result}/{page}")).collect();
    assert_eq!(printed.lines().collect::<Vec<_>>(), expected);
    let after: Vec<Vec<u8>> = pages.iter().map(read).collect();
    assert!(before == after, "{result}: the same bytes");
    // over a page that is there, too, and nothing else changes or is left
    let files = |name: &str| {
        let mut all: Vec<_> =
            std::fs::read_dir(folder.0.join(name)).unwrap().map(|e| e.unwrap().path()).collect();
        all.sort();
        all
    };
    let listed = files(result);
    text(&folder.varda(&["plot", result]));
    assert_eq!(files(result), listed);
}

#[test]
fn pages_of_every_command_are_drawn_again() {
    let folder = Folder::new("plot");
    let quiet = |arguments: &[&str]| {
        let output = folder.varda(arguments);
        // a comparison or a run that does not fit has a page too
        assert!(matches!(output.status.code(), Some(0 | 3 | 4)), "{arguments:?}: {output:?}");
    };
    quiet(&["run", "lorenz63", "--quiet", "--out", "window"]);
    again(&folder, "window", &["report.html"]);
    quiet(&["run", "hanging-rod", "--quiet", "--out", "rod"]);
    again(&folder, "rod", &["report.html"]);
    quiet(&["run", "lorenz63", "--set", "algorithm.cycles.count=2", "--quiet", "--out", "cycles"]);
    again(&folder, "cycles", &["report.html"]);
    quiet(&["compare", "lorenz63", "--out", "compared"]);
    again(&folder, "compared", &["report.html"]);
    quiet(&["modes", "hanging-rod", "--count", "3", "--out", "modes"]);
    again(&folder, "modes", &["report.html"]);
    quiet(&["sweep", "lorenz63", "--seeds", "0..1", "--out", "study"]);
    again(&folder, "study", &["report.html"]);
    let starter = varda::scene::STARTER;
    let recordings = "[[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"b\"\ntime = { spin_up = 37 }\n";
    let scene = format!("{starter}\n[estimate]\nyoungs_modulus = {{ sigma = \"15%\" }}\n{recordings}");
    std::fs::write(folder.0.join("two.toml"), scene).unwrap();
    let small = ["--set", "model.segments=8", "--set", "time.window=30"];
    quiet(&[&["run", "two.toml", "--quiet", "--out", "two"], &small[..]].concat());
    again(&folder, "two", &["report.html", "a/report.html", "b/report.html"]);
}

#[test]
fn what_cannot_be_drawn_says_why() {
    let folder = Folder::new("plot-refused");
    assert!(
        folder.refusal(&["plot", "nothing"]).contains("nothing: its page cannot be drawn: it is no folder")
    );
    std::fs::create_dir(folder.0.join("other")).unwrap();
    assert!(folder.refusal(&["plot", "other"]).contains("it has no summary.json of Varda's"));
    text(&folder.varda(&["simulate", "lorenz63", "--quiet", "--out", "forward"]));
    assert!(folder.refusal(&["plot", "forward"]).contains("a forward run, which has tables and no page"));

    text(&folder.varda(&["run", "lorenz63", "--quiet", "--out", "r"]));
    let data = folder.0.join("r/report.json");
    let whole = folder.read("r/report.json");
    for (changed, expected) in [
        (whole.replacen("\"format\":1", "\"format\":7", 1), "has form 7 of version"),
        (whole[..whole.len() / 2].to_string(), "is not as Varda writes it"),
        (whole.replacen("\"charts\":[", "\"charts\":3,\"no\":[", 1), "is not as Varda writes it"),
        (String::new(), "is not as Varda writes it"),
    ] {
        std::fs::write(&data, changed).unwrap();
        let page = std::fs::read(folder.0.join("r/report.html")).unwrap();
        let message = folder.refusal(&["plot", "r"]);
        assert!(message.contains(expected), "{message}");
        assert!(
            std::fs::read(folder.0.join("r/report.html")).unwrap() == page,
            "the page that is there stays"
        );
    }
    std::fs::remove_file(&data).unwrap();
    let message = folder.refusal(&["plot", "r"]);
    let version = env!("CARGO_PKG_VERSION");
    assert!(
        message.contains(&format!("it was deleted, or version {version} did not write one yet")),
        "{message}"
    );
}
