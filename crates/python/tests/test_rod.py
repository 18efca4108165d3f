"""Rods without an assimilation."""

import numpy as np
import pytest

import varda_da as varda

KEYWORDS = {
    "length": 0.6,
    "segments": 12,
    "section": {"kind": "circle", "radius": 0.008},
    "material": {"youngs_modulus": 1e6, "poisson_ratio": 0.5, "density": 1100.0},
    "gravity": [0.0, 0.0, -9.81],
    "start": {"position": [0.0, 0.0, 0.0], "tangent": [1.0, 0.0, 0.0], "director": [0.0, 0.0, 1.0]},
}


def test_forces_balance_at_rest():
    rod = varda.Rod(**KEYWORDS)
    rest = rod.equilibrium()
    assert rest.vertices.shape == (13, 3) and rest.vertices[-1, 2] < -0.3
    gradient = rod.gradient(rest.vertices, rest.theta)[:39].reshape(13, 3)
    weight = rod.masses[:, None] * np.array([0.0, 0.0, -9.81])
    # free vertices: elastic forces hold the weight, to Newton's tolerance of some 1e-10 of the stretching force
    assert np.max(np.abs(gradient - weight)[2:]) < 1e-8
    assert rod.masses.sum() == pytest.approx(1100.0 * np.pi * 0.008**2 * 0.6, rel=0.05)


def bent(rod):
    rng = np.random.default_rng(1)
    x = np.zeros((rod.segments + 1, 3))
    x[:, 0] = rod.arc_length
    return x + 0.01 * rng.normal(size=x.shape), 0.3 * rng.normal(size=rod.segments)


def test_gradient_and_hessian_are_those_of_the_energy():
    rod = varda.Rod(**KEYWORDS)
    x, theta = bent(rod)
    gradient, hessian = rod.gradient(x, theta), rod.hessian(x, theta)
    assert gradient.shape == (51,) and np.array_equal(hessian, hessian.T)
    direction = np.random.default_rng(2).normal(size=51)
    dx, dtheta = direction[:39].reshape(13, 3), direction[39:]

    def energy(h):
        return rod.energy(x + h * dx, theta + h * dtheta, frames_at=x).total

    errors = []
    for h in (1e-4, 1e-5):
        first = (energy(h) - energy(-h)) / (2 * h)
        second = (energy(h) - 2 * energy(0) + energy(-h)) / h**2
        errors.append([first / (gradient @ direction) - 1, second / (direction @ hessian @ direction) - 1])
    errors = np.abs(errors)
    # central differences are of second order: a tenth of h leaves a hundredth of the error
    assert (errors[1] < 0.02 * errors[0] + [1e-9, 1e-4]).all() and (errors[1] < 1e-4).all()


def test_a_stretched_segment():
    # E = ½ EA ε² l
    rod = varda.Rod(**KEYWORDS)
    x = np.zeros((13, 3))
    x[:, 0] = 1.01 * rod.arc_length
    energy = rod.energy(x)
    assert energy.stretch == pytest.approx(0.5 * 1e6 * np.pi * 0.008**2 * 0.01**2 * rod.arc_length[-1], rel=0.05)
    assert energy.bend < 1e-20 and energy.twist < 1e-20 and energy.total > 0


def test_a_sparse_hessian_is_the_dense_one():
    pytest.importorskip("scipy.sparse")
    rod = varda.Rod(**KEYWORDS)
    x, theta = bent(rod)
    sparse = rod.sparse_hessian(x, theta)
    assert np.array_equal(sparse.toarray(), rod.hessian(x, theta)) and sparse.nnz < 51 * 51


def test_a_rod_of_a_scene_has_its_modes_and_runs():
    rod = varda.Rod("hanging-rod", set={"model.segments": 10})
    assert rod.segments == 10 and rod.modes(2).shape.shape == (2, 11, 3)
    assert rod.simulate(time__window=10).positions.shape == (11, 11, 3)
    still = varda.Rod(**KEYWORDS).simulate(time__window=10)
    assert np.max(np.abs(still.positions[-1] - still.positions[0])) < 1e-8


def test_what_is_no_rod_is_refused():
    with pytest.raises(varda.SceneError, match="no rod"):
        varda.Rod("lorenz96")
    with pytest.raises(varda.SceneError, match="needs the key"):
        varda.Rod(length=1.0)
    with pytest.raises(varda.ModelError, match=r"\(13, 3\) and \(12,\)"):
        varda.Rod(**KEYWORDS).energy(np.zeros((3, 3)))
    with pytest.raises(varda.ModelError):
        varda.Rod(**KEYWORDS).gradient(np.zeros((13, 3)))
    with pytest.raises(TypeError):
        varda.Rod("hanging-rod", length=2.0)
