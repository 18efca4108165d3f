"""Scenes from Python: the numbers of the command line, errors, results in a notebook."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import varda_da as varda

#: The command line, built by `check.sh`.
BINARY = os.environ.get("VARDA_BINARY")
#: Keys of summary.json that are measured and not computed.
MEASURED = {"seconds", "peak_bytes"}

needs_binary = pytest.mark.skipif(BINARY is None, reason="VARDA_BINARY is not set")


def of_binary(folder, *arguments):
    command = [BINARY, "run", *arguments, "--quiet", "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return json.loads((folder / "summary.json").read_text())


def without_measured(value):
    if isinstance(value, dict):
        return {k: without_measured(v) for k, v in value.items() if k not in MEASURED}
    return [without_measured(v) for v in value] if isinstance(value, list) else value


@needs_binary
@pytest.mark.parametrize("scene", ["hanging-rod", "lorenz96"])
def test_the_bits_are_those_of_the_binary(scene, tmp_path):
    started = time.perf_counter()
    expected = of_binary(tmp_path / "binary", scene)
    middle = time.perf_counter()
    result = varda.run(scene, out=tmp_path / "python")
    ended = time.perf_counter()
    print(f"{scene}: {1e3 * (middle - started):.0f} ms by the binary, {1e3 * (ended - middle):.0f} ms from Python")
    assert without_measured(result.summary) == without_measured(expected)
    for table in ["analysis.csv", "trajectory.csv", "observations.csv"]:
        one, other = ((tmp_path / of / table).read_bytes() for of in ("binary", "python"))
        assert one == other, table
    # numbers in a table are the shortest that read back to the same bits
    rows = (tmp_path / "binary" / "analysis.csv").read_text().splitlines()[1:]
    assert [float(row.split(",")[4]) for row in rows] == result.analysis.tolist()
    assert [row.split(",")[1] for row in rows] == result.names


@needs_binary
def test_overrides_are_those_of_the_command_line(tmp_path):
    sets = ["--set", "observations.sigma=0.2", "--set", "time.window=12", "--seed", "3"]
    expected = of_binary(tmp_path / "binary", "lorenz96", *sets)
    by_key = varda.run("lorenz96", set={"observations.sigma": 0.2, "time": {"window": 12}}, seed=3)
    by_name = varda.run("lorenz96", observations__sigma=0.2, time__window=np.int64(12), seed=3)
    for result in (by_key, by_name):
        assert without_measured(result.summary) == without_measured(expected)


def test_a_rod_has_vertices_and_velocities():
    result = varda.run("hanging-rod", time__window=20)
    steps, vertices = len(result.time), len(result.arc_length)
    assert result.kind == "window" and result.status == "converged"
    for values in (
        result.positions,
        result.positions_background,
        result.positions_truth,
        result.velocities,
        result.sigma_positions,
    ):
        assert values.shape == (steps, vertices, 3)
    # the first edge is held; the others hang below one another
    assert np.isnan(result.velocities[:, :2]).all() and np.isfinite(result.velocities[:, 2:]).all()
    assert np.isfinite(result.positions).all() and (np.diff(result.positions[0, :, 2]) < 0).all()
    # a control is places and velocities of the free vertices
    free = result.positions[0, 2:].ravel()
    assert np.allclose(result.analysis[: free.size], free, rtol=0, atol=1e-14)
    assert result.units[0] == "m" and result.units[-1] == "m/s"
    assert (result.sigma_analysis < result.sigma_background).any()
    seen = result.observations
    assert set(seen["axis"]) == {"x", "y", "z"} and len(seen) == result.summary["n_obs"]
    assert np.std((seen["value"] - seen["analysis"]) / seen["sigma"]) < 1.5


def test_an_analysis_is_nearer_to_the_truth():
    result = varda.run("lorenz96")
    error = [np.sqrt(np.mean((x - result.truth) ** 2)) for x in (result.background, result.analysis)]
    assert error[1] < 0.5 * error[0] and error[1] == pytest.approx(result.summary["rmse"]["state_analysis"])
    assert np.array_equal(result.state[0], result.analysis)
    assert result.sigma.shape == result.state.shape


def test_a_scene_is_a_name_a_file_text_or_tables(tmp_path):
    text = varda.show("lorenz63")
    path = tmp_path / "mine.toml"
    path.write_text(text)
    results = [varda.run(scene) for scene in ("lorenz63", path, text)]
    tomllib = pytest.importorskip("tomllib")
    results.append(varda.run(tomllib.loads(text)))
    for result in results[1:]:
        assert np.array_equal(result.analysis, results[0].analysis)
    assert results[1].summary["scene"] == "mine"
    assert "lorenz63" in varda.scenes()


def test_estimates_are_dicts():
    result = varda.run("wire")
    assert result.estimates and {"name", "value", "sigma", "unit", "prior"} <= set(result.estimates[0])


def test_a_sequence_of_windows():
    result = varda.run("lorenz96-cycling-3dvar", algorithm__cycles={"count": 5, "spin_up": 1})
    assert result.kind == "cycles" and len(result.cycles) == 5
    assert result.state.shape == (len(result.time), 40)
    assert result.summary["cycles"]


def test_several_recordings():
    result = varda.run("wires")
    assert result.kind == "recordings" and len(result.recordings) > 1
    for name, one in result.recordings.items():
        assert one.summary["scene"] == name and one.positions.shape[2] == 3
        assert one.report_html.startswith("<!")
    with pytest.raises(AttributeError, match="recordings"):
        result.time


def test_a_report_in_a_notebook(tmp_path):
    result = varda.run("lorenz63")
    page = result._repr_html_()
    assert page.startswith('<iframe sandbox="allow-scripts"') and "allow-same-origin" not in page
    assert "&lt;/html&gt;" in page and "<script" not in page
    folder = result.write(tmp_path / "out")
    assert (folder / "report.html").read_text() == result.report_html
    with pytest.raises(varda.ResultError, match="is not a result of Varda"):
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "notes.txt").write_text("mine")
        result.write(tmp_path / "other")


def test_a_dataset_has_units():
    pytest.importorskip("xarray")
    result = varda.run("hanging-rod", time__window=20)
    dataset = result.to_xarray()
    assert dataset.positions.dims == ("time", "vertex", "axis") and dataset.positions.attrs["units"] == "m"
    assert dataset.time.attrs == {"long_name": "model time", "units": "s"}
    assert np.array_equal(dataset.analysis.values, result.analysis)
    assert all("long_name" in dataset[name].attrs for name in dataset)
    forward = varda.simulate("lorenz96").to_xarray()
    assert forward.state.dims == ("time", "component")


def test_a_simulation_and_modes():
    simulation = varda.simulate("hanging-rod", time__window=10)
    assert simulation.of == "truth" and simulation.positions.shape == (11, 26, 3)
    modes = varda.modes("hanging-rod", 4)
    assert modes.frequency.shape == (4,) and (np.diff(modes.frequency) >= 0).all() and modes.unstable == 0
    assert modes.shape.shape == (4, 26, 3) and modes.rest.shape == (26, 3)


def test_findings():
    assert varda.check("lorenz96") == []
    finding = varda.check("lorenz96", observations__sigma=100.0)[0]
    assert finding.place == "observations.sigma" and finding.severity in ("warning", "error")


@pytest.mark.parametrize(
    "kind, text, call",
    [
        (varda.SceneError, "did you mean \"lorenz63\"", lambda: varda.run("lorenz69")),
        (varda.SceneError, "--set observations.sigma=-1", lambda: varda.run("lorenz96", observations__sigma=-1)),
        (varda.SceneError, "scene:2:", lambda: varda.run("seed = 0\nmodell = 3\n")),
        (varda.SceneError, "finite", lambda: varda.run("lorenz96", observations__sigma=float("nan"))),
        (varda.SceneError, "no scene", lambda: varda.show("nothing")),
        (varda.SceneError, "rod", lambda: varda.modes("lorenz96")),
        (varda.DataError, "nowhere.csv", lambda: varda.run("hose", observations__file="nowhere.csv")),
        (TypeError, "object", lambda: varda.run("lorenz96", seed=object())),
    ],
)
def test_errors_are_typed_and_say_what_the_command_line_says(kind, text, call):
    with pytest.raises(kind, match=None) as raised:
        call()
    assert text in str(raised.value)


@needs_binary
def test_the_text_of_an_error_is_that_of_the_binary():
    command = [BINARY, "run", "lorenz96", "--set", "time.window=-4"]
    said = subprocess.run(command, capture_output=True, text=True).stderr
    with pytest.raises(varda.VardaError) as raised:
        varda.run("lorenz96", time__window=-4)
    assert said == f"error: {raised.value}\n"


LONG = {"model.segments": 160, "time.window": 4000, "algorithm.minimizer": "trust-region"}


def test_ctrl_c_ends_a_run():
    program = (
        "import signal, varda_da as varda\n"
        # a shell may start its background jobs with the signal ignored
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"print('begins', flush=True)\nvarda.run('hanging-rod', set={LONG!r})\nprint('ends', flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "begins\n"
    time.sleep(1.0)
    assert process.poll() is None, "the run is too short for this test"
    sent = time.perf_counter()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    seconds = time.perf_counter() - sent
    print(f"KeyboardInterrupt {1e3 * seconds:.0f} ms after the signal")
    # 50 ms to hear it, 250 ms of patience, the end of the interpreter; setting up alone takes longer than this
    assert seconds < 5.0
    assert "KeyboardInterrupt" in err and out == "" and process.returncode != 0


def test_other_threads_go_on():
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.005):
            ticks.append(time.perf_counter())

    thread = threading.Thread(target=tick)
    thread.start()
    started = time.perf_counter()
    varda.run("hanging-rod")
    seconds = time.perf_counter() - started
    done.set()
    thread.join()
    # with the lock held there would be hardly a tick
    assert len(ticks) > 0.1 * seconds / 0.005


def test_documented_examples():
    import doctest

    import varda_da._scene

    assert doctest.testmod(varda_da._scene, extraglobs={"run": varda.run}).failed == 0
    assert Path(varda.__file__).with_name("py.typed").exists()
