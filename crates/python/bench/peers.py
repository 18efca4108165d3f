"""Varda from Python beside other programs, on the same problems: error and CPU seconds of one process.

    pip install . dapper adao mujoco absl-py colorama tabulate pyyaml
    VARDA_BINARY=../../target/release/varda python bench/peers.py       # or some of: overhead lorenz hose

Prints tables in Markdown: docs/results/peers.md has them. A program that is not installed is left out, with
a word. Seconds are CPU seconds of this process (user and system) on one thread, the least of some runs;
ratios are of one run of this script.
"""

import contextlib
import importlib.metadata
import io
import os
import platform
import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[threads] = "1"

import numpy as np

import varda_da as varda

RUNS = 2


def timed(work, runs=RUNS):
    """The result of some work, and the least CPU seconds of some runs of it."""
    seconds = []
    for _ in range(runs):
        started = time.process_time()
        result = work()
        seconds.append(time.process_time() - started)
    return result, min(seconds)


def table(head, rows):
    print("\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def version(name):
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def quiet():
    """Programs that print while they work."""
    return contextlib.redirect_stdout(io.StringIO())


# What a scene costs from Python over the binary


def children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def overhead(runs=9):
    binary = os.environ.get("VARDA_BINARY")
    if not binary:
        return print("overhead: VARDA_BINARY names no program")
    rows = []
    for scene in ("lorenz96", "hanging-rod", "hose"):
        out = Path("/tmp") / f"varda-peers-{os.getpid()}"
        walls, cpus = {"binary": [], "Python": []}, {"binary": [], "Python": []}
        varda.run(scene, out=out)
        # in turn, so that both meet the same load
        for _ in range(runs):
            cpu, wall = children(), time.perf_counter()
            subprocess.run([binary, "run", scene, "--out", out], check=True, capture_output=True)
            walls["binary"].append(time.perf_counter() - wall)
            cpus["binary"].append(children() - cpu)
            cpu, wall = time.process_time(), time.perf_counter()
            varda.run(scene, out=out)
            walls["Python"].append(time.perf_counter() - wall)
            cpus["Python"].append(time.process_time() - cpu)
        numbers = [1e3 * min(part[who]) for part in (cpus, walls) for who in ("binary", "Python")]
        shown = [f"{x:.1f}" for x in numbers]
        shown.insert(2, f"{numbers[1] - numbers[0]:+.1f}")
        rows.append([f"`{scene}`", *shown, f"{numbers[3] - numbers[2]:+.1f}"])
    head = ["binary, CPU ms", "Python, CPU ms", "over", "binary, clock ms", "Python, clock ms", "over"]
    table(["scene", *head], rows)


# 4D-Var of Lorenz-96, the model in NumPy


class Lorenz96:
    """Some steps at once of Lorenz's ring by the classical Runge-Kutta method."""

    batched = True
    h, n = 0.05, 40

    def __init__(self, steps):
        self.steps = steps

    def rate(self, x):
        return (np.roll(x, -1, -1) - np.roll(x, 2, -1)) * np.roll(x, 1, -1) - x + 8.0

    def rate_tangent(self, x, d):
        return (
            (np.roll(d, -1, -1) - np.roll(d, 2, -1)) * np.roll(x, 1)
            + (np.roll(x, -1) - np.roll(x, 2)) * np.roll(d, 1, -1)
            - d
        )

    def rate_adjoint(self, x, q):
        a, b = q * np.roll(x, 1), q * (np.roll(x, -1) - np.roll(x, 2))
        return np.roll(a, 1, -1) - np.roll(a, -2, -1) + np.roll(b, -1, -1) - q

    def stages(self, x):
        h = self.h
        x2 = x + h / 2 * self.rate(x)
        x3 = x + h / 2 * self.rate(x2)
        return x, x2, x3, x + h * self.rate(x3)

    def one(self, x):
        f1, f2, f3, f4 = (self.rate(s) for s in self.stages(x))
        return x + self.h / 6 * (f1 + 2 * f2 + 2 * f3 + f4)

    def step(self, k, x):
        for _ in range(self.steps):
            x = self.one(x)
        return x

    def tangent(self, k, x, d):
        h = self.h
        for _ in range(self.steps):
            s = self.stages(x)
            d1 = self.rate_tangent(s[0], d)
            d2 = self.rate_tangent(s[1], d + h / 2 * d1)
            d3 = self.rate_tangent(s[2], d + h / 2 * d2)
            d4 = self.rate_tangent(s[3], d + h * d3)
            x, d = self.one(x), d + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)
        return d

    def adjoint(self, k, x, q):
        h, states = self.h, [x]
        for _ in range(self.steps - 1):
            states.append(self.one(states[-1]))
        for x in reversed(states):
            s = self.stages(x)
            q4 = self.rate_adjoint(s[3], h / 6 * q)
            q3 = self.rate_adjoint(s[2], h / 3 * q + h * q4)
            q2 = self.rate_adjoint(s[1], h / 3 * q + h / 2 * q3)
            q = q + self.rate_adjoint(s[0], h / 6 * q + h / 2 * q2) + q2 + q3 + q4
        return q


