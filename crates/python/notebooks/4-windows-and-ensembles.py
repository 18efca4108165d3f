# %% [markdown]
# # Window after window, with and without an ensemble
#
# Data keep coming: each window of time starts from the analysis of the one before. What a window hands on is a state, and
# how sure that state is. Lorenz's ring again, everything seen at every step with an error of 1.

# %%
import matplotlib.pyplot as plt
import numpy as np

import varda_da as varda


class Steps:
    """Lorenz-96 without derivatives."""

    h = 0.05

    def rate(self, x):
        one, two, back = (np.roll(x, by, axis=-1) for by in (-1, 2, 1))
        return (one - two) * back - x + 8.0

    def step(self, k, x):
        h = self.h
        f1 = self.rate(x)
        f2 = self.rate(x + h / 2 * f1)
        f3 = self.rate(x + h / 2 * f2)
        return x + h / 6 * (f1 + 2 * f2 + 2 * f3 + self.rate(x + h * f3))


model, rng = Steps(), np.random.default_rng(2)
truth = [8.0 + rng.normal(size=40)]
for k in range(200 + 120):
    truth.append(model.step(k, truth[-1]))
truth = np.array(truth[200:])
background = truth[0] + rng.normal(size=40)
observations = [(k, np.arange(40), truth[k] + rng.normal(size=40), 1.0) for k in range(1, 121)]

# %% [markdown]
# ## An ensemble
#
# Thirty runs of the model take the place of its derivatives. `inflation="adaptive"` makes up for their small number.

# %%
ensemble = varda.cycle(
    model, background, 1.0, observations, window=4, method="4denvar", members=30, inflation="adaptive", max_iterations=4
)
ensemble

# %% [markdown]
# ## With derivatives
#
# Here from the Jacobian by complex steps, exact to rounding: the columns are one call of the step. (A large model has better
# ones, as on page 3, or JAX.)

# %%
class Differentiated(Steps):
    batched = True

    def jacobian(self, k, x):
        return self.step(k, x + 1e-30j * np.eye(40)).imag / 1e-30  # row j: ∂M/∂x_j

    def tangent(self, k, x, dx):
        return dx @ self.jacobian(k, x)

    def adjoint(self, k, x, dy):
        return dy @ self.jacobian(k, x).T


static = varda.cycle(Differentiated(), background, 0.5, observations, window=4, gradient_tolerance=1e-3)
propagated = varda.cycle(
    Differentiated(), background, 1.0, observations, window=4, carry="propagated", inflation=1.1, gradient_tolerance=1e-3
)

# %%
def error(run):
    return np.sqrt(np.mean((run.trajectory - truth) ** 2, axis=1))


plt.figure(figsize=(8, 3))
time = model.h * np.arange(121)
for name, run in (("static B, σ 0.5", static), ("propagated", propagated), ("ensemble", ensemble)):
    late = np.sqrt(np.mean(error(run)[40:] ** 2))
    plt.plot(time, error(run), label=f"{name}: {late:.2f}")
plt.axhline(1.0, color="grey", lw=1, label="one observation alone")
plt.xlabel("time")
plt.ylabel("RMS error")
plt.legend(title="and its mean from 2 on");

# %% [markdown]
# Is an ensemble as sure as it should be? What it expects of its own error, beside the error:

# %%
expected = np.sqrt(np.mean(ensemble.sigma**2, axis=1))
found = np.sqrt(np.mean((ensemble.end - truth[ensemble.first_step + 4]) ** 2, axis=1))
plt.figure(figsize=(8, 3))
plt.plot(expected, label="expected")
plt.plot(found, label="error")
plt.xlabel("window")
plt.legend();

# %% [markdown]
# Data that arrive later: `varda.cycle(..., state=ensemble.state)` goes on where this ended, with the same numbers as if it
# had never stopped.
