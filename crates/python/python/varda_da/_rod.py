"""Rods without an assimilation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from . import _core
from ._result import Modes, Simulation
from ._scene import Scene, _assignments, _source, modes, simulate

if TYPE_CHECKING:
    import scipy.sparse  # type: ignore[import-untyped,unused-ignore]


class Rest(NamedTuple):
    """A rod at rest."""

    vertices: np.ndarray
    """Places of the vertices (vertex, 3) [m]."""
    theta: np.ndarray
    """Angles of the edges against frames free of twist (edge) [rad]; zero where twist is no unknown."""


class Energy(NamedTuple):
    """Elastic energies [J]."""

    stretch: float
    bend: float
    twist: float

    @property
    def total(self) -> float:
        """Their sum [J]."""
        return self.stretch + self.bend + self.twist


class Rod:
    """A discrete elastic rod with its supports and loads: that of a scene, or of keywords.

        Rod("hanging-rod", set={"model.segments": 50})
        Rod(length=0.6, segments=12, section={"kind": "circle", "radius": 0.008},
            material={"youngs_modulus": 1e6, "poisson_ratio": 0.5, "density": 1100.0},
            gravity=[0.0, 0.0, -9.81],
            start={"position": [0.0, 0.0, 0.0], "tangent": [1.0, 0.0, 0.0], "director": [0.0, 0.0, 1.0]})

    The keywords are those of `[model]` of a scene, in SI units.
    """

    def __init__(
        self, scene: Optional[Scene] = None, *, set: Optional[Mapping[str, Any]] = None, **model: Any
    ) -> None:
        if scene is None:
            scene = _scene_of(model)
        elif model:
            raise TypeError("a rod is that of a scene, changed by set=, or of keywords")
        self._scene, self._set = scene, set
        self._rod = _core.Rod(_source(scene), _assignments(set, None, {}))
        self._arc_length, self._masses = self._rod.vertices()

    @property
    def segments(self) -> int:
        """Number of edges n; there are n + 1 vertices."""
        return len(self._arc_length) - 1

    @property
    def arc_length(self) -> np.ndarray:
        """Arc length of every vertex [m]."""
        return self._arc_length

    @property
    def masses(self) -> np.ndarray:
        """Mass of every vertex [kg]."""
        return self._masses

    def equilibrium(self) -> Rest:
        """The rod at rest under its loads, supports where they are at the start of the window."""
        return Rest(*self._rod.at_rest())

    def modes(self, count: int = 10) -> Modes:
        """The lowest natural modes about the shape at rest."""
        return modes(self._scene, count, set=self._set)

    def simulate(self, **overrides: Any) -> Simulation:
        """The scene run forward, as `varda.simulate`; a rod of keywords starts at rest:
        ``simulate(time__step=0.01, time__window=100)``."""
        return simulate(self._scene, set=self._set, **overrides)

    def energy(
        self, vertices: Any, theta: Any = None, *, director: Any = None, frames_at: Any = None
    ) -> Energy:
        """Elastic energy at vertices (n + 1, 3) [m] and angles (n) [rad] of the edges' sections.

        Angles are against frames that are free of twist along `frames_at` (the vertices themselves, unless
        other ones are given) and carried with the edges from there. They start at the first edge from
        `director`, or from some perpendicular: that matters to rods with a natural curvature or unequal
        stiffness only.
        """
        x, angles = self._checked(vertices, theta)
        at = x if frames_at is None else self._checked(frames_at, theta)[0]
        return Energy(*self._rod.energy(at, _director(director), x, angles))

    def gradient(self, vertices: Any, theta: Any = None, *, director: Any = None) -> np.ndarray:
        """∂E/∂(x, θ) of `energy` with frames free of twist at these vertices: 4n + 3 numbers in the order
        x_0, y_0, z_0, x_1 … z_n [N], θ^0 … θ^{n−1} [N m]. Forces are minus these."""
        return self._rod.derivatives(_director(director), *self._checked(vertices, theta))[0]

    def hessian(self, vertices: Any, theta: Any = None, *, director: Any = None) -> np.ndarray:
        """∂²E/∂(x, θ)² (4n + 3, 4n + 3), in the order of `gradient`."""
        return self._rod.derivatives(_director(director), *self._checked(vertices, theta))[1]

    def sparse_hessian(
        self, vertices: Any, theta: Any = None, *, director: Any = None
    ) -> "scipy.sparse.csc_array":
        """`hessian` without its zeros; needs scipy."""
        import scipy.sparse

        return scipy.sparse.csc_array(self.hessian(vertices, theta, director=director))

    def _checked(self, vertices: Any, theta: Any) -> Tuple[np.ndarray, np.ndarray]:
        n = self.segments
        x = np.ascontiguousarray(vertices, dtype=float)
        angles = np.zeros(n) if theta is None else np.ascontiguousarray(theta, dtype=float)
        if x.shape != (n + 1, 3) or angles.shape != (n,):
            raise _core.ModelError(
                f"vertices of shape {x.shape} and theta of shape {angles.shape}: ({n + 1}, 3) and ({n},)"
            )
        return x.ravel(), angles

    def __repr__(self) -> str:
        return f"<varda Rod: {self.segments} segments, {self._arc_length[-1]:g} m>"


def _director(value: Any) -> Optional[List[float]]:
    return None if value is None else np.asarray(value, dtype=float).tolist()


def _scene_of(model: Mapping[str, Any]) -> Mapping[str, Any]:
    """The least scene around `[model]`: it starts at rest."""
    return {
        "model": {"kind": "rod", **model},
        "time": {"integrator": "bdf2", "step": 0.01, "window": 100},
        "background": {
            "from": "truth-plus-draw",
            "covariance": {
                "kind": "kernel",
                "sigma_x": 0.01,
                "sigma_v": 0.1,
                "correlation_length_x": 0.5,
                "correlation_length_v": 0.5,
            },
        },
        "observations": {"kind": "synthetic", "places": [model.get("length", 1.0)], "every": 1, "sigma": 0.01},
    }