SIGMA = 0.4
#: B: σ 1, correlated over three variables.
APART = abs(np.arange(40)[:, None] - np.arange(40))
B = np.exp(-0.5 * (np.minimum(APART, 40 - APART) / 1.5) ** 2)


class Twin:
    """A truth, a background drawn from B, and some variables seen at the ends of the parts of a window."""

    def __init__(self, seed, parts, steps, seen):
        self.seen, self.h = seen, np.eye(40)[seen]
        rng, one = np.random.default_rng(seed), Lorenz96(1)
        x = 8.0 + rng.normal(size=40)
        for _ in range(400):
            x = one.one(x)
        self.model, self.parts, self.truth = Lorenz96(steps), parts, x
        self.background = x + np.linalg.cholesky(B + 1e-12 * np.eye(40)) @ rng.normal(size=40)
        self.values = []
        for _ in range(parts):
            x = self.model.step(0, x)
            self.values.append(x[seen] + SIGMA * rng.normal(size=len(seen)))
        self.end = x

    def cost(self, x):
        """J, and the state at the end of the window."""
        away = x - self.background
        j = 0.5 * away @ np.linalg.solve(B, away)
        for y in self.values:
            x = self.model.step(0, x)
            j += 0.5 * np.sum((y - x[self.seen]) ** 2) / SIGMA**2
        return j, x


def by_varda(twin, **keys):
    observations = [(k + 1, twin.seen, y, SIGMA) for k, y in enumerate(twin.values)]
    return varda.assimilate(twin.model, twin.background, B, observations, **keys).state


class Observed:
    """H. Var4D of DAPPER 1.7.1 calls the operator of an observation with its number first."""

    def __init__(self, twin):
        self.seen, self.h = twin.seen, twin.h

    def __call__(self, x):
        return self if np.ndim(x) == 0 else x[..., self.seen]

    def linear(self, x):
        return self.h


def by_dapper(twin):
    """Var4D sees one time at the end of each of its windows: one window of it."""
    from dapper.da_methods.variational import Var4D
    from dapper.mods import HiddenMarkovModel, Operator
    from dapper.tools.chronos import Chronology
    from dapper.tools.randvars import GaussRV

    starts = []

    def step(x, t, dt):
        starts.append(x)
        return twin.model.step(0, x)

    tseq = Chronology(dt=1.0, dko=1, K=1, BurnIn=0)

    def linear(x, t, dt):
        return twin.model.tangent(0, x, np.eye(40)).T

    dynamics = Operator(40, model=step, linear=linear, noise=0)
    seen = {"M": len(twin.seen), "model": Observed(twin), "noise": SIGMA**2}
    hmm = HiddenMarkovModel(dynamics, seen, tseq, GaussRV(mu=twin.background, C=B))
    method = Var4D(B=B.copy(), nIter=30, wtol=1e-9, Lag=1)
    xx = np.array([twin.background, twin.background])
    method.assimilate(hmm, xx, np.array(twin.values), liveplots=False)
    # the start of its last run: what follows is a step of less than the square root of wtol
    return starts[-1]


