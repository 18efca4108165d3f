"""Models written in NumPy."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from lorenz96 import Lorenz96, seen

import varda_da as varda


@pytest.fixture(scope="module")
def scene():
    return varda.run("lorenz96", algorithm__minimizer="trust-region", algorithm__gradient_tolerance=1e-12)


def test_a_model_in_numpy_gives_the_analysis_of_the_scene(scene):
    started = time.perf_counter()
    analysis = varda.assimilate(
        Lorenz96(), scene.background, scene.sigma_background, seen(scene), gradient_tolerance=1e-12
    )
    print(f"Lorenz-96 in NumPy: {1e3 * (time.perf_counter() - started):.0f} ms")
    assert analysis.converged
    # both ends are within ‖∇J‖ of the minimum, 1e-12 of some hundred
    assert np.max(np.abs(analysis.state - scene.analysis)) < 1e-10
    assert np.max(np.abs(analysis.sigma - scene.sigma_analysis)) < 1e-10
    assert analysis.J == pytest.approx(scene.summary["j_analysis"], rel=1e-12)
    assert analysis.terms[0] + analysis.terms[1] == pytest.approx(analysis.J, rel=1e-14)
    assert np.allclose(analysis.trajectory, scene.state[: len(analysis.trajectory)], rtol=0, atol=1e-9)
    assert analysis.degrees_of_freedom == pytest.approx(scene.summary["degrees_of_freedom"], rel=1e-9)
    assert analysis.history[0, 0] == pytest.approx(scene.summary["j_background"], rel=1e-12)


@pytest.mark.parametrize("method", ["4dvar-incremental", "4d-psas"])
def test_other_methods_find_the_same_minimum(scene, method):
    analysis = varda.assimilate(
        Lorenz96(), scene.background, 1.0, seen(scene), method=method, gradient_tolerance=1e-8
    )
    # ‖∇J‖ 1e-8 of some hundred, and σ of at most 1
    assert np.max(np.abs(analysis.state - scene.analysis)) < 1e-5


def test_minimizers_by_name(scene):
    for minimizer in ("gauss-newton-cg", "lbfgs"):
        analysis = varda.assimilate(
            Lorenz96(), scene.background, 1.0, seen(scene), minimizer=minimizer, posterior=False,
            max_iterations=300,
        )
        assert analysis.converged and np.max(np.abs(analysis.state - scene.analysis)) < 1e-2
        assert analysis.sigma is None
    with pytest.raises(varda.AssimilationError, match="'steepest' is none of auto, trust-region".replace("'", '"')):
        varda.assimilate(Lorenz96(), scene.background, 1.0, seen(scene), minimizer="steepest")


def test_an_ensemble_needs_steps_alone(scene):
    class Steps:
        step = Lorenz96().step

    analysis = varda.assimilate(
        Steps(), scene.background, 1.0, seen(scene), method="4denvar", members=200, max_iterations=20, seed=1
    )
    before, after = (np.linalg.norm(x - scene.truth) for x in (scene.background, analysis.state))
    assert after < 0.6 * before and analysis.sigma.shape == (40,)
    i = np.arange(40)
    distance = np.minimum(abs(i[:, None] - i), 40 - abs(i[:, None] - i))
    taper = np.exp(-0.5 * (distance / 4.0) ** 2)
    few = varda.assimilate(
        Steps(), scene.background, 1.0, seen(scene), method="4denvar", members=20, localization=taper
    )
    assert np.linalg.norm(few.state - scene.truth) < 0.8 * before


def test_one_instant_is_the_closed_form():
    # BLUE: x_a = x_b + BHᵀ (HBHᵀ + R)⁻¹ (y − H x_b)
    rng = np.random.default_rng(4)
    n, m = 6, 3
    root = rng.normal(size=(n, n))
    b, h, x_b, y = root @ root.T + np.eye(n), rng.normal(size=(m, n)), rng.normal(size=n), rng.normal(size=m)
    sigma = np.array([0.1, 0.2, 0.3])
    gain = b @ h.T @ np.linalg.inv(h @ b @ h.T + np.diag(sigma**2))
    analysis = varda.assimilate(
        None, x_b, b, [(0, h, y, sigma)], method="3dvar", gradient_tolerance=1e-12
    )
    assert np.allclose(analysis.state, x_b + gain @ (y - h @ x_b), rtol=0, atol=1e-10)
    p = b - gain @ h @ b
    assert np.allclose(analysis.covariance, p, rtol=0, atol=1e-10)
    assert np.allclose(analysis.sigma, np.sqrt(np.diag(p)), rtol=0, atol=1e-10)
    draws = analysis.draws(4000, seed=2)
    assert np.array_equal(draws, analysis.draws(4000, seed=2))
    # a variance of 4000 draws is known to √(2/4000) = 2.2 %: six times that
    assert np.allclose(draws.var(axis=0), np.diag(p), rtol=0.13)


def test_a_sparse_matrix_observes_too(scene):
    sparse = pytest.importorskip("scipy.sparse")
    one = [(4, sparse.csr_array(np.eye(40)[:3]), [1.0, 2.0, 3.0], 0.4)]
    other = [(4, [0, 1, 2], [1.0, 2.0, 3.0], 0.4)]
    states = [varda.assimilate(Lorenz96(), scene.background, 1.0, seen).state for seen in (one, other)]
    assert np.allclose(*states, rtol=0, atol=1e-12)


def test_a_check_finds_a_wrong_adjoint_and_a_wrong_tangent():
    x = 8.0 + np.sin(np.arange(12.0))
    report = varda.check_model(Lorenz96(), x)
    assert report.passed, str(report)

    class WrongAdjoint(Lorenz96):
        def adjoint(self, k, x, dy):
            return super().adjoint(k, x, dy) + 1e-6 * np.roll(dy, 1)

    class WrongTangent(Lorenz96):
        def tangent(self, k, x, dx):
            return super().tangent(k, x, dx) + 1e-3 * dx

        def adjoint(self, k, x, dy):
            return super().adjoint(k, x, dy) + 1e-3 * dy

    for wrong in (WrongAdjoint(), WrongTangent()):
        report = varda.check_model(wrong, x)
        assert not report.passed and "FAIL" in str(report)


class Broken(Lorenz96):
    def __init__(self, name, at):
        super().__init__()
        self.name, self.at, self.calls = name, at, 0

    def count(self, name):
        self.calls += name == self.name
        if self.calls == self.at:
            raise ZeroDivisionError(f"{name} broke")

    def step(self, k, x):
        self.count("step")
        return super().step(k, x)

    def tangent(self, k, x, dx):
        self.count("tangent")
        return super().tangent(k, x, dx)

    def adjoint(self, k, x, dy):
        self.count("adjoint")
        return super().adjoint(k, x, dy)


@pytest.mark.parametrize("name, at", [("step", 1), ("step", 40), ("tangent", 1), ("tangent", 40), ("adjoint", 9)])
@pytest.mark.parametrize("method", ["4dvar", "4d-psas"])
def test_exceptions_of_the_model_come_out_as_themselves(scene, name, at, method):
    model = Broken(name, at)
    if method == "4d-psas" and name == "tangent" and at > 1:
        at = model.at = 20
    with pytest.raises(ZeroDivisionError, match=f"{name} broke"):
        varda.assimilate(model, scene.background, 1.0, seen(scene), method=method)


def test_exceptions_in_an_ensemble(scene):
    with pytest.raises(ZeroDivisionError, match="step broke"):
        varda.assimilate(Broken("step", 100), scene.background, 1.0, seen(scene), method="4denvar")


def test_a_step_that_cannot_be_taken_is_refused(scene):
    class Bounded(Lorenz96):
        def step(self, k, x):
            return super().step(k, x) if np.max(np.abs(x)) < 1.0 else np.full_like(x, np.nan)

    with pytest.raises(varda.VardaError, match="step 0: x_{k\\+1} is not finite"):
        varda.assimilate(Bounded(), scene.background, 1.0, seen(scene))


@pytest.mark.parametrize(
    "text, change",
    [
        ("covariance of shape (3,)", {"covariance": [1.0, 1.0, 1.0]}),
        ("components are integers from 0 to 39", {"observations": [(1, [40], [1.0], 0.1)]}),
        ("H of shape (2, 40) for 1 values", {"observations": [(1, np.ones((2, 40)), [1.0], 0.1)]}),
        ("2 standard deviations for 1 values", {"observations": [(1, [0], [1.0], [0.1, 0.2])]}),
        ("is not positive and finite", {"observations": [(1, [0], [1.0], -0.1)]}),
        ("the value NaN is not finite", {"observations": [(1, [0], [float("nan")], 0.1)]}),
        ("is outside the window", {"observations": [(5, [0], [1.0], 0.1)], "steps": 3}),
        ("none of 4dvar", {"method": "5dvar"}),
        ("step 0 only", {"method": "3dvar", "observations": [(1, [0], [1.0], 0.1)]}),
        ("background of shape (2, 2)", {"background": np.ones((2, 2))}),
        ("not symmetric", {"covariance": np.triu(np.ones((40, 40)))}),
    ],
)
def test_what_does_not_fit_together_is_refused(text, change):
    asked = {"background": np.ones(40), "covariance": 1.0, "observations": [(1, [0], [1.0], 0.1)], **change}
    with pytest.raises(varda.AssimilationError) as raised:
        varda.assimilate(Lorenz96(), **asked)
    assert text in str(raised.value)


def test_a_step_of_the_wrong_length():
    class Short(Lorenz96):
        def step(self, k, x):
            return x[:-1]

    with pytest.raises(ValueError, match="step\\(0, …\\) has 39 numbers, a state 40"):
        varda.assimilate(Short(), np.ones(40), 1.0, [(1, [0], [1.0], 0.1)])


@pytest.mark.parametrize("method", ["4dvar", "4denvar"])
@pytest.mark.parametrize("call", ["assimilate", "cycle"])
def test_ctrl_c_in_a_model(call, method):
    program = (
        "import signal, time, numpy as np, varda_da as varda\n"
        # a shell may start its background jobs with the signal ignored
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Slow:\n"
        "    def step(self, k, x): time.sleep(0.01); return x\n"
        "    def tangent(self, k, x, dx): return dx\n"
        "    adjoint = tangent\n"
        "print('begins', flush=True)\n"
        f"varda.{call}(Slow(), np.ones(4), 1.0, [(5000, [0], [1.0], 0.1)],"
        f" method={method!r}{', window=5000' if call == 'cycle' else ''})\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "begins\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert "KeyboardInterrupt" in err and process.returncode != 0
