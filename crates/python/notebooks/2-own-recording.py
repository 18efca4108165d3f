# %% [markdown]
# # A recording of your own
#
# Something flexible was filmed, and a table of places came out. Here it is a hose: clamped at one end, pulled at the other
# and let go; six points of it at 50 frames a second, with noise of 2 mm. (The recording was made by another program, a
# chain of 60 links, so it is not Varda's own model that made it.)

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import varda_da as varda

recording = Path("../../varda/scenes/data/hose.csv").resolve()
print("".join(recording.open().readlines()[:4]))

# %% [markdown]
# A scene is a text, or a dict as here: the rod, how it is held, what was known of its state, and the file.
# The first second is used; what comes later judges a forecast.

# %%
scene = {
    "title": "A hose let go",
    "model": {
        "kind": "rod",
        "length": 0.6,  # m
        "segments": 12,
        "gravity": [0.0, 0.0, -9.81],
        "section": {"kind": "stiffness", "ea": 1e5, "ei": [0.3, 0.3], "gj": 0.2, "mass_per_length": 0.35},
        "natural_curvature": [1.0, 0.0],  # 1/m
        "point_masses": [{"arc_length": 0.6, "mass": 0.05}],  # kg
        "damping": {"stiffness": 0.008},  # s
        "start": {
            "position": [0.0, 0.0, 0.0],
            "tangent": [0.7849, 0.3660, 0.5],
            "director": [-0.4532, -0.2113, 0.8660],
        },
    },
    "time": {"integrator": "bdf2", "step": 0.01, "window": 100},
    "background": {
        "from": "static-equilibrium",
        "covariance": {
            "kind": "kernel",
            "sigma_x": 0.1,  # m: how far it may be from rest
            "sigma_v": 0.1,  # m/s
            "correlation_length_x": 0.3,
            "correlation_length_v": 0.3,
        },
    },
    "observations": {"kind": "file", "file": recording, "sigma": 0.002, "outside_window": "skip"},
    "report": {"forecast": 1.0},  # s
}

# %% [markdown]
# Before anything is minimized: does the file fit the scene? Try it with `"length": 0.5`.

# %%
for finding in varda.check(scene):
    print(finding.severity, finding.place, finding.text)

# %%
result = varda.run(scene)
result.verdict, result.summary["chi2"], result.summary["seconds"]

# %% [markdown]
# The height of the tip. Right of the line nothing was used: that is the forecast.

# %%
seen = result.observations
rows = seen[(seen["axis"] == "z") & (seen["label"] == seen["label"][-1])]
plt.figure(figsize=(8, 3))
plt.plot(result.time, result.positions_background[:, -1, 2], ":", label="at rest (background)")
plt.plot(result.time, result.positions[:, -1, 2], label="analysis and forecast")
plt.plot(rows["time"], rows["value"], "k.", ms=3, label="used")
later = np.genfromtxt(recording, delimiter=",", names=True)
later = later[(later["s_m"] == 0.6) & (later["time_s"] > 1.0) & (later["time_s"] <= result.time[-1])]
plt.plot(later["time_s"], later["z_m"], "r.", ms=3, label="recorded later")
plt.axvline(1.0, color="grey", lw=1)
plt.xlabel("time (s)")
plt.ylabel("z of the tip (m)")
plt.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0));

# %%
at = np.interp(later["time_s"], result.time, result.positions[:, -1, 2])
print(f"forecast of z over one second: {1e3 * np.sqrt(np.mean((at - later['z_m']) ** 2)):.1f} mm, the noise alone is 2 mm")

# %% [markdown]
# From a file of a motion-capture system: `varda convert` makes such a table of C3D, Motive, Nexus or TRC files, and
# `varda new NAME --recording FILE.csv` writes a first scene for it.
