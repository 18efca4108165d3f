"""Window after window: each sequence beside the scene of the same problem."""

import numpy as np
import pytest
from lorenz96 import Lorenz96, seen

import varda_da as varda

#: Some windows, each within ‖∇J‖ of its minimum, errors growing between them by the model's factor of 2 or so.
SAME = 1e-10


class Steps:
    """A model without derivatives."""

    step = Lorenz96(0.05).step


COUNT = 6

#: Everything is observed at every step.
TEXT = (
    varda.show("lorenz96-cycling-4dvar")
    .split("[algorithm]")[0]
    .replace('kind = "climatology", scale = 0.02', 'kind = "diagonal", sigma = 0.5')
)


def scene_of(algorithm, cycles, window=4, error=None, seed=2):
    """Some windows of Lorenz-96."""
    iterated = {} if "4denvar" in algorithm["method"] else {"gradient_tolerance": 1e-12}
    if algorithm["method"] in ("4dvar", "weak-forcing", "3dvar"):
        iterated["minimizer"] = "trust-region"
    errors = {} if error is None else {"model_error": error}
    settings = {**algorithm, **iterated, **errors, "cycles": {"count": COUNT, **cycles}}
    text = TEXT if window else TEXT.replace("every = 1", "steps = [0]")
    return varda.run(text, seed=seed, time__window=window, algorithm=settings)


def observed(steps, seed=2, text=None):
    """What it observes: a sequence is cut out of one long window."""
    text = (text or TEXT).replace("window = 8", f"window = {steps}")
    return seen(varda.run(text, seed=seed, algorithm={"method": "4dvar", "max_iterations": 1}))


def cycle_of(scene, model=None, window=4, **keys):
    """The same in NumPy."""
    steps = len(scene.time) - 1
    text = TEXT if window else TEXT.replace("every = 1", f"steps = {list(range(steps + 1))}")
    background = np.array(scene.cycles[0]["background"])
    return varda.cycle(
        model or Lorenz96(0.05), background, 0.5, observed(steps, text=text), window=window,
        count=COUNT, gradient_tolerance=1e-12, max_iterations=1000, seed=2, **keys,
    )


def same(run, scene, bound=SAME):
    """The windows of both: analyses, costs, how they ended."""
    assert len(run) == len(scene.cycles) == COUNT
    for window, row in zip(run, scene.cycles):
        assert (window.index, window.first_step, window.status) == (row["cycle"], row["first_step"], row["status"])
        assert np.max(np.abs(window.background - row["background"])) < bound
        assert np.max(np.abs(window.analysis - row["analysis"])) < bound
        assert window.J == pytest.approx(row["j"], rel=bound)
        assert window.chi2 == pytest.approx(row["chi2"], rel=bound)
        if window.sigma is not None:
            assert np.sqrt(np.mean(window.sigma**2)) == pytest.approx(row["spread"][0], rel=bound)
    steps = len(run.trajectory)
    assert np.max(np.abs(run.trajectory - scene.state[:steps])) < 10 * bound and steps == len(scene.state)


@pytest.mark.parametrize("window, shift", [(4, 4), (4, 2), (4, 5), (0, 1)])
def test_a_static_b(window, shift):
    method = "4dvar" if window else "3dvar"
    scene = scene_of({"method": method}, {"shift": shift}, window)
    run = cycle_of(scene, method=method, window=window, shift=shift)
    same(run, scene)
    assert run.sigma is None and run.members is None
    error = np.sqrt(np.mean((run.end[2:] - scene.state_truth[run.first_step[2:] + window]) ** 2))
    assert error < (0.5 if window else 0.6)  # 0.5: σ of B


@pytest.mark.parametrize("method", ["4dvar", "4d-psas"])
def test_a_propagated_posterior(method):
    carried = {"covariance": "propagated", "inflation": 1.1, "static_weight": 0.3, "dropped_variance": 1e-6}
    scene = scene_of({"method": method}, carried)
    run = cycle_of(
        scene, method=method, carry="propagated", inflation=1.1, static_weight=0.3, dropped_variance=1e-6
    )
    # an eigenvalue that ends the columns kept is the same to rounding only: share 1e-6 of a variance
    same(run, scene, 1e-8)
    assert run.sigma.shape == (COUNT, 40) and run.members.shape[1] == 40


@pytest.mark.parametrize(
    "method, estimated", [("weak-forcing", True), ("weak-state", True), ("4dvar", False)]
)
def test_a_model_that_errs(method, estimated):
    carried = {"covariance": "propagated", "dropped_variance": 0.0}
    error = {"covariance": {"kind": "diagonal", "sigma": 0.05}, "every": 2}
    scene = scene_of({"method": method}, carried, error=error)
    run = cycle_of(
        scene, method=method, carry="propagated", dropped_variance=0.0, model_error=varda.Forcing(0.05, every=2)
    )
    same(run, scene)
    if estimated:
        assert all(w.model_errors.shape == (2, 40) for w in run)
        found = [row["model_errors"] for row in scene.cycles]
        assert np.max(np.abs([w.model_errors.ravel() for w in run] - np.array(found))) < SAME
        assert all(w.terms.model_error > 0.0 for w in run)
    else:
        assert run[0].model_errors is None


