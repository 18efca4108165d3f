"""Recordings of the gallery's scenes, made by a program that shares nothing with Varda: explicit chains of point
masses with springs along them and E = EI/(2 l) sum |t(i) - t(i-1)|^2 of the directions t of the links for bending, of much
smaller elements and steps than the scenes have. Needs NumPy; writes the CSV files beside this folder."""
import math
import os

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
GRAVITY = np.array([0.0, 0.0, -9.81])
STRETCH_TIME = 2e-5  # s: damps waves along the chain


def bending(n, ei, l):
    """Matrix K of the forces of bending -K x of n vertices, where links are not stretched and turn little."""
    second = np.zeros((n - 2, n))
    for i in range(n - 2):
        second[i, i:i + 3] = [1, -2, 1]
    return ei / l**3 * second.T @ second


def bent(x, ei, l):
    """Forces of bending."""
    edge = x[1:] - x[:-1]
    length = np.linalg.norm(edge, axis=1)[:, None]
    t = edge / length
    neighbours = np.zeros_like(t)
    neighbours[:-1] += t[1:]
    neighbours[1:] += t[:-1]
    pull = -ei / l * (neighbours - np.einsum("ij,ij->i", t, neighbours)[:, None] * t) / length
    force = np.zeros_like(x)
    force[:-1] += pull
    force[1:] -= pull
    return force


def stretching(x, v, ea, l, tau):
    """Forces of the springs along the chain."""
    edge = x[1:] - x[:-1]
    length = np.linalg.norm(edge, axis=1)
    t = edge / length[:, None]
    rate = np.einsum("ij,ij->i", v[1:] - v[:-1], t)
    pull = (ea * ((length - l) / l + tau * rate / l))[:, None] * t
    force = np.zeros_like(x)
    force[:-1] += pull
    force[1:] -= pull
    return force


def turning(x, v, ei, l, tau):
    """What the force of damping of curvature, which does not see a chain turn as a whole, has beyond -tau K v."""
    d = x[:-2] - 2 * x[1:-1] + x[2:]
    across = x[2:] - x[:-2]
    length = np.linalg.norm(across, axis=1)[:, None]
    t = across / length
    rate = v[:-2] - 2 * v[1:-1] + v[2:]
    turned = t * np.einsum("ij,ij->i", d, v[2:] - v[:-2])[:, None] / length
    both = np.einsum("ij,ij->i", t, rate + turned)[:, None] * d / length
    force = np.zeros_like(x)
    force[:-2] -= turned - both
    force[1:-1] += 2 * turned
    force[2:] -= turned + both
    return ei * tau / l**3 * force


def run(x, v, mass, ei, ea, l, tau, alpha, held, seconds, dt, every, load=None):
    """Changes of bending and damping in a step implicit, the rest explicit; held(t) gives vertices, their places and velocities. Yields (t, x)."""
    k_bend = bending(len(x), ei, l)
    fixed = [vertex for vertex, _, _ in held(0.0)]
    free = [i for i in range(len(x)) if i not in fixed]
    step = np.diag(mass * (1 + dt * alpha)) + dt * (tau + dt) * k_bend
    inverse = np.linalg.inv(step[np.ix_(free, free)])
    steps = round(seconds / dt)
    for k in range(steps + 1):
        t = k * dt
        for vertex, place, velocity in held(t):
            x[vertex], v[vertex] = place, velocity
        if k % every == 0:
            yield t, x.copy()
        force = stretching(x, v, ea, l, STRETCH_TIME) + mass[:, None] * GRAVITY + bent(x, ei, l)
        if tau > 0:
            force += turning(x, v, ei, l, tau)
        if load is not None:
            force += load(t)
        right = mass[:, None] * v + dt * force - step[:, fixed] @ v[fixed] * (~np.isin(np.arange(len(x)), fixed))[:, None]
        v[free] = inverse @ right[free]
        x += dt * v


def settle(x, mass, ei, ea, l, held, dt, seconds=4.0, load=None):
    """At rest, by damping as much as the chain takes."""
    v = np.zeros_like(x)
    for _, last in run(x, v, mass, ei, ea, l, 0.0, 8.0, held, seconds, dt, 1000, load):
        pass
    return x


