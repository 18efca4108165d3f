"""Models written in Python, and checks of them."""

from __future__ import annotations

from typing import Any, Callable, List, NamedTuple, Protocol

import numpy as np

from . import _core


class Model(Protocol):
    """What a model has. A step depends on k and x alone; vectors have the length of a state.

    A model with the attribute ``batched = True`` takes several vectors at once: dx and dy are then arrays
    (P, n), one vector a row, and so is what it returns. A posterior of n unknowns calls it once a step, not
    n times.
    """

    def step(self, k: int, x: np.ndarray) -> Any:
        """x_{k+1} = M_k(x_k)."""

    def tangent(self, k: int, x: np.ndarray, dx: np.ndarray) -> Any:
        """∂M_k/∂x(x) dx."""

    def adjoint(self, k: int, x: np.ndarray, dy: np.ndarray) -> Any:
        """(∂M_k/∂x(x))ᵀ dy."""


class JaxModel:
    """A model from its step alone, written in jax.numpy: tangent and adjoint are JAX's jvp and vjp, compiled,
    of several vectors at once.

    The step number k is traced: a step may compute with it, not branch on it. JAX must be in double
    precision: ``jax.config.update("jax_enable_x64", True)``.

        model = varda.JaxModel(lambda k, x: x + 0.01 * jnp.sin(x))

    Raises `AssimilationError` in single precision, ImportError without jax.
    """

    batched = True

    def __init__(self, step: Callable[[Any, Any], Any]) -> None:
        import jax

        if not jax.config.jax_enable_x64:
            raise _core.AssimilationError(
                'JAX is in single precision: jax.config.update("jax_enable_x64", True) before its first use'
            )

        def tangent(k: Any, x: Any, dx: Any) -> Any:
            _, product = jax.linearize(lambda x: step(k, x), x)
            return jax.vmap(product)(dx)

        def adjoint(k: Any, x: Any, dy: Any) -> Any:
            _, product = jax.vjp(lambda x: step(k, x), x)
            return jax.vmap(lambda row: product(row)[0])(dy)

        self._step, self._tangent, self._adjoint = jax.jit(step), jax.jit(tangent), jax.jit(adjoint)

    def step(self, k: int, x: np.ndarray) -> Any:
        """x_{k+1} = M_k(x_k)."""
        return self._step(k, x)

    def tangent(self, k: int, x: np.ndarray, dx: np.ndarray) -> Any:
        """∂M_k/∂x(x) dx of the rows of dx (P, n)."""
        return self._tangent(k, x, dx)

    def adjoint(self, k: int, x: np.ndarray, dy: np.ndarray) -> Any:
        """(∂M_k/∂x(x))ᵀ dy of the rows of dy (P, n)."""
        return self._adjoint(k, x, dy)


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
    start = np.asarray(x, dtype=float)
    if start.ndim != 1:
        raise _core.AssimilationError(f"x of shape {start.shape}: a vector")
    scales = np.broadcast_to(np.asarray(scale, dtype=float), start.shape)
    found = _core.check_model(model, start.tolist(), scales.tolist(), steps, seed)
    return CheckReport(Check(*one) for one in found)