def by_adao(twin, before=False):
    """4DVAR asks for the adjoint of a step, as a matrix, at the state after the step (std4dvar.py). `before`
    finds the state before it, where the derivative of J has it, among those that were run."""
    from adao import adaoBuilder

    model, starts = twin.model, {}

    def flat(x):
        return np.ravel(np.asarray(x, dtype=float))

    def direct(x):
        x = flat(x)
        end = model.step(0, x)
        starts[end.tobytes()] = x
        return end

    def tangent(pair):
        return model.tangent(0, flat(pair[0]), flat(pair[1])[None])[0]

    def adjoint(pair):
        x, y = flat(pair[0]), pair[1]
        if before:
            x = starts[x.tobytes()]
        if y is None:
            return model.adjoint(0, x, np.eye(40)).T
        return model.adjoint(0, x, flat(y)[None])[0]

    case = adaoBuilder.New()
    parameters = {"MaximumNumberOfIterations": 1000, "CostDecrementTolerance": 1e-9, "EstimationOf": "State"}
    case.set("AlgorithmParameters", Algorithm="4DVAR", Parameters=parameters)
    case.set("Background", Vector=twin.background)
    case.set("BackgroundError", Matrix=B)
    # its first vector belongs to the start of the window and is not looked at
    case.set("Observation", VectorSerie=[twin.values[0], *twin.values])
    case.set("ObservationError", ScalarSparseMatrix=SIGMA**2)
    case.set("ObservationOperator", Matrix=twin.h)
    case.set("EvolutionModel", ThreeFunctions={"Direct": direct, "Tangent": tangent, "Adjoint": adjoint})
    case.set("EvolutionError", ScalarSparseMatrix=1e-12)
    case.execute()
    return flat(case.get("Analysis")[-1])


def lorenz(seeds=5):
    programs = [
        ("Varda, trust region", "varda-da", by_varda),
        ("Varda, L-BFGS, without σ", "varda-da",
         lambda twin: by_varda(twin, minimizer="lbfgs", posterior=False, max_iterations=1000)),
        (f"DAPPER {version('dapper')}, Var4D", "dapper", by_dapper),
        (f"ADAO {version('adao')}, 4DVAR", "adao", by_adao),
        ("the same, adjoint at the state before a step", "adao", lambda twin: by_adao(twin, before=True)),
    ]
    for title, parts, steps, seen in (
        ("all 40 variables seen once, after 8 steps", 1, 8, np.arange(40)),
        ("every second variable seen after each of 8 steps", 8, 1, np.arange(0, 40, 2)),
    ):
        print(f"Lorenz-96: {title}; mean of {seeds} twins")
        twins = [Twin(seed, parts, steps, seen) for seed in range(seeds)]
        rows, first = [], None
        for name, package, by in programs:
            if package != "varda-da" and version(package) is None:
                print(f"{package} is not installed")
                continue
            if package == "dapper" and parts > 1:
                print(f"{name} sees one time of a window")
                continue
            found = []
            for twin in twins:
                with quiet():
                    x, seconds = timed(lambda: by(twin))
                j, end = twin.cost(x)
                found.append([j, np.mean((x - twin.truth) ** 2), np.mean((end - twin.end) ** 2), seconds])
            j, start, end, _ = np.mean(found, axis=0)
            seconds = np.median([row[3] for row in found])
            first = first or seconds
            shown = [f"{j:.3f}", f"{start**0.5:.3f}", f"{end**0.5:.3f}"]
            rows.append([name, *shown, f"{1e3 * seconds:.1f}", f"{seconds / first:.2f}"])
        table(["program", "J", "RMSE at the start", "RMSE at the end", "CPU ms", "over the first"], rows)


