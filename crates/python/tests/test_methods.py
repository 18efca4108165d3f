"""Weak constraints, hybrids, models of several vectors at once: each beside the scene of the same problem."""

import numpy as np
import pytest
from lorenz96 import Lorenz96, seen

import varda_da as varda

#: Both ends are within ‖∇J‖ of the minimum: 1e-12 of some hundred.
SAME = 1e-10


class OneByOne(Lorenz96):
    batched = False


class Steps:
    """A model without derivatives."""

    step = Lorenz96().step


def scene_of(**keys):
    return varda.run("lorenz96", time__window=8, algorithm__gradient_tolerance=1e-12, **keys)


@pytest.fixture(scope="module")
def strong():
    return scene_of(algorithm__minimizer="trust-region")


def taper(length, n=40):
    """Gaspari and Cohn's function of the distance on a ring, zero from `length` on."""
    i = np.arange(n)
    distance = np.minimum(abs(i[:, None] - i), n - abs(i[:, None] - i))
    z = distance / (0.5 * length)
    near = -(z**5) / 4 + z**4 / 2 + 5 * z**3 / 8 - 5 * z**2 / 3 + 1
    with np.errstate(divide="ignore"):
        far = z**5 / 12 - z**4 / 2 + 5 * z**3 / 8 + 5 * z**2 / 3 - 5 * z + 4 - 2 / (3 * z)
    return np.where(z <= 1, near, np.where(z < 2, far, 0.0))


def test_several_vectors_at_once_are_the_same_numbers(strong):
    one, many = (
        varda.assimilate(model, strong.background, 1.0, seen(strong), gradient_tolerance=1e-12)
        for model in (OneByOne(), Lorenz96())
    )
    # the same arithmetic, entry by entry
    assert np.array_equal(one.state, many.state) and np.array_equal(one.sigma, many.sigma)
    assert np.max(np.abs(many.state - strong.analysis)) < SAME
    assert varda.check_model(Lorenz96(), strong.background).passed

    class Flat(Lorenz96):
        def adjoint(self, k, x, dy):
            return super().adjoint(k, x, dy).ravel()[:40]

    with pytest.raises(ValueError, match="adjoint\\(7, …\\) has the shape"):
        varda.assimilate(Flat(), strong.background, 1.0, seen(strong))


@pytest.mark.parametrize("method", ["blue", "4dvar-incremental", "4d-psas"])
def test_methods_by_name_are_those_of_scenes(method):
    scene = scene_of(algorithm__method=method)
    analysis = varda.assimilate(
        Lorenz96(), scene.background, 1.0, seen(scene), method=method, gradient_tolerance=1e-12, max_iterations=1000
    )
    assert analysis.status == scene.status
    assert np.max(np.abs(analysis.state - scene.analysis)) < SAME
    assert np.max(np.abs(analysis.sigma - scene.sigma_analysis)) < SAME
    assert analysis.J == pytest.approx(scene.summary["j_analysis"], rel=1e-12)


def test_the_huber_norm_is_that_of_scenes():
    scene = scene_of(algorithm__minimizer="trust-region", algorithm__robust=1.5)
    analysis = varda.assimilate(
        Lorenz96(), scene.background, 1.0, seen(scene), robust=1.5, gradient_tolerance=1e-12
    )
    assert np.max(np.abs(analysis.state - scene.analysis)) < SAME
    with pytest.raises(varda.AssimilationError, match="takes no Huber norm"):
        varda.assimilate(Lorenz96(), scene.background, 1.0, seen(scene), robust=1.5, method="4d-psas")


