"""Scenes: run, simulated, checked, listed."""

from __future__ import annotations

import json
import os
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Union

from . import _core
from ._result import Modes, Result, Simulation

#: The name of a shipped scene, the path of a file, TOML text (it has a line break), or its tables.
Scene = Union[str, "os.PathLike[str]", Mapping[str, Any]]


class Finding(NamedTuple):
    """Something that looks wrong in a scene or its files, before anything is minimized."""

    severity: str
    """"error": a run makes no sense; "warning": it may be meant."""
    place: str
    """The key, file or part of the scene."""
    text: str
    """What is wrong, with its value and what was probably meant."""


def run(
    scene: Scene,
    *,
    set: Optional[Mapping[str, Any]] = None,  # the name that the command line has
    seed: Optional[int] = None,
    out: Union[str, "os.PathLike[str]", None] = None,
    **overrides: Any,
) -> Result:
    """Assimilates a scene: minimises its cost and returns what `varda run` writes.

    `set` maps dotted keys to values, as `--set` does: ``set={"observations.sigma": 0.01}``. Keyword
    arguments are the same with two underscores for a dot: ``observations__sigma=0.01``. `seed` is that of
    every random number. With `out` the folder of the command line is written too.

    The same scene gives the same bits as the command line. Other threads of Python go on meanwhile; Ctrl-C
    ends the run with KeyboardInterrupt.

    Raises `SceneError`, `DataError`, `ModelError`, `AssimilationError` or `ResultError`, all of them
    `VardaError`, with the text of the command line.

    >>> result = run("lorenz63")
    >>> result.status
    'converged'
    """
    folder = None if out is None else os.fspath(out)
    return Result(_core.run(_source(scene), _assignments(set, seed, overrides), folder))


def simulate(
    scene: Scene,
    *,
    set: Optional[Mapping[str, Any]] = None,
    seed: Optional[int] = None,
    out: Union[str, "os.PathLike[str]", None] = None,
    **overrides: Any,
) -> Simulation:
    """Runs the model of a scene forward: from the truth where there is one, else from the background.

    Arguments and errors are those of `run`.
    """
    folder = None if out is None else os.fspath(out)
    return Simulation(_core.simulate(_source(scene), _assignments(set, seed, overrides), folder))


def check(
    scene: Scene,
    *,
    set: Optional[Mapping[str, Any]] = None,
    seed: Optional[int] = None,
    **overrides: Any,
) -> List[Finding]:
    """What looks wrong in a scene and its files, errors first: one forward run, no minimization."""
    found = _core.check(_source(scene), _assignments(set, seed, overrides))
    return [Finding(*one) for one in found]


def modes(
    scene: Scene,
    count: int = 10,
    *,
    set: Optional[Mapping[str, Any]] = None,
    seed: Optional[int] = None,
    **overrides: Any,
) -> Modes:
    """The lowest natural modes of the rod of a scene about its shape at rest."""
    return Modes(**_core.modes(_source(scene), _assignments(set, seed, overrides), count))


def scenes() -> Dict[str, str]:
    """Name and title of the scenes that come with the package."""
    return dict(_core.scenes())


def show(name: str) -> str:
    """The TOML text of a scene that comes with the package."""
    return _core.show(name)


def _source(scene: Scene) -> Dict[str, str]:
    if isinstance(scene, Mapping):
        return {"kind": "json", "text": _json(_without_none(scene))}
    name = os.fspath(scene)
    return {"kind": "text" if "\n" in name else "name", "text": name}


def _assignments(
    set: Optional[Mapping[str, Any]], seed: Optional[int], overrides: Mapping[str, Any]
) -> List[str]:
    """The `key=value` of the command line."""
    out: List[str] = []

    def add(key: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for part, inner in value.items():
                add(f"{key}.{part}", inner)
        else:
            # strings, numbers, booleans and lists of them are written alike in JSON and TOML
            out.append(f"{key}={_json(value)}")

    for key, value in (set or {}).items():
        add(key, value)
    for key, value in overrides.items():
        add(key.replace("__", "."), value)
    if seed is not None:
        add("seed", seed)
    return out


def _json(value: Any) -> str:
    try:
        return json.dumps(value, default=_plain, ensure_ascii=False, allow_nan=False)
    except ValueError as error:
        raise _core.SceneError(f"a scene has finite numbers only: {error}") from None


def _plain(value: Any) -> Any:
    """Arrays and numbers of NumPy, and paths, as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "__fspath__"):
        return os.fspath(value)
    raise TypeError(f"a scene has no values of type {type(value).__name__}")


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(inner) for key, inner in value.items() if inner is not None}
    return value