# A hose let go: stiffness and damping


TRUE_EI, TRUE_TIME = 0.30, 0.008  # N m², s
WRONG_EI, WRONG_TIME = 0.1, 0.02


def hose_by_varda():
    """The shipped scene; its state at the start is unknown beside the two constants."""
    result = varda.run("hose", set={
        "model.section.ei": [WRONG_EI, WRONG_EI],
        "model.damping.stiffness": WRONG_TIME,
        "estimate": {"ei": {"sigma": "80%", "together": True}, "damping_stiffness": {"sigma": "80%"}},
    })
    values = {one["name"]: (one["value"], one["sigma"]) for one in result.estimates}
    return values["ei"], values["damping_stiffness"], result.summary["chi2"]


class Chain:
    """The hose in MuJoCo: rigid links in a plane with springs and dampers between them, held at one end."""

    length, curvature, segments, frames = 0.6, 1.0, 24, 51

    def __init__(self, segments=24, step=0.001):
        import mujoco

        self.mujoco, self.segments, self.every = mujoco, segments, round(0.02 / step)
        size = self.length / segments
        mass = 0.35 * size
        inertia = mass * size**2 / 12
        inner, outer = "", ""
        for i in range(segments):
            place = 0.0 if i == 0 else size
            inner += (
                f'<body pos="{place} 0 0"><joint type="hinge" axis="0 -1 0"/>'
                f'<inertial pos="{size / 2} 0 0" mass="{mass}" diaginertia="1e-9 {inertia} {inertia}"/>'
            )
            outer = "</body>" + outer
        weight = '<inertial pos="0 0 0" mass="0.05" diaginertia="1e-9 1e-9 1e-9"/>'
        tip = f'<body pos="{size} 0 0">{weight}</body>'
        tangent, across = "0.7849 0.3660 0.5", "-0.42262 0.90631 0"
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.81"/><worldbody>'
            f'<body xyaxes="{tangent} {across}">{inner}{tip}{outer}</body></worldbody></mujoco>'
        )
        self.data = mujoco.MjData(self.model)
        # half a link between the clamp's face and the middle of the first: its joint is twice as stiff
        self.share = np.ones(segments)
        self.share[0] = 2.0
        self.size = size
        self.rest = self.curvature * size / self.share
        # links begin at the joints, the tip is the last body
        at = np.arange(1, 7) * segments // 6
        self.bodies = 2 + at
        rows = np.genfromtxt(RECORDING, delimiter=",", names=True)
        rows = rows[rows["time_s"] < 1.0001]
        places = np.stack([rows[name] for name in ("x_m", "y_m", "z_m")], axis=1)
        self.seen = places.reshape(self.frames, 6, 3)

    def set(self, ei, seconds):
        self.model.jnt_stiffness[:] = ei / self.size * self.share
        self.model.dof_damping[:] = seconds * self.model.jnt_stiffness
        self.model.qpos_spring[:] = self.rest

    def balance(self, q, force):
        """What is left of the moments at rest under a force at the tip."""
        data, model = self.data, self.model
        data.qpos[:], data.qvel[:] = q, 0.0
        data.xfrc_applied[-1, :3] = force
        self.mujoco.mj_forward(model, data)
        return data.qfrc_smooth.copy()

    def pulled(self, force):
        """Angles at rest under a force at the tip, by Newton's method with differences."""
        q = self.rest.copy()
        for part in (0.25, 0.5, 0.75, 1.0):
            for _ in range(30):
                left = self.balance(q, part * force)
                steps = 1e-6 * np.eye(len(q))
                matrix = np.array([(self.balance(q + d, part * force) - left) / 1e-6 for d in steps]).T
                move = np.linalg.solve(matrix, -left)
                q = q + move * min(1.0, 0.3 / np.max(np.abs(move)))
                if np.max(np.abs(move)) < 1e-9:
                    break
        return q

    def departures(self, ei, seconds, force):
        """(y − H) / σ of the run from rest under a force at the tip."""
        mujoco, model, data = self.mujoco, self.model, self.data
        self.set(ei, seconds)
        q = self.pulled(np.array([force[0] * 0.90631, force[0] * 0.42262, force[1]]))
        mujoco.mj_resetData(model, data)
        data.qpos[:] = q
        out = np.empty((self.frames, 6, 3))
        for frame in range(self.frames):
            mujoco.mj_kinematics(model, data)
            out[frame] = data.xpos[self.bodies]
            for _ in range(self.every):
                mujoco.mj_step(model, data)
        return ((self.seen - out) / 0.002).ravel()


