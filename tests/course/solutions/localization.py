"""Notebook 14: right answers in other styles, wrong ones with the start of the hint that they get."""

import cmath
import math

import numpy as np
import torch


def turned(heading):
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


def after_math(pose, motion):
    x, y, a = pose
    f, left, turn = motion
    return [x + f * math.cos(a) - left * math.sin(a), y + f * math.sin(a) + left * math.cos(a), a + turn]


def after_complex(pose, motion):
    z = complex(*pose[:2]) + cmath.exp(1j * pose[2]) * complex(*motion[:2])
    return z.real, z.imag, pose[2] + motion[2]


def after_homogeneous(pose, motion):
    frame = np.block([[turned(pose[2]), pose[:2, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    return np.append((frame @ [motion[0], motion[1], 1])[:2], pose[2] + motion[2])


def after_torch(pose, motion):
    pose, motion = torch.tensor(pose, requires_grad=True), torch.tensor(motion)
    c, s = torch.cos(pose[2]), torch.sin(pose[2])
    return pose + torch.stack([c * motion[0] - s * motion[1], s * motion[0] + c * motion[1], motion[2]])


def row_differences(normal, point, position):
    def distance(x, y, a):
        return normal @ (turned(a) @ (point - position) + position + [x, y])

    return [(distance(*h) - distance(*-h)) / 2e-6 for h in 1e-6 * np.eye(3)]


def row_torch(normal, point, position):
    normal, offset = torch.tensor(normal), torch.tensor(point - position)
    return torch.cat([normal, (offset[0] * normal[1] - offset[1] * normal[0])[None]])


def row_perpendicular(normal, point, position):
    return np.append(normal, normal @ (turned(np.pi / 2) @ (point - position)))


def row_cross(normal, point, position):
    return np.r_[normal, np.cross(np.append(point - position, 0), np.append(normal, 0))[2]]


def step_square_root(j, r, w):
    return np.linalg.lstsq(np.sqrt(w)[:, None] * j, -np.sqrt(w) * r, rcond=None)[0]


def step_loop(j, r, w):
    k = j.shape[1]
    h, g = np.zeros((k, k)), np.zeros(k)
    for a, b, c in zip(j, r, w, strict=True):
        h += c * np.outer(a, a)
        g += c * b * a
    return -np.linalg.inv(h) @ g


def step_torch(j, r, w):
    j, r, w = map(torch.tensor, (j, r, w))
    return torch.linalg.solve(j.T @ torch.diag(w) @ j, -(j.T @ (w * r)))


RIGHT = {
    "14-after": (
        after_math,
        after_complex,
        after_homogeneous,
        after_torch,
        lambda p, m: np.hstack([p[:2] + turned(p[2]) @ m[:2], p[2] + m[2]]),
    ),
    "14-row": (
        row_differences,
        row_torch,
        row_perpendicular,
        row_cross,
        lambda n, p, t: (*n, np.linalg.det([p - t, n])),
    ),
    "14-step": (
        step_square_root,
        step_loop,
        step_torch,
        lambda j, r, w: -np.linalg.pinv(j.T @ np.diag(w) @ j) @ j.T @ np.diag(w) @ r,
        lambda j, r, w: np.linalg.solve(np.einsum("na,n,nb->ab", j, w, j), -np.einsum("na,n,n->a", j, w, r)),
    ),
}
WRONG = {
    "14-after": (
        ("The motion is in the frame", np.add),
        ("The robot turns at the end", lambda p, m: np.r_[p[:2] + turned(p[2] + m[2]) @ m[:2], p[2] + m[2]]),
        ("The rotation has the wrong sign", lambda p, m: np.r_[p[:2] + turned(-p[2]) @ m[:2], p[2] + m[2]]),
        ("Left has the wrong sign", lambda p, m: after_math(p, [m[0], -m[1], m[2]])),
        ("expected [1.25", lambda p, m: after_math(p, m)[:2]),
    ),
    "14-row": (
        ("The robot turns about itself", lambda n, p, t: np.append(n, p[0] * n[1] - p[1] * n[0])),
        ("The heading has the wrong sign", lambda n, p, t: np.append(n, np.linalg.det([n, p - t]))),
        ("The seen point moves with the robot", lambda n, p, t: row_torch(n, p, t) * torch.tensor([-1, -1, 1])),
        ("The entry of the heading is missing", lambda n, p, t: [*n, 0.0]),
    ),
    "14-step": (
        ("The sign is wrong", lambda j, r, w: -step_loop(j, r, w)),
        ("The weights are missing", lambda j, r, w: np.linalg.lstsq(j, -r, rcond=None)[0]),
        ("This is the negative gradient", lambda j, r, w: -(j * w[:, None]).T @ r),
        ("The weights are squared", lambda j, r, w: np.linalg.lstsq(w[:, None] * j, -w * r, rcond=None)[0]),
    ),
}
