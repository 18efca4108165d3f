"""Assimilation of a model written in Python."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Dict, List, NamedTuple, Optional, Protocol, Sequence, Tuple, Union

import numpy as np

from . import _core


class Model(Protocol):
    """What a model has. A step depends on k and x alone; vectors have the length of a state."""

    def step(self, k: int, x: np.ndarray) -> Any:
        """x_{k+1} = M_k(x_k)."""

    def tangent(self, k: int, x: np.ndarray, dx: np.ndarray) -> Any:
        """∂M_k/∂x(x) dx."""

    def adjoint(self, k: int, x: np.ndarray, dy: np.ndarray) -> Any:
        """(∂M_k/∂x(x))ᵀ dy."""


#: (step, what, values, sigma): indices of components or a matrix H (values × state), σ one or for each.
Observation = Tuple[int, Any, Any, Any]


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
    members: Union[int, Any] = 40,
    localization: Any = None,
    seed: int = 0,
) -> "Analysis":
    """The initial state that explains the observations, of a model written in Python:

        J(x) = ½‖x − x_b‖²_{B⁻¹} + ½ Σ_k ‖y_k − H_k x_k‖²_{R_k⁻¹},   x_{k+1} = M_k(x_k)

    `model` has `step(k, x)`, `tangent(k, x, dx)` and `adjoint(k, x, dy)`, each returning a vector (see
    `check_model`); "4denvar" needs `step` alone. A step that cannot be taken returns NaN: J is infinite
    there. An exception of the model ends the run and comes out as it is.

    `background` is x_b (n). `covariance` is B: one σ, n standard deviations, or an n × n matrix.
    `observations` are (step, what, values, sigma): what are the indices of components, or a matrix H with a
    row for each value (NumPy or scipy.sparse); sigma is one number or one for each value.

    `method`: "4dvar", "4dvar-incremental", "4d-psas", "3dvar" (observations at step 0 only; `model` may be
    None), "4denvar". `minimizer`, for "4dvar" and "3dvar": "trust-region", "gauss-newton-cg",
    "lbfgs", "adam", "auto" and others of scenes. `steps` is the length of the window; without
    it the window ends at the last observation. Up to some thousand unknowns; `posterior=False` leaves out the
    posterior, n tangent or m adjoint sweeps.

    For "4denvar": `members` are states (member, n) about the background, or their number: then they are
    drawn from N(x_b, B) with `seed`. `localization` is an n × n matrix of correlations that B of the members
    is multiplied by, entry by entry.

    Raises `AssimilationError` for what does not fit together, `ModelError` or `AssimilationError` where the
    model cannot be run from the background.
    """
    x_b = _vector(background, "background")
    n = len(x_b)
    b = np.asarray(covariance, dtype=float)
    if b.shape not in ((), (n,), (n, n)):
        raise _core.AssimilationError(
            f"covariance of shape {b.shape}: one σ, {n} of them, or a matrix of {n} × {n}"
        )
    seen = [_observation(i, n, *one) for i, one in enumerate(observations)]
    last = max((one["step"] for one in seen), default=0)
    if method == "3dvar" and last > 0:
        raise _core.AssimilationError(f"method '3dvar' takes observations at step 0 only, not at step {last}")
    drawn = isinstance(members, (int, np.integer))
    ensemble = np.empty((0, n)) if drawn else np.asarray(members, dtype=float)
    if ensemble.ndim != 2 or ensemble.shape[1] != n:
        raise _core.AssimilationError(f"members of shape {ensemble.shape}: (member, {n})")
    taper = np.empty((0, 0)) if localization is None else np.asarray(localization, dtype=float)
    if localization is not None and taper.shape != (n, n):
        raise _core.AssimilationError(f"localization of shape {taper.shape}: a matrix of {n} × {n}")
    problem = {
        "background": x_b.tolist(),
        "covariance": np.broadcast_to(b, (n,) if b.ndim < 2 else (n, n)).ravel().tolist(),
        "observations": seen,
        "steps": last if steps is None else int(steps),
        "method": method,
        "minimizer": minimizer,
        "gradient_tolerance": float(gradient_tolerance),
        "max_iterations": int(max_iterations),
        "posterior": bool(posterior),
        "members": ensemble.ravel().tolist(),
        "count": int(members) if drawn else 0,
        "localization": taper.ravel().tolist(),
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
        """Standard deviations of the errors of `background` (n); those of the members for 4denvar."""
        return self._arrays["sigma_background"]

    @property
    def trajectory(self) -> np.ndarray:
        """The run from `state`, (step, n)."""
        return self._arrays["trajectory"]

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
    def terms(self) -> Tuple[float, float]:
        """J_b and J_o at the analysis."""
        return self._analysis.terms

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
        """P_a, n × n: the inverse of the Gauss-Newton Hessian at the analysis."""
        return self._analysis.covariance()

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Draws of N(x_a, P_a), one a row; the same seed gives the same draws."""
        return self._analysis.draws(count, seed)

    def __repr__(self) -> str:
        return f"<varda Analysis: {self.status}, J = {self.J:.6g}, 2J/m = {self.chi2:.3f}>"


