# %% [markdown]
# # Estimate what you do not know
#
# Stiffness and damping are what one knows least. With a table `estimate`, a scene finds them together with the motion. The
# hose of page 2 again: it was made with EI = 0.30 N m² and a damping time of 8 ms. Suppose we thought 0.1 and 20 ms.

# %%
import matplotlib.pyplot as plt
import numpy as np

import varda_da as varda

result = varda.run(
    "hose",
    set={
        "model.segments": 12,
        "model.section.ei": [0.1, 0.1],
        "model.damping.stiffness": 0.02,
        "estimate": {"ei": {"sigma": "80%", "together": True}, "damping_stiffness": {"sigma": "80%"}},
    },
)
result.verdict

# %%
truth = {"ei": 0.30, "damping_stiffness": 0.008}
figure, axes = plt.subplots(1, 2, figsize=(8, 3))
for axis, found in zip(axes, result.estimates):
    true, low, high = truth[found["name"]], *found["interval"]
    axis.errorbar([0, 1], [found["prior"], found["value"]], [2 * found["prior_sigma"], 2 * found["sigma"]], fmt="o", capsize=4)
    axis.axhline(true, color="k", ls="--", lw=1, label="truth")
    axis.set_xticks([0, 1], ["thought", "found"])
    axis.set_title(f"{found['name']} ({found['unit']})")
    axis.set_ylim(0, None)
    axis.legend()
    print(f"{found['name']}: {found['value']:.4g} ± {found['sigma']:.2g} {found['unit']}, 95 % {low:.4g} to {high:.4g}; truth {true}")

# %% [markdown]
# ## Constants of a model of your own
#
# A constant is a part of the state that does not change: p' = p. A pendulum of unknown length, seen six times:

# %%
class Pendulum:
    h, g = 0.05, 9.81

    def step(self, k, x):
        angle, spin, length = x
        spin = spin - self.h * self.g / length * np.sin(angle)
        return [angle + self.h * spin, spin, length]

    def tangent(self, k, x, dx):
        angle, _, length = x
        pull = self.h * self.g / length
        spin = dx[1] - pull * np.cos(angle) * dx[0] + pull / length * np.sin(angle) * dx[2]
        return [dx[0] + self.h * spin, spin, dx[2]]

    def adjoint(self, k, x, dy):
        angle, _, length = x
        pull = self.h * self.g / length
        spin = dy[1] + self.h * dy[0]
        return [dy[0] - pull * np.cos(angle) * spin, spin, dy[2] + pull / length * np.sin(angle) * spin]


model = Pendulum()
assert varda.check_model(model, [0.9, 0.3, 1.2]).passed
x = np.array([0.8, 0.0, 1.3])  # the truth: 1.3 m
rng, observations = np.random.default_rng(3), []
for k in range(60):
    x = np.array(model.step(k, x))
    if k % 10 == 9:
        observations.append((k + 1, [0], [x[0] + 0.01 * rng.normal()], 0.01))
analysis = varda.assimilate(model, [0.7, 0.0, 1.0], [0.2, 0.2, 0.5], observations)
print(f"length {analysis.state[2]:.3f} ± {analysis.sigma[2]:.3f} m, thought 1.0 ± 0.5, truth 1.3; 2J/m {analysis.chi2:.2f}")

# %% [markdown]
# What is known of the length depends on what is known of the start: the draws show it.

# %%
draws = analysis.draws(500)
plt.figure(figsize=(4, 3))
plt.plot(draws[:, 2], draws[:, 0], ".", ms=2)
plt.plot(1.3, 0.8, "k*", label="truth")
plt.xlabel("length (m)")
plt.ylabel("angle at the start")
plt.legend();