def write(name, header, rows):
    with open(os.path.join(HERE, "..", name), "w") as out:
        out.write(header + "\n")
        out.writelines(row + "\n" for row in rows)


def at(x, s, l, offset):
    """The place of arc length s; vertex i is at s = offset + i l. Cubic through four vertices."""
    u = (s - offset) / l
    i = min(max(int(u) - 1, 0), len(x) - 4)
    w = u - i
    c = [-(w - 1) * (w - 2) * (w - 3) / 6, w * (w - 2) * (w - 3) / 2, -w * (w - 1) * (w - 3) / 2, w * (w - 1) * (w - 2) / 6]
    return sum(c[j] * x[i + j] for j in range(4))


def cable_between_posts():
    """2 m of cable between posts 1.6 m apart, held aside by a wind of 0.6 N/m that ends at 0.2 s. 0.1 kg/m, EI 2e-3 N m2,
    mass-proportional damping 0.6 1/s. Six markers, 50 Hz, noise 2 mm; the fourth is lost for 0.4 s."""
    rng = np.random.default_rng(11)
    n, length, span, drop = 80, 2.0, 1.6, 0.2
    l, ei, ea, per_length = length / n, 2e-3, 500.0, 0.1
    mass = np.full(n + 1, per_length * l)
    mass[[0, -1]] /= 2
    a, b = np.zeros(3), np.array([span, 0.0, -drop])
    held = lambda t: [(0, a, np.zeros(3)), (n, b, np.zeros(3))]
    s = np.linspace(0, 1, n + 1)[:, None]
    x = a + s * (b - a) + np.array([0, 0, -1.6]) * s * (1 - s)
    wind = np.zeros((n + 1, 3))
    wind[1:-1] = [0.0, 0.6 * l, 0.0]
    dt = 1e-4
    x = settle(x, mass, ei, ea, l, held, dt, load=lambda t: wind)
    v = np.zeros_like(x)
    places = [0.3, 0.6, 0.9, 1.2, 1.5, 1.8]
    rows = []
    still = lambda t: wind if t < 0.2 else 0.0
    for t, shape in run(x, v, mass, ei, ea, l, 0.0, 0.6, held, 2.6, dt, 200, still):
        for i, s in enumerate(places):
            if i == 3 and 0.7 < t < 1.1:
                continue
            p = at(shape, s, l, 0.0) + rng.normal(0, 0.002, 3)
            rows.append(f"{t:.3f},c{i + 1},{p[0]:.5f},{p[1]:.5f},{p[2]:.5f}")
    write("cable-between-posts.csv", "time_s,marker,x_m,y_m,z_m", rows)


def quaternion(axis, angle):
    return np.array([*(np.sin(angle / 2) * np.asarray(axis)), np.cos(angle / 2)])


def times(p, q):
    (a, b, c, d), (e, f, g, h) = p, q
    return np.array([d * e + a * h + b * g - c * f, d * f - a * g + b * h + c * e, d * g + a * f - b * e + c * h,
                     d * h - a * e - b * f - c * g])


def turned(q, vector):
    x, y, z, w = q
    u = np.array([x, y, z])
    vector = np.asarray(vector, float)
    return vector + 2 * np.cross(u, np.cross(u, vector) + w * vector)


