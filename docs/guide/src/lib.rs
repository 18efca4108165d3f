#![doc = include_str!("../front.md")]
#![forbid(unsafe_code)]

// One line of documentation, one module: `cargo xtask docs` reads this file to know which page a link to a
// .md file means.

#[doc = include_str!("../own-model.md")]
pub mod own_model {}
#[doc = include_str!("../own-operator.md")]
pub mod own_operator {}
#[doc = include_str!("../own-covariance.md")]
pub mod own_covariance {}
#[doc = include_str!("../rod-without-scenes.md")]
pub mod rod_without_scenes {}
#[doc = include_str!("../own-load.md")]
pub mod own_load {}
#[doc = include_str!("../estimates.md")]
pub mod estimates {}
#[doc = include_str!("../motion-capture.md")]
pub mod motion_capture {}
#[doc = include_str!("../cameras.md")]
pub mod cameras {}
#[doc = include_str!("../sensors.md")]
pub mod sensors {}
#[doc = include_str!("../observation-files.md")]
pub mod observation_files {}
#[doc = include_str!("../python.md")]
pub mod python {}
#[doc = include_str!("../methods.md")]
pub mod methods {}
#[doc = include_str!("../report.md")]
pub mod report {}
#[doc = include_str!("../sweeps.md")]
pub mod sweeps {}
#[doc = include_str!("../many-hosts.md")]
pub mod many_hosts {}
#[doc = include_str!("../gallery/README.md")]
pub mod gallery {
    #[doc = include_str!("../gallery/hose.md")]
    pub mod hose {}
    #[doc = include_str!("../gallery/soft-arm.md")]
    pub mod soft_arm {}
    #[doc = include_str!("../gallery/cable-between-posts.md")]
    pub mod cable_between_posts {}
    #[doc = include_str!("../gallery/tether-on-base.md")]
    pub mod tether_on_base {}
    #[doc = include_str!("../gallery/rope-two-cameras.md")]
    pub mod rope_two_cameras {}
    #[doc = include_str!("../gallery/twisted-rod.md")]
    pub mod twisted_rod {}
    #[doc = include_str!("../gallery/beam-release.md")]
    pub mod beam_release {}
    #[doc = include_str!("../gallery/wire.md")]
    pub mod wire {}
    #[doc = include_str!("../gallery/wires.md")]
    pub mod wires {}
    #[doc = include_str!("../gallery/tether-in-current.md")]
    pub mod tether_in_current {}
    #[doc = include_str!("../gallery/hanging-rod-case1.md")]
    pub mod hanging_rod_case1 {}
    #[doc = include_str!("../gallery/lorenz63.md")]
    pub mod lorenz63 {}
    #[doc = include_str!("../gallery/lorenz96.md")]
    pub mod lorenz96 {}
    #[doc = include_str!("../gallery/burgers.md")]
    pub mod burgers {}
    #[doc = include_str!("../gallery/linear-advection.md")]
    pub mod linear_advection {}
    #[doc = include_str!("../gallery/lorenz96-cycling-4dvar.md")]
    pub mod lorenz96_cycling_4dvar {}
}
#[doc = include_str!("../output-files.md")]
pub mod output_files {}
#[doc = include_str!("../../theory/README.md")]
pub mod theory {
    #[doc = include_str!("../../theory/covariance.md")]
    pub mod covariance {}
    #[doc = include_str!("../../theory/adjoints.md")]
    pub mod adjoints {}
    #[doc = include_str!("../../theory/rod.md")]
    pub mod rod {}
    #[doc = include_str!("../../theory/algorithms.md")]
    pub mod algorithms {}
}
#[doc = include_str!("../../notation.md")]
pub mod notation {}
#[doc = include_str!("../../references.md")]
pub mod references {}
#[doc = include_str!("../../reference-problems.md")]
pub mod reference_problems {}
#[doc = include_str!("../../ARCHITECTURE.md")]
pub mod architecture {}
#[doc = include_str!("../../CHANGELOG.md")]
pub mod changelog {}
#[doc = include_str!("../../results/README.md")]
// Tables give units in brackets.
#[allow(rustdoc::broken_intra_doc_links)]
pub mod results {
    #[doc = include_str!("../../results/assimilation.md")]
    pub mod assimilation {}
    #[doc = include_str!("../../results/build.md")]
    pub mod build {}
    #[doc = include_str!("../../results/case4.md")]
    pub mod case4 {}
    #[doc = include_str!("../../results/figures.md")]
    pub mod figures {}
    #[doc = include_str!("../../results/gradient.md")]
    pub mod gradient {}
    #[doc = include_str!("../../results/instructions.md")]
    pub mod instructions {}
    #[doc = include_str!("../../results/leftout.md")]
    pub mod leftout {}
    #[doc = include_str!("../../results/mpi.md")]
    pub mod mpi {}
    #[doc = include_str!("../../results/lorenz96-cycling.md")]
    pub mod lorenz96_cycling {}
    #[doc = include_str!("../../results/scaling.md")]
    pub mod scaling {}
    #[doc = include_str!("../../results/stability.md")]
    pub mod stability {}
    #[doc = include_str!("../../results/time.md")]
    pub mod time {}
    #[doc = include_str!("../../results/verification.md")]
    pub mod verification {}
}
