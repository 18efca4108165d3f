//! Results as plain data: what a run found, and all that a report needs of it.

mod considered;
mod convergence;
mod covariances;
mod cycles;
mod estimates;
mod evidence;
mod exact_hessian;
mod fit;
mod joint;
mod model_errors;
mod modes;
mod next_observation;
mod quantity;
mod recording;
mod shares;
mod simulation;
mod sources;
mod space;
mod spread;
mod verdict;
mod window;

pub use considered::{ByConstant, Considered};
pub use convergence::{Attempt, ConvergenceRow, Status, WorkCounts};
pub use covariances::CovarianceBlock;
pub use cycles::{CycleDepartures, CycleRow, CycleSigma, CyclesOutcome, Means};
pub(crate) use estimates::is_of_input;
pub use estimates::{Estimated, IDENTIFIABLE, remarks as remarks_on_estimates};
pub use evidence::{Cause, Evidence};
pub use exact_hessian::ExactHessian;
pub use fit::{Fit, Forecast, Rejected, Withheld};
pub use joint::JointOutcome;
pub(crate) use joint::in_words;
pub use model_errors::ModelErrors;
pub use modes::RodModes;
pub use next_observation::{Candidate, NextObservation};
pub use quantity::Quantity;
pub use recording::{Neighbours, RecordingSummary, RowCount, SitesAre, TrackSummary};
pub use shares::{KnownConstants, Share};
pub use simulation::{Distance, PixelSight, Reading, Simulation, TwinFiles};
pub use sources::{Sensitivity, SourceShare, Sources};
pub use space::{Shapes, Sight, Track};
pub use spread::ObservedValue;
pub use verdict::{Judgement, Verdict};
pub use window::{
    AcceptedSteps, Experiment, Failure, GroupRmse, Members, Outcome, Rmse, Seconds, SeenComponent,
    Trajectories,
};