def tether_on_base():
    """0.7 m of tether hanging from a hand that moves and tilts; its poses are recorded. EI 0.02 N m2, 0.12 kg/m, strain-rate
    time 10 ms. Five markers and the poses at 100 Hz, noise 1.5 mm, 0.2 mm and 0.05 degrees."""
    rng = np.random.default_rng(12)
    n, length = 70, 0.7
    l = length / n
    ei, ea, per_length, tau = 0.02, 1000.0, 0.12, 0.01
    mass = np.full(n + 2, per_length * l)
    mass[-1] /= 2

    def pose(t):
        r = np.clip((t - 0.3) / 0.4, 0, 1)
        ramp = r * r * (3 - 2 * r)
        place = ramp * np.array([0.12 * np.sin(5.0 * t), 0.07 * np.sin(3.5 * t + 0.4), 0.03 * np.sin(6.0 * t)])
        tilt = times(quaternion([0, 1, 0], 0.35 * ramp * np.sin(4.2 * t)), quaternion([1, 0, 0], 0.2 * ramp * np.sin(5.7 * t)))
        return place, tilt

    def face(t):
        place, tilt = pose(t)
        along = turned(tilt, [0, 0, -1])
        return np.array([place - 0.5 * l * along, place + 0.5 * l * along])

    def held(t):
        e = 1e-6
        now, rate = face(t), (face(t + e) - face(t - e)) / (2 * e)
        return [(0, now[0], rate[0]), (1, now[1], rate[1])]

    x = np.array([[0.0, 0.0, 0.5 * l - l * i] for i in range(n + 2)])
    # vertex i at s = (i - 1/2) l; the last at L + l/2 would be too long: the chain ends at s = L
    x, mass = x[: n + 1], mass[: n + 1].copy()
    offset = -0.5 * l
    total = offset + n * l
    mass[-1] = per_length * (length - total + 0.5 * l)
    dt = 2e-5
    v = np.zeros_like(x)
    places = [0.14, 0.28, 0.42, 0.56, 0.69]
    rows, poses = [], []
    for t, shape in run(x, v, mass, ei, ea, l, tau, 0.0, held, 2.4, dt, 500):
        place, tilt = pose(t)
        place = place + rng.normal(0, 0.0002, 3)
        axis = rng.normal(0, math.radians(0.05), 3)
        angle = np.linalg.norm(axis)
        q = times(quaternion(axis / angle, angle), tilt)
        poses.append(f"{t:.3f}," + ",".join(f"{c:.6f}" for c in [*place, *q]))
        for i, s in enumerate(places):
            p = at(shape, s, l, offset) + rng.normal(0, 0.0015, 3)
            rows.append(f"{t:.3f},t{i + 1},{p[0]:.5f},{p[1]:.5f},{p[2]:.5f}")
    write("tether-on-base.csv", "time_s,marker,x_m,y_m,z_m", rows)
    write("tether-on-base-poses.csv", "time_s,x_m,y_m,z_m,qx,qy,qz,qw", poses)


def soft_arm():
    """A soft arm of 0.2 m, clamped level, held up by 0.8 N at its tip and let go at 0.1 s. Radius 15 mm, 1100 kg/m3, modulus 5e5
    Pa, strain-rate time 12 ms. Markers at 50, 100, 150 and 200 mm, 100 Hz, noise 1 mm."""
    rng = np.random.default_rng(13)
    n, length = 40, 0.2
    l = length / (n - 0.5)
    radius = 0.015
    area, inertia = math.pi * radius**2, math.pi * radius**4 / 4
    ei, ea, per_length = 5e5 * inertia, 5e5 * area, 1100 * area
    tau = 0.012
    offset = -0.5 * l
    mass = np.full(n + 1, per_length * l)
    mass[1] = per_length * l
    mass[-1] = per_length * l / 2
    x = np.array([[offset + i * l, 0.0, 0.0] for i in range(n + 1)])
    still = np.zeros(3)
    first, second = x[0].copy(), x[1].copy()
    held = lambda t: [(0, first, still), (1, second, still)]
    dt = 1e-5
    up = np.zeros((n + 1, 3))
    up[-1] = [0.0, 0.15, 0.8]
    x = settle(x, mass, ei, ea, l, held, dt, 2.0, lambda t: up)
    v = np.zeros_like(x)
    rows = []
    for t, shape in run(x, v, mass, ei, ea, l, tau, 0.0, held, 1.3, dt, 1000, lambda t: up if t < 0.1 else 0.0):
        for i, s in enumerate([0.05, 0.1, 0.15, 0.2]):
            p = at(shape, s, l, offset) + rng.normal(0, 0.001, 3)
            rows.append(f"{t:.3f},a{i + 1},{p[0]:.5f},{p[1]:.5f},{p[2]:.5f}")
    write("soft-arm.csv", "time_s,marker,x_m,y_m,z_m", rows)


if __name__ == "__main__":
    cable_between_posts()
    tether_on_base()
    soft_arm()
