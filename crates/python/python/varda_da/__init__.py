"""Variational data assimilation: the state of a dynamical system from a background and noisy, sparse
observations.

    import varda_da as varda

    result = varda.run("hanging-rod")      # a shipped scene, a file, TOML text or a dict
    result.verdict, result.positions       # "fits", metres as (time, vertex, 3)

    analysis = varda.assimilate(model, background, covariance, observations)   # a model in NumPy
    cycles = varda.cycle(model, background, covariance, observations, window=8)

Numbers are in SI units. What a scene can say: `varda.show("hanging-rod")`, and the guide of Varda.
"""

from ._assimilate import Analysis, assimilate
from ._core import (
    AssimilationError,
    DataError,
    ModelError,
    ResultError,
    SceneError,
    VardaError,
    __version__,
)
from ._cycle import Cycles, Window, cycle
from ._model import Check, CheckReport, JaxModel, Model, check_model
from ._problem import Forcing, Terms
from ._result import Modes, Result, Simulation
from ._rod import Energy, Rest, Rod
from ._scene import Finding, check, modes, run, scenes, show, simulate

__all__ = [
    "Analysis",
    "AssimilationError",
    "Check",
    "CheckReport",
    "Cycles",
    "DataError",
    "Energy",
    "Finding",
    "Forcing",
    "JaxModel",
    "Model",
    "ModelError",
    "Modes",
    "Rest",
    "Result",
    "ResultError",
    "Rod",
    "SceneError",
    "Simulation",
    "Terms",
    "VardaError",
    "Window",
    "__version__",
    "assimilate",
    "check",
    "check_model",
    "cycle",
    "modes",
    "run",
    "scenes",
    "show",
    "simulate",
]
