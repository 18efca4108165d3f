//! summary.json: the run in numbers.

use serde::Serialize;
use varda_assimilation::CostTerms;
use varda_implicit::check::Amplification;

use crate::outcome::{
    AcceptedSteps, Attempt, Considered, Estimated, Evidence, ExactHessian, Fit, Forecast, KnownConstants,
    ModelErrors, NextObservation, Outcome, Rejected, Rmse, Seconds, Share, Sources, Verdict, Withheld,
    WorkCounts,
};

/// The keys of summary.json, in their order.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Whether the analysis explains the observations: fits, does_not_fit, not_converged, nothing_observed.
    pub verdict: Verdict,
    /// The numbers behind the verdict, and what to try.
    pub verdict_text: String,
    /// Name of the scene.
    pub scene: String,
    /// Seed of every random number.
    pub seed: u64,
    /// Version of Varda.
    pub version: &'static str,
    /// Method, as in a scene.
    pub method: &'static str,
    /// Minimizer, as in a scene.
    pub minimizer: &'static str,
    /// How the minimization ended: converged, max_iterations, stalled, interrupted, failed.
    pub status: &'static str,
    /// Length of the state.
    pub n_state: usize,
    /// Length of the control.
    pub n_control: usize,
    /// Number of observed values m.
    pub n_obs: usize,
    /// J at the background.
    pub j_background: f64,
    /// J at the analysis.
    pub j_analysis: f64,
    /// J at the analysis, part by part.
    pub j_terms: Terms,
    /// What J is made of, each part with its mean.
    pub j_shares: Vec<Share>,
    /// ‖∇J‖ at the first point, in the control variable.
    pub gradient_norm_first: f64,
    /// ‖∇J‖ at the last point.
    pub gradient_norm_last: f64,
    /// How much the window amplifies and the error of its gradient; `null` for methods without a gradient
    /// along a run.
    pub amplification: Option<WindowAmplification>,
    /// Size of the model error against Q; `null` for methods without one.
    pub model_error: Option<ModelErrorSize>,
    /// The adaptive time steps; `null` without `time.tolerance`.
    pub accepted_steps: Option<AcceptedSteps>,
    /// Outer iterations.
    pub outer_iterations: usize,
    /// Inner iterations, summed.
    pub inner_iterations: usize,
    /// The starts of minimizer auto in turn, and what each gained; empty for other minimizers.
    pub attempts: Vec<Attempt>,
    /// Work of the model in the minimization.
    pub counts: WorkCounts,
    /// Observed values that the background check refused.
    pub rejected: Vec<Rejected>,
    /// 2J/m at the analysis.
    pub chi2: f64,
    /// Degrees of freedom for signal; `null` without a posterior.
    pub degrees_of_freedom: Option<f64>,
    /// Where one more marker or component would help most, and what σ would be with it at each place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_observation: Option<NextObservation>,
    /// What the uncertainty of what is known least comes from.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<Sources>,
    /// What constants that are taken for known do to the result.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub considered: Vec<Considered>,
    /// What second derivatives of the model do to the posterior, where the scene asks for the exact Hessian.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exact_hessian: Option<ExactHessian>,
    /// Constants that were estimated, with prior and posterior.
    pub estimates: Vec<Estimated>,
    /// σ at the start and at the end of the window, and what it would be with these constants known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub with_constants_known: Vec<KnownConstants>,
    /// RMSE against the truth of the initial state, where it is known.
    pub rmse: Rmse,
    /// Where the time went \[s\].
    pub seconds: Seconds,
    /// Most memory the process used \[bytes\]; `null` where the system does not tell.
    pub peak_bytes: Option<u64>,
    /// Innovations against their σ.
    pub innovations: Vec<Fit>,
    /// Why the analysis does not fit, from its innovations; `null` where they are as large as σ says.
    pub evidence: Option<Evidence>,
    /// Errors at markers that were kept back \[m\].
    pub withheld: Vec<Withheld>,
    /// Errors of the forecast after the window \[m\].
    pub forecast: Vec<Forecast>,
    /// What was not needed and therefore not computed.
    pub left_out: Vec<String>,
    /// Remarks for the user.
    pub warnings: Vec<String>,
}

/// A window's amplification, and whether its gradient can be relied on.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct WindowAmplification {
    /// ‖M‖ about the analysis, relative to σ of the background; `null` where it is not finite.
    pub norm: f64,
    /// ε ‖M‖, the relative error of a gradient to a factor of some ten.
    pub gradient_error: f64,
    /// Whether that is at most 1e-4.
    pub reliable: bool,
}

