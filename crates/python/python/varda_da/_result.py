"""Results: plain data, as arrays."""

from __future__ import annotations

import html
import json
import os
import tempfile
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, List, NamedTuple, Optional, Union

import numpy as np

if TYPE_CHECKING:
    import xarray

#: Arrays over time, with what they are and their unit: the names of `Result` and of its Dataset.
_OVER_TIME = {
    "positions": ("vertex", "position", "m"),
    "velocities": ("vertex", "velocity", "m s-1"),
    "state": ("component", "state", "1"),
}
_RUNS = {"": "analysis", "_background": "background", "_truth": "truth"}


class _Arrays:
    """Arrays of a run, as attributes."""

    _arrays: Dict[str, Any]

    def _get(self, name: str) -> Optional[np.ndarray]:
        return self._arrays.get(name)

    @property
    def time(self) -> np.ndarray:
        """Model time of every step of the window and its forecast [s]."""
        return self._arrays["time"]

    @property
    def names(self) -> List[str]:
        """A name for each number of the control, as `x[3]` or `vz[3]`."""
        return self._arrays["names"]

    @property
    def units(self) -> List[str]:
        """The SI unit of each number of the control; "1" for none."""
        return self._arrays["units"]

    @property
    def arc_length(self) -> Optional[np.ndarray]:
        """Arc length of every vertex of a rod [m]; None for other models."""
        return self._get("arc_length")

    @property
    def positions(self) -> Optional[np.ndarray]:
        """Places of the vertices of a rod (time, vertex, 3) [m], of the analysis or simulation."""
        return self._get("positions")

    @property
    def velocities(self) -> Optional[np.ndarray]:
        """Velocities of the vertices of a rod (time, vertex, 3) [m/s]; NaN where a vertex is held."""
        return self._get("velocities")

    @property
    def state(self) -> np.ndarray:
        """States (time, component) of the analysis or simulation; a rod's hold its angles too."""
        return self._arrays["state"]

    def _dataset(self) -> "xarray.Dataset":
        import xarray

        variables: Dict[str, Any] = {}
        space = self.arc_length is not None
        for name, (dim, what, unit) in _OVER_TIME.items():
            if (dim == "vertex") != space:
                continue
            dims = ("time", "vertex", "axis") if space else ("time", "component")
            for suffix, run in _RUNS.items():
                values = self._get(name + suffix)
                if values is not None:
                    variables[name + suffix] = (dims, values, _attrs(f"{what} of the {run}", unit))
            sigma = self._get(f"sigma_{name}")
            if sigma is not None:
                attrs = _attrs(f"standard deviation of the {what} of the analysis", unit)
                variables[f"sigma_{name}"] = (dims, sigma, attrs)
        coords: Dict[str, Any] = {"time": ("time", self.time, _attrs("model time", "s"))}
        if space:
            coords["arc_length"] = ("vertex", self.arc_length, _attrs("arc length of a vertex", "m"))
            coords["axis"] = ("axis", ["x", "y", "z"], _attrs("axis in space", "1"))
        return xarray.Dataset(variables, coords)


def _attrs(long_name: str, units: str) -> Dict[str, str]:
    return {"long_name": long_name, "units": units}


