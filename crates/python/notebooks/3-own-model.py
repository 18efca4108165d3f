# %% [markdown]
# # A model of your own in NumPy
#
# A model is a step with its tangent and its adjoint. Here Lorenz's ring of 40 variables (Lorenz 1996), a toy of weather,
# by the classical Runge–Kutta method. With `batched = True` the functions take several vectors at once, one a row.

# %%
import matplotlib.pyplot as plt
import numpy as np

import varda_da as varda


class Lorenz96:
    batched = True
    h, forcing = 0.025, 8.0

    def rate(self, x):
        return (np.roll(x, -1) - np.roll(x, 2)) * np.roll(x, 1) - x + self.forcing

    def rate_tangent(self, x, d):  # ∂f/∂x d
        roll = lambda d, by: np.roll(d, by, axis=-1)
        return (roll(d, -1) - roll(d, 2)) * roll(x, 1) + (roll(x, -1) - roll(x, 2)) * roll(d, 1) - d

    def rate_adjoint(self, x, q):  # (∂f/∂x)ᵀ q
        roll = lambda d, by: np.roll(d, by, axis=-1)
        a, b = q * roll(x, 1), q * (roll(x, -1) - roll(x, 2))
        return roll(a, 1) - roll(a, -2) + roll(b, -1) - q

    def stages(self, x):
        h = self.h
        x2 = x + h / 2 * self.rate(x)
        x3 = x + h / 2 * self.rate(x2)
        return x, x2, x3, x + h * self.rate(x3)

    def step(self, k, x):
        f1, f2, f3, f4 = (self.rate(s) for s in self.stages(x))
        return x + self.h / 6 * (f1 + 2 * f2 + 2 * f3 + f4)

    def tangent(self, k, x, dx):
        h, s = self.h, self.stages(x)
        d1 = self.rate_tangent(s[0], dx)
        d2 = self.rate_tangent(s[1], dx + h / 2 * d1)
        d3 = self.rate_tangent(s[2], dx + h / 2 * d2)
        d4 = self.rate_tangent(s[3], dx + h * d3)
        return dx + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)

    def adjoint(self, k, x, dy):
        h, s = self.h, self.stages(x)
        q4 = self.rate_adjoint(s[3], h / 6 * dy)
        q3 = self.rate_adjoint(s[2], h / 3 * dy + h * q4)
        q2 = self.rate_adjoint(s[1], h / 3 * dy + h / 2 * q3)
        q1 = self.rate_adjoint(s[0], h / 6 * dy + h / 2 * q2)
        return dy + q1 + q2 + q3 + q4


model = Lorenz96()

# %% [markdown]
# Tangents and adjoints are easy to get wrong. The check finds out: is the tangent the derivative of the step, and the
# adjoint the transpose of the tangent?

# %%
rng = np.random.default_rng(1)
x = 8.0 + rng.normal(size=40)
print(varda.check_model(model, x))

# %% [markdown]
# A truth, a background that is off by 1, and every second variable seen four times with an error of 0.4:

# %%
truth = [x]
for k in range(400 + 16):
    truth.append(model.step(k, truth[-1]))
truth = np.array(truth[400:])
background = truth[0] + rng.normal(size=40)
components = np.arange(0, 40, 2)
observations = [(k, components, truth[k][components] + 0.4 * rng.normal(size=20), 0.4) for k in (4, 8, 12, 16)]

analysis = varda.assimilate(model, background, 1.0, observations)
analysis

# %%
figure, axis = plt.subplots(figsize=(8, 3))
i = np.arange(40)
axis.errorbar(i, analysis.state - truth[0], 2 * analysis.sigma, fmt="o", ms=3, label="analysis − truth, ± 2σ")
axis.plot(i, background - truth[0], "x", label="background − truth")
axis.axhline(0, color="k", lw=0.5)
axis.set_xlabel("variable")
axis.legend();

# %% [markdown]
# ## How sure is a forecast?
#
# Draws of the posterior, run on. `draws` are states; the model takes them all at once.

# %%
members = [analysis.draws(100)]
for k in range(60):
    members.append(np.array([model.step(k, x) for x in members[-1]]))
members = np.array(members)[:, :, 1]  # variable 1, never seen
plt.figure(figsize=(8, 3))
plt.plot(model.h * np.arange(61), members, color="C0", lw=0.3)
plt.axvline(16 * model.h, color="grey", lw=1)
plt.xlabel("time")
plt.ylabel("variable 1");

# %% [markdown]
# ## If the model errs
#
# The same model with a forcing of 7 instead of 8, and better data: everything, with an error of 0.1. No run of the wrong
# model fits these. With one unknown error for each variable, added after every step, it does:

# %%
wrong = Lorenz96()
wrong.forcing = 7.0
better = [(k, i, truth[k] + 0.1 * rng.normal(size=40), 0.1) for k in range(1, 17)]
strong = varda.assimilate(wrong, background, 1.0, better)
weak = varda.assimilate(
    wrong, background, 1.0, better, method="weak-forcing", model_error=varda.Forcing(0.05, every=16, held=True)
)
for name, one in (("model right", strong), ("model errs", weak)):
    error = np.sqrt(np.mean((one.trajectory - truth) ** 2))
    print(f"{name:12} 2J/m {one.chi2:5.2f}, error {error:.3f}")
print(f"error found {weak.model_errors.mean():.4f} a step, the forcing misses {wrong.h * 1.0:.4f}")

# %% [markdown]
# With JAX the step is enough: `varda.JaxModel(step)` takes tangent and adjoint from it. Without any derivative:
# `method="4denvar"`, next page.