def hose_by_mujoco(segments, step):
    """Two constants and the two components of the pull, by the optimizer of MuJoCo's system identification:
    Gauss-Newton (Levenberg-Marquardt) with finite differences."""
    from mujoco.sysid._src import optimize, parameter

    chain = Chain(segments, step)
    parameters = parameter.ParameterDict({
        "ei": parameter.Parameter("ei", np.log(WRONG_EI), np.log(0.01), np.log(10.0)),
        "time": parameter.Parameter("time", np.log(WRONG_TIME), np.log(1e-4), np.log(1.0)),
        "pull": parameter.Parameter("pull", [0.0, 1.0], [-5.0, -5.0], [5.0, 5.0]),
    })

    def residual(x, *_):
        # one vector, or several columns of a difference quotient
        columns = np.atleast_2d(np.asarray(x, dtype=float).T).reshape(-1, 4)
        rows = [chain.departures(np.exp(c[0]), np.exp(c[1]), c[2:]) for c in columns]
        return [np.array(rows).T if np.ndim(x) == 2 else rows[0]], None, None

    found, end = optimize.optimize(parameters, residual, optimizer="mujoco", verbose=False)
    x = np.ravel(end.x)
    jacobian = np.reshape(end.jac, (-1, 4))
    sigma = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    left = residual(x)[0][0]
    values = np.exp(x[:2])
    return (values[0], values[0] * sigma[0]), (values[1], values[1] * sigma[1]), left @ left / len(left)


RECORDING = Path(__file__).resolve().parents[2] / "varda" / "scenes" / "data" / "hose.csv"


def hose():
    programs = [("Varda, scene `hose`, 24 segments", "varda-da", hose_by_varda)]
    for segments, step in ((24, 0.001), (24, 0.00025)):
        title = f"MuJoCo {version('mujoco')}, {segments} links, {1e3 * step:g} ms"
        programs.append((title, "mujoco", partial(hose_by_mujoco, segments, step)))
    rows, first = [], None
    for name, package, by in programs:
        if package != "varda-da" and version(package) is None:
            print(f"{package} is not installed")
            continue
        with quiet():
            (ei, damping, chi2), seconds = timed(by)
        first = first or seconds
        rows.append([
            name,
            f"{ei[0]:.4f} ± {ei[1]:.4f}",
            f"{100 * (ei[0] / TRUE_EI - 1):+.2f} %",
            f"{1e3 * damping[0]:.3f} ± {1e3 * damping[1]:.3f}",
            f"{100 * (damping[0] / TRUE_TIME - 1):+.1f} %",
            f"{chi2:.3f}",
            f"{seconds:.2f}",
            f"{seconds / first:.2f}",
        ])
    table(["program", "EI, N m²", "error", "damping, ms", "error", "2J/m", "CPU s", "over the first"], rows)


if __name__ == "__main__":
    asked = sys.argv[1:] or ["overhead", "lorenz", "hose"]
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    versions = [f"{name} {version(name)}" for name in ("numpy", "scipy", "dapper", "adao", "mujoco")]
    print(f"Python {platform.python_version()}, varda_da {varda.__version__}, {', '.join(versions)}")
    for name in asked:
        globals()[name]()