ENSEMBLES = [
    ("4denvar", {"inflation": 1.05}, {}),
    ("4denvar", {}, {"inflation": "adaptive", "rotation": True, "spread": 0.1}),
    ("4denvar", {"localization_length": 20.0, "inflation": 1.05}, {"update": "perturbed-observations", "shift": 2}),
    ("hybrid-4denvar", {"inflation": 1.05, "static_weight": 0.5, "ensemble_weight": 0.8}, {}),
]


@pytest.mark.parametrize("method, ensemble, cycles", ENSEMBLES)
def test_an_ensemble(method, ensemble, cycles):
    from test_methods import taper

    scene = scene_of({"method": method, "ensemble": {"members": 40, **ensemble}}, cycles)
    keys = {**cycles, "inflation": cycles.get("inflation", ensemble.get("inflation"))}
    if "static_weight" in ensemble:
        keys["weights"] = [ensemble["static_weight"], ensemble["ensemble_weight"]]
    local = taper(ensemble["localization_length"]) if "localization_length" in ensemble else None
    run = cycle_of(scene, Steps(), method=method, localization=local, **keys)
    # the lowest point of a function of one number is known to the root of its rounding, 1e-8
    same(run, scene, 1e-6 if keys["inflation"] == "adaptive" else SAME)
    assert run.members.shape == (40, 40)
    error = np.sqrt(np.mean((run.end - scene.state_truth[run.first_step + 4]) ** 2))
    assert error < 0.5


def test_a_sequence_goes_on_with_the_same_bits():
    x, seen = 8.0 + np.sin(np.arange(40.0)), observed(24)
    asked = dict(window=4, count=6, method="4denvar", members=20, rotation=True, seed=5)
    whole = varda.cycle(Steps(), x, 0.5, seen, **asked)
    heard = []
    first = varda.cycle(
        Steps(), x, 0.5, seen, on_window=lambda w: heard.append(w) or w.index == 2, **asked
    )
    rest = varda.cycle(Steps(), x, 0.5, seen, state=first.state, **asked)
    assert [w.index for w in heard] == [0, 1, 2] and [w.index for w in rest] == [3, 4, 5]
    assert np.array_equal(np.concatenate([first.analysis, rest.analysis]), whole.analysis)
    assert np.array_equal(rest.members, whole.members)


def test_windows_reach_the_last_observation():
    class Still:
        def step(self, k, x):
            return x

        def tangent(self, k, x, dx):
            return dx

        adjoint = tangent

    def windows(last, **keys):
        return len(varda.cycle(Still(), [0.0], 1.0, [(last, [0], [1.0], 0.5)], **keys))

    assert [windows(last, window=4) for last in (0, 4, 5, 8, 9)] == [1, 1, 2, 2, 3]
    assert [windows(last, window=4, shift=2) for last in (4, 5, 7)] == [1, 2, 3]
    assert [windows(last, window=0, shift=3) for last in (0, 3, 6)] == [1, 2, 3]
    with pytest.warns(UserWarning, match="1 observed values are in no window"):
        windows(4, window=0, shift=3)


def test_steps_are_counted_from_the_start_of_the_sequence():
    steps = []

    class Counted(Lorenz96):
        def step(self, k, x):
            steps.append(k)
            return super().step(k, x)

    x = 8.0 + np.sin(np.arange(40.0))
    run = varda.cycle(Counted(0.05), x, 0.5, [(8, [0], [8.0], 0.5)], window=4)
    assert set(steps) == set(range(8)) and len(run) == 2


def test_exceptions_come_out_as_themselves():
    class Broken(Steps):
        def step(self, k, x):
            if k >= 4:
                raise ZeroDivisionError("step broke")
            return Lorenz96(0.05).step(k, x)

        tangent, adjoint = Lorenz96(0.05).tangent, Lorenz96(0.05).adjoint

    x = 8.0 + np.sin(np.arange(40.0))
    observations = [(k, [0], [8.0], 0.5) for k in range(9)]
    for method in ("4dvar", "4denvar"):
        heard = []
        with pytest.raises(ZeroDivisionError, match="step broke"):
            varda.cycle(
                Broken(), x, 0.5, observations, window=4, method=method, on_window=lambda w: heard.append(w)
            )
        assert len(heard) == 1


@pytest.mark.parametrize(
    "text, change",
    [
        ("windows of 4 steps, 6 apart", {"shift": 6}),
        ("does not go with method", {"carry": "ensemble"}),
        ("does not go with method", {"carry": "propagated", "method": "4denvar"}),
        ('inflation "adaptive" is that of an ensemble', {"inflation": "adaptive"}),
        ("a number or", {"inflation": "much"}),
        ("square-root or", {"update": "none"}),
        ("inflation", {"method": "4denvar", "inflation": -1.0}),
        ("Q beside a static B", {"model_error": 0.1}),
    ],
)
def test_what_does_not_fit_together_is_refused(text, change):
    with pytest.raises(varda.AssimilationError) as raised:
        varda.cycle(Lorenz96(0.05), np.ones(40), 1.0, [(4, [0], [1.0], 0.1)], **{"window": 4, **change})
    assert text in str(raised.value)