class Result(_Arrays):
    """The result of `run`.

    One window: every attribute. A sequence of windows (`[algorithm.cycles]`): `cycles` has a dict for each
    window, and the arrays over time are those of all windows. Several recordings (`[[recordings]]`):
    `recordings` has a `Result` for each.
    """

    def __init__(self, outcome: Any, recording: Optional[int] = None, name: str = "") -> None:
        self._outcome = outcome
        self._recording = recording
        self._name = name

    @property
    def kind(self) -> str:
        """ "window", "cycles", or "recordings"."""
        return "window" if self._recording is not None else self._outcome.kind

    @cached_property
    def summary(self) -> Dict[str, Any]:
        """What summary.json has."""
        if self._recording is not None:
            return json.loads(self._read(f"{self._name}/summary.json"))
        return json.loads(self._outcome.summary())

    @property
    def verdict(self) -> str:
        """Whether the analysis is to be believed: fits, does_not_fit, not_converged, nothing_observed."""
        return self.summary["verdict"]

    @property
    def status(self) -> str:
        """How the minimization ended: converged, max_iterations, stalled, interrupted."""
        return self.summary["status"]

    @property
    def warnings(self) -> List[str]:
        """Remarks for the user."""
        return self.summary["warnings"]

    @cached_property
    def _arrays(self) -> Dict[str, Any]:  # type: ignore[override]
        arrays = self._outcome.arrays(self._recording)
        if not arrays:
            names = ", ".join(map(repr, self.recordings))
            raise AttributeError(f"the arrays of several recordings are in .recordings: {names}")
        return arrays

    @property
    def analysis(self) -> Optional[np.ndarray]:
        """x_a, the control at the start of the window, its constants last; see `names` and `units`."""
        return self._get("analysis")

    @property
    def background(self) -> Optional[np.ndarray]:
        """x_b, in the order of `analysis`."""
        return self._get("background")

    @property
    def truth(self) -> Optional[np.ndarray]:
        """The truth of a twin experiment, in the order of `analysis`; None where it is not known."""
        return self._get("truth")

    @property
    def sigma_analysis(self) -> Optional[np.ndarray]:
        """Standard deviations of the errors of `analysis`; None without a posterior."""
        return self._get("sigma_analysis")

    @property
    def sigma_background(self) -> Optional[np.ndarray]:
        """Standard deviations of the errors of `background`."""
        return self._get("sigma_background")

    @property
    def sigma(self) -> Optional[np.ndarray]:
        """Standard deviations along the window, in the shape of `state` (time, component)."""
        return self._get("sigma_state")

    @property
    def sigma_positions(self) -> Optional[np.ndarray]:
        """Standard deviations of `positions` (time, vertex, 3) [m]; NaN where a vertex is held."""
        return self._get("sigma_positions")

    @property
    def sigma_velocities(self) -> Optional[np.ndarray]:
        """Standard deviations of `velocities` (time, vertex, 3) [m/s]; NaN where a vertex is held."""
        return self._get("sigma_velocities")

    @property
    def positions_background(self) -> Optional[np.ndarray]:
        """`positions` of the run from the background [m]."""
        return self._get("positions_background")

    @property
    def positions_truth(self) -> Optional[np.ndarray]:
        """`positions` of the truth [m]; None where it is not known."""
        return self._get("positions_truth")

    @property
    def velocities_background(self) -> Optional[np.ndarray]:
        """`velocities` of the run from the background [m/s]."""
        return self._get("velocities_background")

    @property
    def velocities_truth(self) -> Optional[np.ndarray]:
        """`velocities` of the truth [m/s]; None where it is not known."""
        return self._get("velocities_truth")

    @property
    def state_background(self) -> Optional[np.ndarray]:
        """`state` of the run from the background."""
        return self._get("state_background")

    @property
    def state_truth(self) -> Optional[np.ndarray]:
        """`state` of the truth; None where it is not known."""
        return self._get("state_truth")

    @cached_property
    def observations(self) -> Optional[np.ndarray]:
        """Everything that was seen, one row a value: a structured array with time [s], label, axis, value,
        sigma, background and analysis (H of the two runs), sigma_analysis, used, reason."""
        seen = self._arrays.get("observations")
        if seen is None:
            return None
        columns = {name: np.asarray(column) for name, column in seen.items()}
        rows = len(columns["value"])
        kinds = [(name, column.dtype if rows else float) for name, column in columns.items()]
        out = np.empty(rows, dtype=kinds)
        for name, column in columns.items():
            out[name] = column
        return out

    @cached_property
    def estimates(self) -> List[Dict[str, Any]]:
        """Constants that were estimated, with prior, value and σ in their units."""
        if self._recording is not None:
            return self.summary["estimates"]
        return json.loads(self._outcome.estimates())

    @cached_property
    def cycles(self) -> List[Dict[str, Any]]:
        """The windows of a sequence, in turn; empty for one window."""
        return json.loads(self._outcome.cycles())

    @cached_property
    def recordings(self) -> Dict[str, "Result"]:
        """The results of several recordings, by name; empty for one window."""
        if self._recording is not None:
            return {}
        return {name: Result(self._outcome, at, name) for name, at in self._outcome.recordings()}

    @cached_property
    def report_html(self) -> str:
        """The page that `varda run` writes, whole in one file."""
        return self._read(os.path.join(self._name, "report.html"))

    def write(self, folder: Union[str, "os.PathLike[str]"]) -> Path:
        """Writes the folder that `varda run` writes, whole or not at all: summary.json, tables, figures,
        report.html. An earlier result there is replaced."""
        self._outcome.write(os.fspath(folder))
        return Path(folder)

    def to_xarray(self) -> "xarray.Dataset":
        """The arrays over time as a Dataset, with units and long names; needs xarray. The analysis and its
        background at the start of the window have the dimension `control`."""
        dataset = self._dataset()
        long_names = {
            "analysis": "analysis at the start of the window",
            "background": "background at the start of the window",
            "truth": "truth at the start of the window",
            "sigma_analysis": "standard deviation of the analysis at the start of the window",
            "sigma_background": "standard deviation of the background at the start of the window",
        }
        for name, long_name in long_names.items():
            values = self._get(name)
            if values is not None:
                dataset[name] = (("control",), values, {"long_name": long_name})
                dataset = dataset.assign_coords(
                    control=("control", self.names), unit=("control", self.units)
                )
        dataset.attrs.update(title=self.summary["scene"], verdict=self.verdict, status=self.status)
        return dataset

    def _read(self, name: str) -> str:
        """A file of the folder that `write` writes."""
        with tempfile.TemporaryDirectory() as folder:
            path = self.write(os.path.join(folder, "result"))
            return (path / name).read_text(encoding="utf-8")

    def _repr_html_(self) -> str:
        page = html.escape(self.report_html, quote=True)
        return (
            '<iframe sandbox="allow-scripts" style="width:100%;height:720px;border:0" '
            f'title="report of {html.escape(self.summary["scene"], quote=True)}" srcdoc="{page}"></iframe>'
        )

    def __repr__(self) -> str:
        return f"<varda Result of {self.summary['scene']!r}: {self.verdict}, {self.status}>"


