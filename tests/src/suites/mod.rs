//! The suites, and what they share.

mod adjoint;
mod counts;
mod coverage;
mod driven_rod;
mod equivalence;
mod field;
mod folder;
mod golden;
mod gripped_cable;
mod hessian;
mod linalg;
mod options;
mod order;
mod paper;
mod parameters;
mod scaling;
mod stiff;
mod taylor;
mod user;

use crate::Row;

pub use crate::row::Report;
pub use options::Options;

/// A suite.
pub struct Suite {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it proves, in one sentence.
    pub proves: &'static str,
    run: fn(&Options) -> Report,
}

/// All suites, in the order they are run.
pub const SUITES: &[Suite] = &[
    Suite {
        name: "linalg",
        proves: "Factorizations, eigenvalues and Krylov methods end in a right answer or in a typed error.",
        run: |options| linalg::run(options).into(),
    },
    Suite {
        name: "adjoint",
        proves: "Every adjoint is the transpose of its tangent, to rounding: steps, windows, assembled \
            costs.",
        run: |options| adjoint::run(options).into(),
    },
    Suite {
        name: "taylor",
        proves: "Tangents and gradients are derivatives: the first-order remainder falls like h².",
        run: |options| taylor::run(options).into(),
    },
    Suite {
        name: "hessian",
        proves: "The rod's second derivatives match dual numbers; Gauss–Newton products match their \
            matrix.",
        run: |options| hessian::run(options).into(),
    },
    Suite {
        name: "golden",
        proves: "Energies, costs, minima and posteriors match numbers computed by other programs.",
        run: |options| golden::run(options).into(),
    },
    Suite {
        name: "counts",
        proves: "No run, sweep, factorization or allocation beyond those that are needed.",
        run: |options| counts::run(options).into(),
    },
    Suite {
        name: "order",
        proves: "Errors fall with the order of the scheme, and rods converge to closed forms.",
        run: |options| order::run(options).into(),
    },
    Suite {
        name: "equivalence",
        proves: "Methods that must agree do: closed form, 3D-Var, 4D-Var, duals, filters, ensembles.",
        run: |options| equivalence::run(options).into(),
    },
    Suite {
        name: "paper",
        proves: "The paper's experiment: where full-step Newton converges and how much an analysis gains.",
        run: paper::run,
    },
    Suite {
        name: "stiff",
        proves: "Extreme cases end in the right answer or in an error that names step, vertex or field.",
        run: stiff::run,
    },
    Suite {
        name: "field",
        proves: "Rods held anywhere, as people bring them, are found at rest where closed forms have them.",
        run: |options| field::run(options).into(),
    },
    Suite {
        name: "scaling",
        proves: "Rods of thousands of segments assimilate from a scene in memory linear in their number.",
        run: |options| scaling::run(options).into(),
    },
    Suite {
        name: "user",
        proves: "What a user gets wrong is refused or named with its value and what was probably meant.",
        run: |options| user::run(options).into(),
    },
    Suite {
        name: "parameters",
        proves: "Constants are estimated beside the state: gradients, a filter, recordings by others.",
        run: |options| parameters::run(options).into(),
    },
    Suite {
        name: "coverage",
        proves: "95 % intervals contain the truth 95 times in a hundred: at the start and the end of a \
            window, and in the forecast.",
        run: |options| coverage::run(options).into(),
    },
];

/// Runs a suite.
///
/// # Panics
/// If there is no suite of that name.
pub fn run(name: &str, options: &Options) -> Report {
    let suite = SUITES.iter().find(|s| s.name == name).expect("a suite of that name");
    (suite.run)(options)
}

/// Reads a text as every kind of file of suite golden: whatever it is, that ends in a fixture or an error,
/// not in a panic.
pub fn read_fixture(text: &str) {
    golden::read_all(text);
}

/// The rows of suite stiff as a document: `docs/results/stability.md`.
pub fn stability(rows: &[Row]) -> String {
    stiff::document(rows)
}
