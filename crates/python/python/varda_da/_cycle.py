"""Assimilation of a model written in Python: window after window."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Sequence, Tuple, Union

import numpy as np

from . import _core, _problem
from ._assimilate import HALF_EACH
from ._problem import Observation, Terms


@dataclass(frozen=True)
class Window:
    """One window of a sequence."""

    index: int
    """Index from 0."""
    first_step: int
    """Its first step, counted from the start of the sequence."""
    background: np.ndarray
    """x_b at its start (n)."""
    analysis: np.ndarray
    """x_a at its start (n)."""
    end: np.ndarray
    """The analysed state at its end (n): of the run from x_a, or the mean of the members' runs."""
    sigma: Optional[np.ndarray]
    """Standard deviations expected (n): at its end, by an ensemble; of the background of the next window, of
    a propagated posterior; None for a static B."""
    J: float
    """The cost at the analysis."""
    terms: Terms
    """J_b, J_o and J_q."""
    observations: int
    """m, the number of values used."""
    chi2: float
    """2J/m; 0 where nothing is observed."""
    status: str
    """How the minimization ended, as `Analysis.status`."""
    failure: Optional[str]
    """Why, where a failing model ended it."""
    inflation: float
    """The factor on the deviations of the background."""
    drawn_again: int
    """Members that failed on the way to the next window and were drawn again."""
    model_errors: Optional[np.ndarray]
    """η_j (j, component that errs); None where none are estimated."""
    trajectory: np.ndarray
    """The run from x_a to its end and the start of the next window (step, n)."""


class Cycles(List[Window]):
    """The result of `cycle`: its windows, and their numbers as arrays."""

    def __init__(self, windows: Sequence[Window], window: int, shift: int, state: Any) -> None:
        super().__init__(windows)
        self._window, self._shift = window, shift
        self.state = state
        """What the next window begins with: `cycle(..., state=...)` goes on from there, with the same bits."""

    @property
    def first_step(self) -> np.ndarray:
        """First steps of the windows (window,)."""
        return np.array([w.first_step for w in self], dtype=int)

    @property
    def background(self) -> np.ndarray:
        """x_b at the starts of the windows (window, n)."""
        return np.array([w.background for w in self])

    @property
    def analysis(self) -> np.ndarray:
        """x_a at the starts of the windows (window, n)."""
        return np.array([w.analysis for w in self])

    @property
    def end(self) -> np.ndarray:
        """Analysed states at the ends of the windows (window, n)."""
        return np.array([w.end for w in self])

    @property
    def sigma(self) -> Optional[np.ndarray]:
        """`Window.sigma` of all windows (window, n); None for a static B."""
        rows = [w.sigma for w in self if w.sigma is not None]
        return np.array(rows) if rows else None

    @property
    def J(self) -> np.ndarray:
        """Costs (window,)."""
        return np.array([w.J for w in self])

    @property
    def chi2(self) -> np.ndarray:
        """2J/m (window,): about 1 where B and R are what they should be."""
        return np.array([w.chi2 for w in self])

    @property
    def status(self) -> List[str]:
        """How the minimizations ended."""
        return [w.status for w in self]

    @property
    def trajectory(self) -> np.ndarray:
        """The runs of the analyses, joined (step, n), from the first window here on. A step that two windows
        share has the later one's value, which has seen more."""
        parts = [w.trajectory[: self._shift] for w in self[:-1]]
        parts += [w.trajectory[: self._window + 1] for w in self[-1:]]
        return np.concatenate(parts) if parts else np.empty((0, 0))

    @property
    def members(self) -> Optional[np.ndarray]:
        """The ensemble at the start of the window to come (member, n), or the columns of a root of its B
        where a posterior is propagated; None for a static B."""
        columns = self.state.columns
        return columns if len(columns) else None

    def __repr__(self) -> str:
        converged = sum(status == "converged" for status in self.status)
        return f"<varda Cycles: {len(self)} windows, {converged} converged>"


