#!/usr/bin/env python3
"""Makes truth.txt, estimate.txt and golden.txt: a drive of 1 km, a noisy estimate of it, and the
errors of the second against the first, computed with numpy from the definitions alone.

    python3 make_golden.py        (numpy; written again, the files come out the same)
"""
import pathlib

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
rng = np.random.default_rng(20240917)


def rotation(axis_angle):
    angle = np.linalg.norm(axis_angle)
    if angle == 0:
        return np.eye(3)
    x, y, z = axis_angle / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def quaternion(r):  # x y z w, by the eigenvector of the symmetric form
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]]) / 3
    _, vectors = np.linalg.eigh(k)
    q = vectors[:, -1]
    return -q if q[3] < 0 else q


def from_quaternion(q):
    x, y, z, w = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def pose(r, t):
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = r, t
    return m


def write(path, times, poses):
    with open(path, "w") as out:
        out.write("# timestamp tx ty tz qx qy qz qw\n")
        for time, m in zip(times, poses):
            values = list(m[:3, 3]) + list(quaternion(m[:3, :3]))
            out.write(f"{time:.6f} " + " ".join(f"{v:.7f}" for v in values) + "\n")


def read(path):
    rows = np.loadtxt(path)
    return rows[:, 0], [pose(from_quaternion(r[4:]), r[1:4]) for r in rows]


def make_files():
    n = 320
    times = 1000.0 + 0.1 * np.arange(n)
    m, truth = np.eye(4), []
    for i in range(n):
        truth.append(m)
        turn = np.array([0.002 * np.cos(i / 9), 0.04 * np.sin(i / 25), 0.003 * np.sin(i / 13)])
        m = m @ pose(rotation(turn), [0, 0, 3.2 + 0.6 * np.sin(i / 17)])
    world = pose(rotation(np.array([0.3, -1.1, 0.4])), [12.0, -3.0, 5.0])
    m, estimate = np.eye(4), []
    for i in range(n):
        estimate.append(world @ m)
        if i + 1 < n:
            step = np.linalg.inv(truth[i]) @ truth[i + 1]
            step = step @ pose(rotation(rng.normal(0, 0.0015, 3)), rng.normal(0, 0.02, 3))
            step[:3, 3] *= 0.97
            m = m @ step
    kept = [i for i in range(n) if i % 37 != 5 and not 200 <= i < 209]
    shift = rng.uniform(-0.009, 0.009, n)
    write(HERE / "truth.txt", times, truth)
    write(HERE / "estimate.txt", [times[i] + shift[i] for i in kept], [estimate[i] for i in kept])


def associate(a, b, limit=0.02):  # by brute force; steps are 0.1 s, so there is one candidate
    pairs = []
    for i, t in enumerate(a):
        j = int(np.argmin(np.abs(b - t)))
        if abs(b[j] - t) <= limit:
            pairs.append((i, j))
    return pairs


def umeyama(x, y, with_scale):  # S with y ~ S x
    mx, my = x.mean(0), y.mean(0)
    c = (y - my).T @ (x - mx) / len(x)
    u, d, vt = np.linalg.svd(c)
    f = np.diag([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    r = u @ f @ vt
    s = np.trace(np.diag(d) @ f) / ((x - mx) ** 2).sum(1).mean() if with_scale else 1.0
    return s, r, my - s * r @ mx


def summary(name, values):
    v = np.asarray(values)
    figures = {"rmse": np.sqrt((v ** 2).mean()), "mean": v.mean(), "median": np.median(v),
               "std": v.std(), "min": v.min(), "max": v.max(), "count": len(v)}
    return [f"{name}.{k} {float(x):.12g}" for k, x in figures.items()]


def error(q, p, i, j):
    e = np.linalg.inv(np.linalg.inv(q[i]) @ q[j]) @ (np.linalg.inv(p[i]) @ p[j])
    cosine = np.clip((np.trace(e[:3, :3]) - 1) / 2, -1, 1)
    return np.linalg.norm(e[:3, 3]), np.degrees(np.arccos(cosine))


def rpe(name, q, p, pairs):
    errors = np.array([error(q, p, i, j) for i, j in pairs])
    return summary(name + ".translation", errors[:, 0]) + summary(name + ".rotation", errors[:, 1])


def nearest(at, delta, i, tolerance=0.1):
    off = [abs(at[j] - at[i] - delta) for j in range(i + 1, len(at))]
    if not off or min(off) > tolerance * delta:
        return None
    return i + 1 + int(np.argmin(off))


def knots(path_steps, delta):
    found, total = [], 0.0
    for k, step in enumerate(path_steps, 1):
        total += step
        if total >= delta:
            found.append(k)
            total = 0.0
    return list(zip(found[:-1], found[1:]))


def kitti(q, p):
    steps = [np.linalg.norm(q[i][:3, 3] - q[i - 1][:3, 3]) for i in range(1, len(q))]
    distance = np.concatenate([[0], np.cumsum(steps)])
    t, r = [], []
    for i in range(0, len(q), 10):
        for length in range(100, 801, 100):
            later = [j for j in range(i, len(q)) if distance[j] > distance[i] + length]
            if not later:
                continue
            a, b = error(q, p, i, later[0])
            t.append(a / length * 100)
            r.append(b / length * 100)
    return [f"kitti.translation {np.mean(t):.12g}", f"kitti.rotation {np.mean(r):.12g}",
            f"kitti.count {len(t)}"]


def golden():
    times_q, all_q = read(HERE / "truth.txt")
    times_p, all_p = read(HERE / "estimate.txt")
    pairs = associate(times_q, times_p)
    q, p = [all_q[i] for i, _ in pairs], [all_p[j] for _, j in pairs]
    times = [times_p[j] for _, j in pairs]
    x, y = np.array([m[:3, 3] for m in p]), np.array([m[:3, 3] for m in q])
    lines = [f"pairs {len(pairs)}"]
    for name, with_scale in (("se3", False), ("sim3", True)):
        s, r, t = umeyama(x, y, with_scale)
        lines += summary("ate." + name, np.linalg.norm(s * x @ r.T + t - y, axis=1))
        lines.append(f"ate.{name}.scale {s:.12g}")
    lines += summary("ate.none", np.linalg.norm(x - y, axis=1))
    n = len(q)
    lines += rpe("rpe.1f", q, p, [(i, i + 1) for i in range(n - 1)])
    lines += rpe("rpe.7f", q, p, [(i, i + 7) for i in range(0, n - 7, 7)])
    lines += rpe("rpe.7f_all", q, p, [(i, i + 7) for i in range(n - 7)])
    by_time = [(i, nearest(times, 1.0, i)) for i in range(n)]
    lines += rpe("rpe.1s_all", q, p, [(i, j) for i, j in by_time if j is not None])
    steps_p = np.linalg.norm(np.diff(x, axis=0), axis=1)
    steps_q = np.linalg.norm(np.diff(y, axis=0), axis=1)
    lines += rpe("rpe.20m", q, p, knots(steps_p, 20.0))
    lines += rpe("rpe.20m_truth", q, p, knots(steps_q, 20.0))
    path = np.concatenate([[0], np.cumsum(steps_p)])
    by_path = [(i, nearest(path, 20.0, i)) for i in range(n)]
    lines += rpe("rpe.20m_all", q, p, [(i, j) for i, j in by_path if j is not None])
    lines += kitti(q, p)
    (HERE / "golden.txt").write_text("\n".join(lines) + "\n")


make_files()
golden()
