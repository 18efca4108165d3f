//! Examples and exit codes in the help, manual pages, completions of a shell.

use clap::{Command, CommandFactory, error::ErrorKind};
use clap_complete::Shell;

pub(super) const PROGRAM: &str = "\
Examples:
  varda run hanging-rod                    a twin experiment that comes with the program
  varda new mine --recording markers.csv   a scene for a recording
  varda check mine.toml && varda run mine.toml

Colour is for terminals only; NO_COLOR=1 turns it off.";

pub(super) const RUN: &str = "\
Examples:
  varda run hanging-rod --set observations.sigma=0.01 --seed 3
  varda run mine.toml --set 'output.formats=[\"netcdf\", \"vtk\"]' --out results/mine
  varda run mine.toml --json | jq .verdict

Exit codes: 0 the analysis fits, 1 an error or nothing was observed, 2 wrong usage, 3 it does not fit (with
--strict also any warning), 4 not converged, 130 interrupted.";

pub(super) const SIMULATE: &str = "\
Examples:
  varda simulate hanging-rod --set time.window=500
  varda simulate mine.toml --json | jq .rms_distance

Exit codes: 0 the run came to its end, 1 an error, 2 wrong usage.";

pub(super) const COMPARE: &str = "\
Examples:
  varda compare hanging-rod
  varda compare lorenz96 --seed 3 --json

Exit codes: 0 every method was run (some may have failed: see their status), 1 an error, 2 wrong usage,
130 interrupted.";

pub(super) const SWEEP: &str = "\
Examples:
  varda sweep lorenz63 --set observations.sigma=0.5,1,2 --seeds 0..99
  varda sweep mine.toml --set time.window=50,100 --set 'background.sigma=[0.1,0.2],[0.3,0.4]' --jobs 4
  varda sweep mine.toml --seeds 0..999 --part 3/20 --out study   the third of twenty jobs
  varda sweep --merge study                                      and the table of all of them

Ended at any time, the same command goes on where it was. A run that fails is a row with its error.

Exit codes: 0 all runs ended (whatever their verdict), 1 an error, 2 wrong usage, 130 interrupted.";

pub(super) const MODES: &str = "\
Examples:
  varda modes hanging-rod --count 5
  varda modes mine.toml --json | jq .frequencies_hz

Exit codes: 0 the modes were found, 1 an error, 2 wrong usage.";

pub(super) const PLOT: &str = "\
Examples:
  varda plot out/hanging-rod-case1     the page again, as this version of the program draws it
  for result in out/*/; do varda plot $result; done

It is drawn from report.json of the folder; pages of several recordings are drawn with that of all.

Exit codes: 0 the page was written, 1 an error (a folder without report.json, or one of another form), 2 wrong
usage.";

pub(super) const CHECK: &str = "\
Examples:
  varda check mine.toml
  varda check mine.toml --json | jq '.findings[].text'

Exit codes: 0 no error was found (there may be warnings), 1 an error, 2 wrong usage.";

pub(super) const NEW: &str = "\
Examples:
  varda new mine                            a scene with comments
  varda new mine --recording markers.csv    a scene for a recording
  varda new mine --from hanging-rod-case2   a scene that comes with the program

Beside the scene stands varda-schema.json, with which editors complete and check keys (Taplo; Even Better TOML
in VS Code).

Exit codes: 0 the scene was written, 1 an error (nothing is overwritten), 2 wrong usage.";

pub(super) const SHOW: &str = "\
Examples:
  varda show hanging-rod";

pub(super) const CONVERT: &str = "\
Examples:
  varda convert trial.c3d
  varda convert take.csv --out markers.csv --up y --unit mm

Exit codes: 0 the table was written, 1 an error, 2 wrong usage.";

pub(super) const SCHEMA: &str = "\
Examples:
  varda schema > varda-schema.json          and \"#:schema ./varda-schema.json\" as first line of a scene";

pub(super) const SCENES: &str = "\
Examples:
  varda scenes";

pub(super) const COMPLETIONS: &str = "\
Examples:
  varda completions bash > ~/.local/share/bash-completion/completions/varda
  varda completions zsh > \"${fpath[1]}/_varda\"
  varda completions fish > ~/.config/fish/completions/varda.fish";

pub(super) const MAN: &str = "\
Examples:
  varda man > varda.1
  varda man run > varda-run.1";

/// The completions of a shell.
pub(super) fn completions<C: CommandFactory>(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut C::command(), "varda", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

/// The manual page of the program or of one of its commands; ends the program where there is no such command.
pub(super) fn man<C: CommandFactory>(command: Option<&str>) -> String {
    let mut program = C::command();
    program.build();
    let page: Command = match command {
        None => program,
        Some(name) => match program.find_subcommand(name) {
            Some(command) => command.clone(),
            None => {
                let known: Vec<&str> = program.get_subcommands().map(Command::get_name).collect();
                let text = format!("no command {name:?}; there are {}", known.join(", "));
                program.error(ErrorKind::InvalidValue, text).exit()
            }
        },
    };
    let mut text = Vec::new();
    clap_mangen::Man::new(page).render(&mut text).expect("memory can be written to");
    String::from_utf8_lossy(&text).into_owned()
}