impl From<Amplification> for WindowAmplification {
    fn from(a: Amplification) -> Self {
        WindowAmplification { norm: a.norm, gradient_error: a.gradient_error, reliable: a.reliable }
    }
}

/// The error of the model against its Q.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ModelErrorSize {
    /// How many errors η were estimated.
    pub count: usize,
    /// J_q at the analysis.
    pub j_q: f64,
    /// The J_q to expect where B, Q and R are right; `null` without a posterior.
    pub j_q_expected: Option<f64>,
    /// How many times σ of the model error should be what Q says, by the innovations.
    pub sigma_factor: Option<f64>,
    /// Its 95 % interval; `null` for an end without a bound.
    pub sigma_factor_interval: [Option<f64>; 2],
}

impl ModelErrorSize {
    fn new(errors: &ModelErrors, terms: &CostTerms) -> Self {
        ModelErrorSize {
            count: errors.steps.len(),
            j_q: terms.model_error,
            j_q_expected: errors.expected_j_q,
            sigma_factor: errors.scale.map(|s| s.factor),
            sigma_factor_interval: [errors.scale.map(|s| s.low), errors.scale.map(|s| s.high)]
                .map(|end| end.filter(|end| end.is_finite())),
        }
    }
}

/// J = J_b + J_o + J_q.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Terms {
    /// J_b.
    pub background: f64,
    /// J_o.
    pub observation: f64,
    /// J_q.
    pub model_error: f64,
}

impl From<CostTerms> for Terms {
    fn from(t: CostTerms) -> Self {
        Terms { background: t.background, observation: t.observation, model_error: t.model_error }
    }
}

impl Summary {
    /// The summary of a run.
    pub fn new(outcome: &Outcome) -> Summary {
        let experiment = &outcome.experiment;
        let scene = &experiment.scene;
        Summary {
            verdict: outcome.judgement.verdict,
            verdict_text: outcome.judgement.text.clone(),
            scene: experiment.name.clone(),
            seed: scene.seed,
            version: env!("CARGO_PKG_VERSION"),
            method: scene.algorithm.method.name(),
            minimizer: scene.algorithm.solver_name(),
            status: outcome.status.name(),
            n_state: outcome.trajectories.dim,
            n_control: experiment.n_control(),
            n_obs: outcome.analysis.observations,
            j_background: outcome.j_background,
            j_analysis: outcome.analysis.value,
            j_terms: outcome.analysis.terms.into(),
            j_shares: outcome.shares.clone(),
            gradient_norm_first: outcome.gradient_norms[0],
            gradient_norm_last: outcome.gradient_norms[1],
            amplification: outcome.amplification.map(WindowAmplification::from),
            model_error: outcome
                .model_errors
                .as_ref()
                .map(|e| ModelErrorSize::new(e, &outcome.analysis.terms)),
            accepted_steps: outcome.accepted_steps.clone(),
            outer_iterations: outcome.iterations[0],
            inner_iterations: outcome.iterations[1],
            attempts: outcome.attempts.clone(),
            counts: outcome.counts,
            rejected: outcome.rejected.clone(),
            chi2: outcome.analysis.chi2,
            degrees_of_freedom: outcome.has_posterior.then_some(outcome.analysis.degrees_of_freedom),
            exact_hessian: outcome.exact_hessian,
            next_observation: outcome.next_observation.clone(),
            sources: outcome.sources.clone(),
            considered: outcome.considered.clone(),
            estimates: outcome.estimates.clone(),
            with_constants_known: outcome.with_constants_known.clone(),
            rmse: outcome.rmse.clone(),
            seconds: outcome.seconds,
            peak_bytes: peak_bytes(),
            innovations: outcome.fit.clone(),
            evidence: outcome.evidence.clone(),
            withheld: outcome.withheld.clone(),
            forecast: outcome.forecast.clone(),
            left_out: experiment.left_out.clone(),
            warnings: outcome.warnings.clone(),
        }
    }

    /// As JSON text.
    #[allow(clippy::missing_panics_doc)] // a summary is plain data
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("a summary is plain data");
        text.push('\n');
        text
    }
}

/// The process's largest resident set, as Linux tells it.
pub(super) fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    Some(1024 * line.split_whitespace().nth(1)?.parse::<u64>().ok()?)
}