class Simulation(_Arrays):
    """The result of `simulate`: a forward run."""

    def __init__(self, simulation: Any) -> None:
        self._simulation = simulation
        self._arrays = simulation.arrays()

    @property
    def of(self) -> str:
        """Where the run started: "truth" or "background"."""
        return self._simulation.of

    @property
    def warnings(self) -> List[str]:
        """Remarks for the user."""
        return self._simulation.warnings

    def write(self, folder: Union[str, "os.PathLike[str]"]) -> Path:
        """Writes the folder that `varda simulate` writes."""
        self._simulation.write(os.fspath(folder))
        return Path(folder)

    def to_xarray(self) -> "xarray.Dataset":
        """The run as a Dataset, with units and long names; needs xarray."""
        dataset = self._dataset()
        for name, (_, what, _unit) in _OVER_TIME.items():
            if name in dataset:
                dataset[name].attrs["long_name"] = f"{what} of the simulation"
        return dataset

    def __repr__(self) -> str:
        return f"<varda Simulation from the {self.of}: {len(self.time) - 1} steps>"


class Modes(NamedTuple):
    """Natural modes of a rod about its shape at rest, the lowest first."""

    frequency: np.ndarray
    """(mode,) [Hz]; NaN for a mode that grows."""
    arc_length: np.ndarray
    """(vertex,) [m]."""
    rest: np.ndarray
    """Places of the vertices at rest (vertex, 3) [m]."""
    shape: np.ndarray
    """φ (mode, vertex, 3) [kg^(-1/2)], Σ m |φ|² = 1."""
    unstable: int
    """Number of modes that grow: zero at a minimum of the potential energy."""
