//! `varda run` and `varda sweep` over the processes of an MPI job: see README.md.

mod world;

use std::any::Any;
use std::ffi::OsString;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::rc::Rc;

use mpi::Threading;
use varda::Error;
use varda_assimilation::ranks;

use world::{Tally, World};

const USAGE: &str = "\
Usage: mpirun -n RANKS varda-mpi run SCENE [...]      as varda run; members, or columns of Hessians, divided
       mpirun -n RANKS varda-mpi sweep SCENE [...]    as varda sweep; its runs divided

--counts   print at the end what was sent and how long ranks waited
";

fn main() -> ExitCode {
    let mut arguments: Vec<OsString> = std::env::args_os().collect();
    let is = |at: usize, name: &str| arguments.get(at).is_some_and(|argument| argument == name);
    // A run of a sweep is such a process, which must not take part in the job.
    if is(1, "alone") {
        arguments.remove(1);
        return varda::cli::run(arguments).unwrap_or_else(|error| {
            eprintln!("error: {}", in_words(&error));
            ExitCode::FAILURE
        });
    }
    let asked_for_help = is(1, "--help") || is(1, "-h");
    let is_known = is(1, "run") || is(1, "sweep");
    let counts = arguments.iter().any(|argument| argument == "--counts");
    arguments.retain(|argument| argument != "--counts");

    // MPI is called by this thread only
    let Some((universe, _)) = mpi::initialize_with_threading(Threading::Funneled) else {
        eprintln!("error: MPI cannot be initialized");
        return ExitCode::FAILURE;
    };
    let world = Rc::new(World::new(universe, counts));
    if !is_known {
        if ranks::Ranks::rank(&*world) == 0 {
            eprint!("{USAGE}");
        }
        world.end(None);
        return if asked_for_help { ExitCode::SUCCESS } else { ExitCode::from(2) };
    }
    let work = || ranks::within(Rc::clone(&world) as Rc<dyn ranks::Ranks>, || varda::cli::run(arguments));
    let (code, failure) = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(code)) => (code, None),
        Ok(Err(error)) => (ExitCode::FAILURE, Some(in_words(&error))),
        Err(panic) => (ExitCode::FAILURE, Some(format!("a panic: {}", said(&*panic)))),
    };
    let is_first = ranks::Ranks::rank(&*world) == 0;
    // before MPI ends: afterwards another rank may end the job by its exit code
    let _ = std::io::stdout().flush();
    let tally = world.end(failure);
    if counts && is_first {
        eprintln!("{}", sent(&tally));
    }
    code
}

/// An error and the line of the scene that it is about.
fn in_words(error: &Error) -> String {
    match error.excerpt() {
        Some(excerpt) => format!("{error}\n{excerpt}"),
        None => error.to_string(),
    }
}

fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message").to_string()
}

fn sent(tally: &Tally) -> String {
    let Tally { ranks, gathers, bytes, longest, shortest, busiest, idlest } = tally;
    format!(
        "{ranks} ranks, {gathers} gathers, {} messages a rank, {bytes} bytes received by each; \
         {shortest:.3} to {longest:.3} s a rank in gathers, {idlest:.3} to {busiest:.3} CPU s outside",
        2 * gathers * (ranks - 1)
    )
}