def cycle(
    model: Any,
    background: Any,
    covariance: Any,
    observations: Sequence[Observation],
    *,
    window: int,
    shift: Optional[int] = None,
    count: Optional[int] = None,
    method: str = "4dvar",
    minimizer: str = "trust-region",
    carry: Optional[str] = None,
    inflation: Union[float, str] = 1.0,
    static_weight: float = 0.0,
    dropped_variance: float = 1e-8,
    model_error: Any = None,
    members: Union[int, Any] = 40,
    localization: Any = None,
    weights: Tuple[float, float] = HALF_EACH,
    spread: float = 1.0,
    rotation: bool = False,
    update: str = "square-root",
    gradient_tolerance: float = 1e-6,
    max_iterations: int = 100,
    seed: int = 0,
    on_window: Optional[Callable[[Window], Any]] = None,
    state: Any = None,
) -> Cycles:
    """Assimilates window after window of a long run, each from the analysis of the one before:

        x_b, B  →  x_a = argmin J over window c  →  x_b' = M(x_a),  B' as `carry` says

    `model`, `background`, `covariance`, `observations`, `method`, `minimizer`, `model_error`, `members`,
    `localization`, `weights` are those of `assimilate`; steps, those that the model is called with too, are
    counted from the start of the sequence.

    `window` is K, the steps of a window; 0 analyses one time ("3dvar", or an ensemble Kalman filter by
    "4denvar"). `shift` are the steps from one window to the next: K by default, end to end; fewer
    overlap, and every observation is used once. `count` is the number of windows; without it they reach the
    last observation.

    `carry` says where B of the next window comes from: "static", the same B; "propagated", the posterior
    carried by the tangent, α² M P_a Mᵀ + β² B with α `inflation` and β `static_weight`, without what is
    below a share `dropped_variance` of every variance ("weak-state" inverts B: it takes 0 or a static
    weight); "ensemble", the members' runs ("4denvar" and
    "hybrid-4denvar", and they alone). `inflation` multiplies the members' deviations before a
    window; "adaptive" is what the innovations ask for. `spread` is the part of the deviations over which an
    ensemble is linearized, `rotation` turns members at random about their mean, `update` is "square-root" or
    "perturbed-observations".

    With `model_error` and a method that does not estimate errors, Q widens what is handed on.

    `on_window` is called after every window and ends the sequence where it returns True. `state` goes on
    from an earlier sequence, with the same arguments.

    Raises what `assimilate` raises. A warning counts observations that no window uses.

    >>> run = varda.cycle(model, x_b, 1.0, observations, window=8)      # doctest: +SKIP
    >>> run.trajectory.shape                                            # doctest: +SKIP
    (241, 40)
    """
    x_b = _problem.vector(background, "background")
    n = len(x_b)
    window, shift = int(window), int(max(window, 1) if shift is None else shift)
    if window < 0 or shift < 1 or (window > 0 and shift > window + 1):
        raise _core.AssimilationError(f"windows of {window} steps, {shift} apart: from 1 to the window + 1")
    seen = [_problem.observation(i, n, *one) for i, one in enumerate(observations)]
    last = max((one["step"] for one in seen), default=0)
    if count is None:
        count = 1 + max(0, -((window - last) // shift) if window else last // shift)
    used = [bool(_windows_of(one["step"], window, shift, count)) for one in seen]
    if not all(used):
        unused = sum(len(one["values"]) for one, inside in zip(seen, used) if not inside)
        warnings.warn(f"{unused} observed values are in no window", stacklevel=2)
    if update not in ("square-root", "perturbed-observations"):
        raise _core.AssimilationError(f"update {update!r}: square-root or perturbed-observations")
    if isinstance(inflation, str) and inflation != "adaptive":
        raise _core.AssimilationError(f'inflation {inflation!r}: a number or "adaptive"')
    ensemble = method in ("4denvar", "hybrid-4denvar")
    settings = {
        "shift": shift,
        "count": int(count),
        "carry": carry or ("ensemble" if ensemble else "static"),
        "inflation": None if isinstance(inflation, str) else float(inflation),
        "static_weight": float(static_weight),
        "dropped_variance": float(dropped_variance),
        "spread": float(spread),
        "rotation": bool(rotation),
        "perturbed_observations": update == "perturbed-observations",
    }
    if settings["carry"] != "ensemble" and settings["inflation"] is None:
        raise _core.AssimilationError('inflation "adaptive" is that of an ensemble')
    problem = {
        "background": x_b.tolist(),
        "covariance": _problem.covariance(covariance, n, "covariance"),
        "steps": window,
        "method": method,
        "minimizer": minimizer,
        "gradient_tolerance": float(gradient_tolerance),
        "max_iterations": int(max_iterations),
        "robust": None,
        "posterior": False,
        "model_error": _problem.model_error(model_error, n),
        "ensemble": _problem.ensemble(members, localization, weights, n),
        "seed": int(seed),
    }
    done: List[Window] = []
    while (state.next if state is not None else 0) < count:
        first = (state.next if state is not None else 0) * shift
        inside = [{**o, "step": o["step"] - first} for o in seen if 0 <= o["step"] - first <= window]
        found, state = _core.cycle_window(model, {**problem, "observations": inside}, settings, state)
        found["terms"] = Terms(*found["terms"])
        done.append(Window(**found))
        if on_window is not None and on_window(done[-1]) is True:
            break
    return Cycles(done, window, shift, state)


def _windows_of(step: int, window: int, shift: int, count: int) -> range:
    """The windows that a step is in."""
    return range(max(0, -((window - step) // shift)), min(count, step // shift + 1))