@pytest.mark.parametrize(
    "method, every, held", [("weak-forcing", 4, False), ("weak-forcing", 4, True), ("weak-state", 2, False)]
)
def test_weak_constraints_are_those_of_scenes(method, every, held):
    error = {"covariance": {"kind": "diagonal", "sigma": 0.1}, "every": every, "held": held}
    minimizer = {"minimizer": "trust-region"} if method == "weak-forcing" else {}
    scene = scene_of(algorithm={"method": method, "model_error": error, **minimizer})
    analysis = varda.assimilate(
        Lorenz96(), scene.background, 1.0, seen(scene), method=method, gradient_tolerance=1e-12,
        max_iterations=1000, model_error=varda.Forcing(0.1, every=every, held=held),
    )
    assert analysis.converged
    assert np.max(np.abs(analysis.state - scene.analysis)) < SAME
    assert np.max(np.abs(analysis.sigma - scene.sigma_analysis)) < SAME
    assert analysis.J == pytest.approx(scene.summary["j_analysis"], rel=1e-12)
    j_b, j_o, j_q = analysis.terms
    assert j_q > 0.1 and j_b + j_o + j_q == pytest.approx(analysis.J, rel=1e-13)
    # runs of a chaotic model from both
    assert np.max(np.abs(analysis.trajectory - scene.state[: len(analysis.trajectory)])) < 10 * SAME
    assert analysis.model_errors.shape == analysis.sigma_model_errors.shape == (8 // every, 40)
    # what is observed tells something of an error, and never takes from what Q says
    assert np.all(analysis.sigma_model_errors < 0.1 + 1e-12) and analysis.sigma_model_errors.min() < 0.0999
    assert analysis.draws(3).shape == (3, 40)
    # x_{k+1} − M(x_k) is η_j where it enters, and nothing elsewhere
    jumps = np.array([x - Lorenz96().step(0, before) for before, x in zip(analysis.trajectory, analysis.trajectory[1:])])
    if held:
        assert np.allclose(jumps, np.repeat(analysis.model_errors, every, axis=0), rtol=0, atol=1e-12)
    else:
        assert np.allclose(jumps[every - 1 :: every], analysis.model_errors, rtol=0, atol=1e-12)
        assert np.allclose(np.delete(jumps, np.s_[every - 1 :: every], axis=0), 0.0, atol=1e-12)


def test_a_model_that_errs_in_some_components():
    scene = scene_of()
    analysis = varda.assimilate(
        Lorenz96(), scene.background, 1.0, seen(scene), method="weak-forcing",
        model_error=varda.Forcing([0.1, 0.2, 0.3], every=4, components=[5, 0, 7]),
    )
    assert analysis.model_errors.shape == (2, 3)
    at = analysis.trajectory
    jump = at[4] - Lorenz96().step(3, at[3])
    assert np.allclose(jump[[5, 0, 7]], analysis.model_errors[0], rtol=0, atol=1e-12)
    assert np.allclose(np.delete(jump, [5, 0, 7]), 0.0, atol=1e-12)


@pytest.mark.parametrize("localized", [False, True])
@pytest.mark.parametrize("method", ["4denvar", "hybrid-4denvar"])
def test_ensembles_are_those_of_scenes(method, localized):
    ensemble = {"members": 40, **({"localization_length": 12.0} if localized else {})}
    text = varda.show("lorenz96-4denvar").split("[algorithm]")[0]
    scene = varda.run(text, seed=3, algorithm={"method": method, "ensemble": ensemble})
    analysis = varda.assimilate(
        Steps(), scene.background, 1.0, seen(scene), method=method, members=40, seed=3, max_iterations=1000,
        localization=taper(12.0) if localized else None,
    )
    assert analysis.status == scene.status
    # eigenvalues of a localization that scenes compute from the same numbers to rounding
    assert np.max(np.abs(analysis.state - scene.analysis)) < SAME
    assert np.max(np.abs(analysis.sigma - scene.sigma_analysis)) < SAME
    assert analysis.J == pytest.approx(scene.summary["j_analysis"], rel=1e-10)
    assert np.allclose(analysis.covariance.diagonal(), analysis.sigma**2, rtol=1e-8)
    # a variance of 4000 draws is known to √(2/4000) = 2.2 %: six times that
    assert np.allclose(analysis.draws(4000).std(axis=0), analysis.sigma, rtol=0.07)
    assert analysis.members.shape == (40, 40)
    if not localized and method == "4denvar":
        # the square root of the ensemble has its mean and P_a
        assert np.allclose(analysis.members.mean(axis=0), analysis.state, rtol=0, atol=1e-10)
        assert np.allclose(analysis.members.std(axis=0, ddof=1), analysis.sigma, rtol=1e-8)


def test_jax_gives_tangent_and_adjoint(strong):
    jax = pytest.importorskip("jax", reason="jax is not installed")
    import jax.numpy as jnp

    def rate(x):
        return (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1) - x + 8.0

    def step(k, x, h=0.025):
        k1 = rate(x)
        k2 = rate(x + 0.5 * h * k1)
        k3 = rate(x + 0.5 * h * k2)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))

    jax.config.update("jax_enable_x64", False)
    with pytest.raises(varda.AssimilationError, match="jax_enable_x64"):
        varda.JaxModel(step)
    jax.config.update("jax_enable_x64", True)
    model = varda.JaxModel(step)
    assert varda.check_model(model, strong.background).passed
    analysis = varda.assimilate(model, strong.background, 1.0, seen(strong), gradient_tolerance=1e-12)
    assert np.max(np.abs(analysis.state - strong.analysis)) < SAME
    assert np.max(np.abs(analysis.sigma - strong.sigma_analysis)) < SAME


@pytest.mark.parametrize(
    "text, change",
    [
        ("estimates errors of the model: it takes model_error", {"method": "weak-forcing"}),
        ("takes the model to be right", {"model_error": 0.1}),
        ("covariance of the model error of shape (3,)", {"method": "weak-state", "model_error": [1.0, 1.0, 1.0]}),
        (
            "components are integers from 0 to 39",
            {"method": "weak-state", "model_error": varda.Forcing(0.1, components=[40])},
        ),
        ("every 0 steps", {"method": "weak-state", "model_error": varda.Forcing(0.1, every=0)}),
        ("the steps of a held forcing", {"method": "weak-state", "model_error": varda.Forcing(0.1, 2, True)}),
        ("3 weights", {"method": "hybrid-4denvar", "weights": [1, 2, 3]}),
        ("weight", {"method": "hybrid-4denvar", "weights": [-1, 2]}),
        ("none of 4dvar", {"method": "static"}),
    ],
)
def test_what_does_not_fit_together_is_refused(text, change):
    with pytest.raises(varda.AssimilationError) as raised:
        varda.assimilate(Lorenz96(), np.ones(40), 1.0, [(4, [0], [1.0], 0.1)], **change)
    assert text in str(raised.value)
