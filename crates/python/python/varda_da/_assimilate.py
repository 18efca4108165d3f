"""Assimilation of a model written in Python: one window."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Dict, Optional, Sequence, Tuple, Union

import numpy as np

from . import _core, _problem
from ._problem import Observation, Terms

#: β_s and β_e of a hybrid: half of the covariance from each.
HALF_EACH = (0.5**0.5, 0.5**0.5)


def assimilate(
    model: Any,
    background: Any,
    covariance: Any,
    observations: Sequence[Observation],
    *,
    method: str = "4dvar",
    minimizer: str = "trust-region",
    steps: Optional[int] = None,
    gradient_tolerance: float = 1e-6,
    max_iterations: int = 100,
    posterior: bool = True,
    robust: Optional[float] = None,
    model_error: Any = None,
    members: Union[int, Any] = 40,
    localization: Any = None,
    weights: Tuple[float, float] = HALF_EACH,
    seed: int = 0,
) -> "Analysis":
    """The initial state that explains the observations, of a model written in Python:

        J(x) = ½‖x − x_b‖²_{B⁻¹} + ½ Σ_k ‖y_k − H_k x_k‖²_{R_k⁻¹},   x_{k+1} = M_k(x_k)

    `model` has `step(k, x)`, `tangent(k, x, dx)` and `adjoint(k, x, dy)`, each returning a vector (see
    `check_model`, and `JaxModel` for derivatives by JAX); ensembles need `step` alone. A step that cannot be
    taken returns NaN: J is infinite there. An exception of the model ends the run and comes out as it is.

    `background` is x_b (n). `covariance` is B: one σ, n standard deviations, or an n × n matrix.
    `observations` are (step, what, values, sigma): what are the indices of components, or a matrix H with a
    row for each value (NumPy or scipy.sparse); sigma is one number or one for each value.

    `method` is one of

    - "4dvar", "4dvar-incremental", "4d-psas", "blue" (the closed form, linearized once);
    - "3dvar", "3dvar-incremental", "psas": observations at step 0 only; `model` may be None;
    - "weak-forcing", "weak-state": the model errs, x_{k+1} = M_k(x_k) + η_j, and its errors are estimated
      with ½ Σ_j ‖η_j‖²_{Q⁻¹} in J. `model_error` is Q, given as B is, or a `Forcing` that says when and
      where;
    - "4denvar", "hybrid-4denvar": forward runs of an ensemble in the place of tangent and adjoint.

    `minimizer`, for "4dvar", "3dvar" and "weak-forcing": "trust-region", "gauss-newton-cg", "newton",
    "lbfgs", "adam", "auto". `robust`, for "4dvar" and "3dvar": departures beyond so many σ count linearly
    (Huber).
    `steps` is the length of the window; without it the window ends at the last observation. Up to some
    thousand unknowns; `posterior=False` leaves out the posterior, n tangent or m adjoint sweeps.

    For ensembles: `members` are states (member, n) about the background, or their number: then they are
    drawn from N(x_b, B) with `seed`, as those of a scene. `localization` is an n × n matrix of correlations
    that B of the members is multiplied by, entry by entry. `weights` are β_s and β_e of a hybrid, B =
    β_s² B + β_e² B_e.

    Raises `AssimilationError` for what does not fit together, `ModelError` or `AssimilationError` where the
    model cannot be run from the background.
    """
    x_b = _problem.vector(background, "background")
    n = len(x_b)
    seen = [_problem.observation(i, n, *one) for i, one in enumerate(observations)]
    last = max((one["step"] for one in seen), default=0)
    if method in ("3dvar", "3dvar-incremental", "psas") and last > 0:
        raise _core.AssimilationError(
            f"method {method!r} takes observations at step 0 only, not at step {last}"
        )
    if model_error is not None and not method.startswith("weak-"):
        raise _core.AssimilationError(
            f"method {method!r} takes the model to be right: model_error goes with weak-forcing, weak-state"
        )
    problem = {
        "background": x_b.tolist(),
        "covariance": _problem.covariance(covariance, n, "covariance"),
        "observations": seen,
        "steps": last if steps is None else int(steps),
        "method": method,
        "minimizer": minimizer,
        "gradient_tolerance": float(gradient_tolerance),
        "max_iterations": int(max_iterations),
        "robust": None if robust is None else float(robust),
        "posterior": bool(posterior),
        "model_error": _problem.model_error(model_error, n),
        "ensemble": _problem.ensemble(members, localization, weights, n),
        "seed": int(seed),
    }
    return Analysis(_core.analyse(model, problem))


class Analysis:
    """The result of `assimilate`."""

    def __init__(self, analysis: Any) -> None:
        self._analysis = analysis
        self._arrays: Dict[str, np.ndarray] = analysis.arrays()

    @property
    def state(self) -> np.ndarray:
        """x_a, the initial state of the analysis (n)."""
        return self._arrays["state"]

    @property
    def background(self) -> np.ndarray:
        """x_b (n)."""
        return self._arrays["background"]

    @property
    def sigma(self) -> Optional[np.ndarray]:
        """Standard deviations of the errors of `state` (n); None without a posterior."""
        return self._arrays.get("sigma")

    @property
    def sigma_background(self) -> np.ndarray:
        """Standard deviations of the errors of `background` (n); those of the ensemble where there is one."""
        return self._arrays["sigma_background"]

    @property
    def trajectory(self) -> np.ndarray:
        """The run from `state` (step, n), with the errors of the model that were found."""
        return self._arrays["trajectory"]

    @property
    def model_errors(self) -> Optional[np.ndarray]:
        """η_j (j, component that errs), one for each sub-window that the observations reach; None where no
        errors of the model are estimated."""
        return self._arrays.get("model_errors")

    @property
    def sigma_model_errors(self) -> Optional[np.ndarray]:
        """Standard deviations of `model_errors`, in its shape; None without a posterior."""
        return self._arrays.get("sigma_model_errors")

    @property
    def members(self) -> Optional[np.ndarray]:
        """Members of the posterior about `state` (member, n), by the square root of the ensemble; None
        without an ensemble or a posterior."""
        return self._arrays.get("members")

    @property
    def history(self) -> np.ndarray:
        """J and ‖∇J‖ in units of the background's errors, iteration by iteration (iteration, 2)."""
        return self._arrays["history"]

    @property
    def status(self) -> str:
        """How the minimization ended: converged, max_iterations, linearized_once, stalled, failed."""
        return self._analysis.status

    @property
    def converged(self) -> bool:
        """Whether the gradient has vanished as far as was asked for."""
        return self.status == "converged"

    @property
    def J(self) -> float:
        """The cost at the analysis."""
        return self._analysis.value

    @property
    def terms(self) -> Terms:
        """J_b, J_o and J_q at the analysis."""
        return Terms(*self._analysis.terms)

    @property
    def chi2(self) -> float:
        """2J/m: about 1 where B and R are what they should be; 0 where nothing is observed."""
        count = self._analysis.observations
        return 2.0 * self.J / count if count else 0.0

    @property
    def degrees_of_freedom(self) -> Optional[float]:
        """Degrees of freedom for signal; None without a posterior."""
        return self._analysis.degrees_of_freedom

    @cached_property
    def covariance(self) -> np.ndarray:
        """P_a, n × n: the inverse of the Gauss-Newton Hessian at the analysis, errors of the model
        integrated out. Not for an ensemble of more than 2000 directions (members × rank of the localization)."""
        return self._analysis.covariance()

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Draws of N(x_a, P_a), one a row; the same seed gives the same draws."""
        return self._analysis.draws(count, seed)

    def __repr__(self) -> str:
        return f"<varda Analysis: {self.status}, J = {self.J:.6g}, 2J/m = {self.chi2:.3f}>"