class Check(NamedTuple):
    """One check of a model."""

    what: str
    """What was checked."""
    value: float
    """The number found."""
    bound: float
    """The most it may be."""
    passed: bool
    """Whether it is."""


class CheckReport(List[Check]):
    """What `check_model` found."""

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self)

    def __str__(self) -> str:
        width = max((len(check.what) for check in self), default=0)
        rows = (
            f"{'ok  ' if c.passed else 'FAIL'} {c.what:{width}}  {c.value:.2e} (at most {c.bound:.2e})"
            for c in self
        )
        return "\n".join(rows)


def check_model(model: Any, x: Any, *, scale: Any = 1.0, steps: int = 3, seed: int = 0) -> CheckReport:
    """Whether a model is what `assimilate` takes it for, over some steps from the state x: the same result
    each time, a tangent that is the derivative of the step (Taylor), an adjoint that is the transpose of the
    tangent (dot product).

    `scale` is a typical change of each component, so that components of different units are comparable.
    A term that vanishes at x shows nothing: take a state without zeros.
    """
    start = _vector(x, "x")
    scales = np.broadcast_to(np.asarray(scale, dtype=float), start.shape)
    found = _core.check_model(model, start.tolist(), scales.tolist(), steps, seed)
    return CheckReport(Check(*one) for one in found)


def _vector(value: Any, what: str) -> np.ndarray:
    out = np.asarray(value, dtype=float)
    if out.ndim != 1:
        raise _core.AssimilationError(f"{what} of shape {out.shape}: a vector")
    return out


def _observation(i: int, n: int, step: int, what: Any, values: Any, sigma: Any) -> Dict[str, Any]:
    """An observation as plain lists."""
    y = np.atleast_1d(np.asarray(values, dtype=float))
    m = len(y)
    components: List[int] = []
    entries: List[Tuple[int, int, float]] = []
    matrix = what if hasattr(what, "tocoo") else np.asarray(what)
    if matrix.ndim == 2:
        if matrix.shape != (m, n):
            raise _core.AssimilationError(
                f"observation {i}: H of shape {matrix.shape} for {m} values of a state of {n}"
            )
        if hasattr(matrix, "tocoo"):
            sparse = matrix.tocoo()
            rows, columns, numbers = sparse.row, sparse.col, sparse.data
        else:
            rows, columns = np.indices(matrix.shape).reshape(2, -1)
            numbers = matrix.ravel()
        entries = list(zip(rows.tolist(), columns.tolist(), numbers.astype(float).tolist()))
    else:
        indices = np.atleast_1d(matrix)
        if indices.dtype.kind not in "iu" or not np.all((indices >= 0) & (indices < n)):
            raise _core.AssimilationError(
                f"observation {i}: components are integers from 0 to {n - 1}, not {indices.tolist()}"
            )
        components = indices.tolist()
    try:
        sigmas = np.broadcast_to(np.asarray(sigma, dtype=float), y.shape)
    except ValueError:
        raise _core.AssimilationError(
            f"observation {i}: {np.size(sigma)} standard deviations for {m} values"
        ) from None
    return {
        "step": int(step),
        "components": components,
        "entries": entries,
        "values": y.tolist(),
        "sigma": sigmas.tolist(),
    }
