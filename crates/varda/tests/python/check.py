"""Opens the files of a result and compares their numbers with its tables.

usage: check.py FOLDER MODEL, where MODEL is rod or components. Prints one line for each format.
"""

import csv
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

import numpy as np
import xarray as xr

# Tables and files have the same bits; the bound is that of a number in print.
TOLERANCE = 1e-12


def table(path):
    """The columns of a table, numbers as numbers and empty fields as NaN."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    number = lambda text: float(text) if text else np.nan
    columns = {}
    for name in rows[0]:
        try:
            columns[name] = np.array([number(row[name]) for row in rows])
        except ValueError:
            columns[name] = np.array([row[name] for row in rows])
    return columns


def same(what, found, expected):
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape, f"{what}: {found.shape} in place of {expected.shape}"
    if expected.dtype.kind in "OSUT":
        assert (found.astype(str) == expected.astype(str)).all(), what
        return
    assert (np.isnan(found) == np.isnan(expected)).all(), f"{what}: other numbers are missing"
    error = np.nanmax(np.abs(found - expected), initial=0.0)
    assert error <= TOLERANCE, f"{what}: off by {error}"


def vectors(columns, names, steps):
    """Three columns as an array of steps, vertices and axes."""
    return np.stack([columns[name].reshape(steps, -1) for name in names], axis=-1)


def netcdf(folder, model):
    data = xr.open_dataset(folder / "result.nc")
    assert data.attrs["Conventions"].startswith("CF-"), data.attrs
    assert {"scene", "seed", "version", "scene_toml"} <= set(data.attrs), data.attrs
    assert data.time.dtype == np.float64 and data.time.attrs["units"] == "s", data.time
    for name, array in data.data_vars.items():
        assert array.attrs["long_name"], name
    columns = table(folder / "trajectory.csv")
    steps = data.sizes["time"]
    same("time", data.time, columns["time_s"].reshape(steps, -1)[:, 0])
    if model == "rod":
        assert data.position.dims == ("time", "s", "component") and data.position.attrs["units"] == "m"
        same("s", data.s, columns["s_m"].reshape(steps, -1)[0])
        same("component", data.component, np.array(["x", "y", "z"]))
        of = {"position": "", "position_background": "b_", "position_truth": "truth_"}
        of = {name: [f"{axis}_{prefix}m" for axis in "xyz"] for name, prefix in of.items()}
        # a recording has no truth
        assert ("position_truth" in data) == ("x_truth_m" in columns)
        of = {name: names for name, names in of.items() if name in data}
        of["velocity"] = [f"v{axis}_m_s" for axis in "xyz"]
        # an ensemble has σ at the start of the window alone
        assert ("position_sigma" in data) == ("sigma_x_m" in columns)
        if "position_sigma" in data:
            of["position_sigma"] = [f"sigma_{axis}_m" for axis in "xyz"]
            of["velocity_sigma"] = [f"sigma_v{axis}_m_s" for axis in "xyz"]
        for name, names in of.items():
            same(name, data[name], vectors(columns, names, steps))
        # forces are those after a step; one shape has none
        assert ("tension" in data) == (steps > 1)
        if "tension" in data:
            forces = table(folder / "forces.csv")
            assert ("tension_sigma" in data) == ("sigma_tension_n" in forces)
            for name, column in [("tension", "tension_n"), ("tension_sigma", "sigma_tension_n")]:
                if name not in data:
                    continue
                same(name, data[name][1:], forces[column].reshape(steps - 1, -1))
            assert np.isnan(data.tension[0]).all() and data.tension.attrs["units"] == "N"
        # a place and a time are found by their values
        middle = data.position.sel(s=float(data.s[-1]) / 2, time=float(data.time[-1]), method="nearest")
        assert middle.shape == (3,)
    else:
        for name, column in [("state", "x_a"), ("state_background", "x_b"), ("state_truth", "truth"),
                             ("state_sigma", "sigma_a")]:
            assert (name in data) == (column in columns), name
            if name not in data:
                continue
            same(name, data[name], columns[column].reshape(steps, -1))
        same("component", data.component, columns["component"].reshape(steps, -1)[0])
    seen = table(folder / "observations.csv")
    for name, column in [("time", "time_s"), ("value", "y"), ("analysis", "h_analysis"),
                         ("sigma", "sigma_y"), ("marker", "marker")]:
        same(f"obs_{name}", data[f"obs_{name}"], seen[column])
    assert set(data.obs_value.coords) == {"obs_time", "obs_marker", "obs_axis"}, data.obs_value.coords
    if "constant_value" in data:
        constants = table(folder / "estimates.csv")
        same("constant", data.constant, constants["name"])
        for name in ["prior", "prior_sigma", "value", "sigma", "low_95", "high_95"]:
            same(f"constant_{name}", data[f"constant_{name}"], constants[name])
    if "model_error" in data:
        errors = table(folder / "model_error.csv")
        same("model_error", data.model_error.values.ravel(), errors["eta"])
        same("model_error_sigma", data.model_error_sigma.values.ravel(), errors["sigma_eta"])
    if "member" in data:
        members(data, model)
    control = table(folder / "analysis.csv")
    same("control", data.control, control["name"])
    same("control_analysis", data.control_analysis, control["x_a"])
    print(f"netcdf: {len(data.variables)} variables")
    return data


def members(data, model):
    """Members of the analysis: mean and spread at the start, places that are held, and a run of one."""
    assert data.member.attrs["standard_name"] == "realization" and data.member.dtype == np.int32, data.member
    same("member", data.member, np.arange(data.sizes["member"]))
    same("member_time", data.member_time, data.time)
    name = "position" if model == "rod" else "state"
    of_all = data[f"{name}_members"]
    assert of_all.dims == ("member", "member_time") + data[name].dims[1:], of_all.dims
    start = of_all.isel(member_time=0)
    # members are x_a + what sums to nothing
    assert np.allclose(start.mean("member"), data[name].isel(time=0), rtol=0, atol=1e-10)
    if model == "rod":
        held = of_all.isel(s=0)
        assert np.abs(held - held.isel(member=0)).max() == 0.0, "the clamp is where it is"
        assert float(of_all.isel(s=-1).std("member").min()) > 0.0
        return
    if "localization_length" not in data.attrs["scene_toml"]:
        # without localization the symmetric square root has the covariance of the analysis
        spread = start.std("member", ddof=1)
        assert np.allclose(spread, data.control_sigma_analysis, rtol=1e-9), abs(spread - data.control_sigma_analysis).max()
    x, step = start.isel(member=3).values, float(data.time[1] - data.time[0])
    rate = lambda x: (np.roll(x, -1) - np.roll(x, 2)) * np.roll(x, 1) - x + 8.0
    for now in range(1, data.sizes["time"]):
        k1 = rate(x)
        k2 = rate(x + 0.5 * step * k1)
        k3 = rate(x + 0.5 * step * k2)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + step * k3))
        # eight steps amplify rounding less than tenfold
        assert np.allclose(of_all.isel(member=3, member_time=now), x, rtol=0, atol=1e-11), now


def npz(folder, data):
    arrays = np.load(folder / "result.npz")
    assert set(arrays.files) == set(data.variables) | {"about"}, set(arrays.files) ^ set(data.variables)
    for name in data.variables:
        same(name, arrays[name], data[name].values)
    print(f"npz: {len(arrays.files)} arrays")


def vtk(folder, data):
    import meshio

    steps = xml.parse(folder / "result.pvd").getroot().findall("Collection/DataSet")
    same("times of the collection", [float(step.get("timestep")) for step in steps], data.time)
    for number in {0, len(steps) // 2, len(steps) - 1}:
        grid = meshio.read(folder / steps[number].get("file"))
        now = data.isel(time=number)
        same("points", grid.points, now.position)
        same("lines", grid.cells_dict["line"], np.stack([np.arange(now.sizes["s_edge"])] * 2, 1) + [0, 1])
        if "position_sigma" in data:
            same("position_sigma", grid.point_data["position_sigma"], now.position_sigma)
        same("velocity", grid.point_data["velocity"], now.velocity)
        same("speed", grid.point_data["speed"].ravel(), np.sqrt((now.velocity**2).sum("component", skipna=False)))
        moved = now.position - now.position_background
        same("displacement", grid.point_data["displacement_from_background"], moved)
        if "tension" in data:
            same("tension", grid.cell_data["tension"][0].ravel(), now.tension)
        # 2 tan(φ/2) over half of both edges; next to a clamp's face the vertex has more of the first edge
        tangents = np.diff(grid.points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        across = np.linalg.norm(np.cross(tangents[:-1], tangents[1:]), axis=1)
        angles = np.arctan2(across, np.sum(tangents[:-1] * tangents[1:], axis=1))
        arcs = data.s.values
        bent = 2 * np.tan(angles / 2) / (0.5 * (arcs[2:] - arcs[:-2]))
        curvature = grid.point_data["curvature"].ravel()
        assert np.isnan(curvature[[0, -1]]).all() and not np.isnan(curvature[1:-1]).any(), curvature
        # arc lengths are sums of lengths, which round
        assert np.allclose(curvature[2:-2], bent[1:-1], rtol=1e-10, atol=1e-12), np.abs(curvature[2:-2] - bent[1:-1]).max()
        assert np.abs(curvature[1:-1]).max() > 1e-3, "the rod is bent"
        same("curvature of NetCDF", now.curvature, curvature[1:-1])
        if "twist_rate" in data:
            same("twist_rate", grid.point_data["twist_rate"].ravel()[1:-1], now.twist_rate)
        same("TimeValue", np.ravel(grid.field_data["TimeValue"]), [float(data.time[number])])
    print(f"vtk: {len(steps)} steps")


if __name__ == "__main__":
    folder, model = Path(sys.argv[1]), sys.argv[2]
    data = netcdf(folder, model)
    npz(folder, data)
    if model == "rod":
        vtk(folder, data)
