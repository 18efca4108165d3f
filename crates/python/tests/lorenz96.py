"""Lorenz-96 in NumPy, and the observations of a scene."""

import numpy as np


class Lorenz96:
    """Lorenz's ring (Lorenz 1996) by the classical Runge-Kutta method, with tangent and adjoint of the
    rows of an array or, where it is not `batched`, of one vector."""

    batched = True

    def __init__(self, step=0.025, forcing=8.0):
        self.dt, self.forcing = step, forcing

    def rate(self, x):
        return (np.roll(x, -1, -1) - np.roll(x, 2, -1)) * np.roll(x, 1, -1) - x + self.forcing

    def rate_tangent(self, x, d):
        return (
            (np.roll(d, -1, -1) - np.roll(d, 2, -1)) * np.roll(x, 1, -1)
            + (np.roll(x, -1, -1) - np.roll(x, 2, -1)) * np.roll(d, 1, -1)
            - d
        )

    def rate_adjoint(self, x, q):
        a, b = q * np.roll(x, 1, -1), q * (np.roll(x, -1, -1) - np.roll(x, 2, -1))
        return np.roll(a, 1, -1) - np.roll(a, -2, -1) + np.roll(b, -1, -1) - q

    def stages(self, x):
        h = self.dt
        k1 = self.rate(x)
        k2 = self.rate(x + 0.5 * h * k1)
        k3 = self.rate(x + 0.5 * h * k2)
        return [x, x + 0.5 * h * k1, x + 0.5 * h * k2, x + h * k3], [k1, k2, k3]

    def step(self, k, x):
        at, (k1, k2, k3) = self.stages(x)
        return x + self.dt / 6 * (k1 + 2 * k2 + 2 * k3 + self.rate(at[3]))

    def tangent(self, k, x, dx):
        h, (at, _) = self.dt, self.stages(x)
        d1 = self.rate_tangent(at[0], dx)
        d2 = self.rate_tangent(at[1], dx + 0.5 * h * d1)
        d3 = self.rate_tangent(at[2], dx + 0.5 * h * d2)
        d4 = self.rate_tangent(at[3], dx + h * d3)
        return dx + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)

    def adjoint(self, k, x, dy):
        h, (at, _) = self.dt, self.stages(x)
        q4 = self.rate_adjoint(at[3], h / 6 * dy)
        q3 = self.rate_adjoint(at[2], h / 3 * dy + h * q4)
        q2 = self.rate_adjoint(at[1], h / 3 * dy + 0.5 * h * q3)
        q1 = self.rate_adjoint(at[0], h / 6 * dy + 0.5 * h * q2)
        return dy + q1 + q2 + q3 + q4


def seen(scene):
    """The observations of the scene, step by step."""
    values = scene.observations
    out = []
    for t in np.unique(values["time"]):
        rows = values[values["time"] == t]
        step = int(np.argmin(np.abs(scene.time - t)))
        components = [scene.names.index(label) for label in rows["label"]]
        out.append((step, components, rows["value"], rows["sigma"]))
    return out
