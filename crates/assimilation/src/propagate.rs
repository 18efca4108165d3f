//! The posterior at later times.

use varda_implicit::Model;
use varda_linalg::interrupt;

use crate::Error;

/// Carries a root of the covariance of a control through a run: with P_z = W Wᵀ,
///
/// ```text
///     W₀ = (∂x₀/∂z) W,   W_{k+1} = M_k W_k,   P_k = W_k W_kᵀ
/// ```
///
/// with M_k linearized along `states` (x₀, x₁, … one after the other). `on_state` is called with k and
/// W_k, by columns of the length of a state: sums of squares along its rows are the variances of x_k, those
/// along the rows of H_k W_k the variances of what is observed. Exact for linear models; else the covariance
/// of small errors about this run. Takes one linearization (into slot 0) and as many tangent products as W
/// has columns a step, and memory for W_k.
///
/// ```
/// use varda_assimilation::propagate_root;
/// use varda_implicit::{Keep, Rk4, Trajectory, lorenz::Lorenz63};
///
/// let (mut model, mut run) = (Rk4::new(Lorenz63::default(), 0, 0.01), Trajectory::new());
/// let x0 = [-4.3, -5.0, 20.0];
/// run.run(&mut model, &x0, 500, Keep::States)?;
/// let states: Vec<f64> = (0..=500).flat_map(|k| run.state(k).to_vec()).collect();
/// let root = [0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1]; // σ = 0.1 each
/// let mut last = f64::NAN;
/// propagate_root(&mut model, &x0, &root, &states, &mut |_, w| {
///     last = w.chunks_exact(3).map(|column| column[0] * column[0]).sum::<f64>().sqrt();
///     Ok(())
/// })?;
/// assert!(last > 0.1, "σ of x grows along the attractor: {last}");
/// # Ok::<(), varda_assimilation::Error>(())
/// ```
///
/// # Errors
/// A step that cannot be linearized, a control without a state, a calculation that was told to end, and
/// those of `on_state`.
///
/// # Panics
/// If `root` is not made of columns of the length of the control, or `states` not of whole states.
pub fn propagate_root(
    model: &mut dyn Model,
    control: &[f64],
    root: &[f64],
    states: &[f64],
    on_state: &mut dyn FnMut(usize, &[f64]) -> Result<(), Error>,
) -> Result<(), Error> {
    let (n, m) = (model.dim(), model.control_dim());
    assert!(control.len() == m && root.len().is_multiple_of(m), "the control has {m} values");
    assert!(states.len().is_multiple_of(n), "a state has {n} values");
    let mut x = vec![0.0; n];
    model.release(1);
    model.initial_state(control, &mut x)?;
    let mut columns = vec![0.0; root.len() / m * n];
    for (dz, dx) in root.chunks_exact(m).zip(columns.chunks_exact_mut(n)) {
        model.initial_tangent(dz, dx);
    }
    for (k, state) in states.chunks_exact(n).enumerate() {
        if interrupt::requested() {
            return Err(varda_linalg::Error::Interrupted.into());
        }
        on_state(k, &columns)?;
        if let Some(next) = states.get((k + 1) * n..(k + 2) * n) {
            model.linearize(0, k, state, next)?;
            model.tangent(0, &mut columns);
        }
    }
    Ok(())
}
