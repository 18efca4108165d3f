//! Benchmarks: error against run time. Each gives a [`Page`], printed and written to docs/results.
//!
//! Times are CPU seconds of one thread, taken after a warm-up, given as the median and the least of several
//! samples. They inform; only errors are checked, by the suites.

pub mod case4;
pub mod clock;
pub mod cycling;
pub mod figures;
pub mod kernels;
pub mod machine;
pub mod memory;
pub mod page;

mod assimilation;
mod build;
mod estimation;
mod gradient;
mod hessian;
mod instructions;
mod interrupts;
mod leftout;
mod options;
mod priors;
mod scaling;
mod statics;
mod time;
mod twins;

pub use options::{Options, Result};
pub use page::{Cell, Page, Table};

/// A benchmark.
pub struct Bench {
    /// Its name on the command line, and of its files.
    pub name: &'static str,
    /// Runs it.
    pub run: fn(&Options) -> Result<Page>,
}

/// All benchmarks, in the order they are run.
pub const BENCHES: &[Bench] = &[
    Bench { name: "time", run: time::run },
    Bench { name: "gradient", run: gradient::run },
    Bench { name: "hessian", run: hessian::run },
    Bench { name: "assimilation", run: assimilation::run },
    Bench { name: "estimation", run: estimation::run },
    Bench { name: "scaling", run: scaling::run },
    Bench { name: "statics", run: statics::run },
    Bench { name: "priors", run: priors::run },
    Bench { name: "twins", run: twins::run },
    Bench { name: "leftout", run: leftout::run },
    Bench { name: "instructions", run: instructions::run },
    Bench { name: "memory", run: memory::run },
    Bench { name: "interrupts", run: interrupts::run },
    Bench { name: "build", run: build::run },
];
