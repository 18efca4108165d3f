# %% [markdown]
# # A first scene
#
# A scene is a text that says what moves, what was seen and what was known before. Varda finds the motion that agrees
# with all of it, and says how sure that is. Scene `hanging-rod` is a rubber rod whose upper end is swung around; four
# points of it are seen. The data are drawn from a run of the model, so the truth is known here.

# %%
import matplotlib.pyplot as plt
import numpy as np

import varda_da as varda

result = varda.run("hanging-rod", seed=1)
result.verdict, result.summary["chi2"]

# %% [markdown]
# `fits`: the motion agrees with what was seen as well as the stated errors let it. `chi2` is 2J/m, about 1 in that case.
#
# The report is the result's own picture. It turns and plays.

# %%
result

# %% [markdown]
# Everything in it is an array, in SI units. The free end, with two standard deviations:

# %%
names = ["x", "y", "z"]
figure, axes = plt.subplots(3, sharex=True, figsize=(8, 6))
for i, axis in enumerate(axes):
    tip, sigma = result.positions[:, -1, i], result.sigma_positions[:, -1, i]
    axis.fill_between(result.time, tip - 2 * sigma, tip + 2 * sigma, alpha=0.3, label="analysis ± 2σ")
    axis.plot(result.time, tip)
    axis.plot(result.time, result.positions_background[:, -1, i], ":", label="background")
    axis.plot(result.time, result.positions_truth[:, -1, i], "k--", lw=1, label="truth")
    axis.set_ylabel(f"{names[i]} of the tip (m)")
axes[0].legend()
axes[-1].set_xlabel("time (s)");

# %% [markdown]
# Keys of the scene are arguments, as `--set` of the command line is. With errors of observation a fifth as large:

# %%
better = varda.run("hanging-rod", seed=1, observations__sigma_over_length=0.02)
for one in (result, better):
    error = np.sqrt(np.mean((one.positions - one.positions_truth) ** 2))
    print(f"error of places {1e3 * error:.1f} mm, expected σ {1e3 * np.nanmean(one.sigma_positions):.1f} mm")

# %% [markdown]
# `varda.show("hanging-rod")` is the text of the scene, `varda.scenes()` lists those that come with Varda,
# `result.write("out")` writes the folder that the command line writes, `result.to_xarray()` is a Dataset.
