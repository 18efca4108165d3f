"""What an assimilation is asked for, as the plain lists that the compiled part takes."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from . import _core

#: (step, what, values, sigma): indices of components or a matrix H (values × state), σ one or for each.
Observation = Tuple[int, Any, Any, Any]


class Forcing(NamedTuple):
    """The error of a model: x_{k+1} = M_k(x_k) + E η_j with η_j of covariance Q."""

    covariance: Any
    """Q of one η: one σ, one for each component that errs, or a matrix."""
    every: int = 1
    """Steps of a sub-window: one η_j for each, entering at its end."""
    held: bool = False
    """Whether η_j enters after every step of its sub-window instead: a bias ("weak-forcing")."""
    components: Optional[Sequence[int]] = None
    """The components that err; None: all. Constants carried in the state do not err."""


class Terms(NamedTuple):
    """The parts of J."""

    background: float
    """J_b."""
    observation: float
    """J_o."""
    model_error: float
    """J_q; 0 where no error of the model is estimated."""


def vector(value: Any, what: str) -> np.ndarray:
    """A vector of numbers."""
    out = np.asarray(value, dtype=float)
    if out.ndim != 1:
        raise _core.AssimilationError(f"{what} of shape {out.shape}: a vector")
    return out


def covariance(value: Any, n: int, what: str) -> List[float]:
    """n standard deviations, or the n² numbers of a matrix."""
    out = np.asarray(value, dtype=float)
    if out.shape not in ((), (n,), (n, n)):
        raise _core.AssimilationError(
            f"{what} of shape {out.shape}: one σ, {n} of them, or a matrix of {n} × {n}"
        )
    return np.broadcast_to(out, (n,) if out.ndim < 2 else (n, n)).ravel().tolist()


def model_error(value: Any, n: int) -> Optional[Dict[str, Any]]:
    """The error of a model, given as Q alone or with when it enters."""
    if value is None:
        return None
    error = value if isinstance(value, Forcing) else Forcing(value)
    components = range(n) if error.components is None else error.components
    erring = [int(component) for component in components]
    if not all(0 <= component < n for component in erring):
        raise _core.AssimilationError(f"model_error: components are integers from 0 to {n - 1}, not {erring}")
    if error.every < 1:
        raise _core.AssimilationError(f"model_error: every {error.every} steps: 1 or more")
    return {
        "covariance": covariance(error.covariance, len(erring), "covariance of the model error"),
        "components": erring,
        "every": int(error.every),
        "held": bool(error.held),
    }


def ensemble(members: Any, localization: Any, weights: Any, n: int) -> Dict[str, Any]:
    """Members or their number, their localization, the weights of a hybrid."""
    drawn = isinstance(members, (int, np.integer))
    states = np.empty((0, n)) if drawn else np.asarray(members, dtype=float)
    if states.ndim != 2 or states.shape[1] != n:
        raise _core.AssimilationError(f"members of shape {states.shape}: (member, {n})")
    taper = np.empty((0, 0)) if localization is None else np.asarray(localization, dtype=float)
    if localization is not None and taper.shape != (n, n):
        raise _core.AssimilationError(f"localization of shape {taper.shape}: a matrix of {n} × {n}")
    betas = vector(weights, "weights")
    if len(betas) != 2:
        raise _core.AssimilationError(f"{len(betas)} weights: β_s of the static part, β_e of the ensemble")
    return {
        "members": states.ravel().tolist(),
        "count": int(members) if drawn else 0,
        "localization": taper.ravel().tolist(),
        "weights": betas.tolist(),
    }


def observation(i: int, n: int, step: int, what: Any, values: Any, sigma: Any) -> Dict[str, Any]:
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
