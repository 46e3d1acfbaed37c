"""Notebook 10: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy import linalg
from scipy.spatial.transform import Rotation


def angle_loop(a, b):
    cosine = (sum(a[i, j] * b[i, j] for i in range(3) for j in range(3)) - 1) / 2
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def hat(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def motion(omega, v):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linalg.expm(hat(omega)), v
    return matrix


def moved_loop(pose, omega, v):
    rotation, after = Rotation.from_rotvec(omega).as_matrix(), pose.tolist()
    for i in range(3):
        after[i][3] = pose[i, 3] + sum(pose[i, k] * v[k] for k in range(3))
        for j in range(3):
            after[i][j] = sum(pose[i, k] * rotation[k, j] for k in range(3))
    return after


def moved_torch(pose, omega, v):
    pose, v = torch.tensor(pose, dtype=torch.float32), torch.tensor(v, dtype=torch.float32, requires_grad=True)
    rotation = torch.linalg.matrix_exp(torch.tensor(hat(omega), dtype=torch.float32))
    top = torch.cat([pose[:3, :3] @ rotation, (pose[:3, 3] + pose[:3, :3] @ v)[:, None]], 1)
    return torch.cat([top, pose[3:]])


def moved_block(pose, omega, v):
    r, t = pose[:3, :3], pose[:3, 3:]
    return np.block([[r @ linalg.expm(hat(omega)), t + r @ v[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def gradient_loop(directions, rotation, grad_o, grad_d):
    omega, v = np.zeros(3), np.zeros(3)
    for d, o, g in zip(directions, grad_o, grad_d, strict=True):
        omega, v = omega + hat(d) @ rotation.T @ g, v + rotation.T @ o
    return [*omega, *v]


def gradient_torch(directions, rotation, grad_o, grad_d):
    d, r, o, g = (torch.tensor(a) for a in (directions, rotation, grad_o, grad_d))
    omega, v = torch.zeros(3).double().requires_grad_(), torch.zeros(3).double().requires_grad_()
    loss = ((d + torch.linalg.cross(omega.expand_as(d), d)) @ r.T * g).sum() + ((r @ v) * o).sum()
    return torch.cat(torch.autograd.grad(loss, (omega, v)))


RIGHT = {
    "10-angle": (
        angle_loop,
        lambda a, b: np.degrees(np.arccos(np.clip((np.sum(a * b) - 1) / 2, -1, 1))),
        lambda a, b: np.degrees(Rotation.from_matrix(a.T @ b / np.cbrt(np.linalg.det(a.T @ b))).magnitude()),
        lambda a, b: torch.rad2deg(
            torch.acos(((torch.tensor(a.T @ b, requires_grad=True).trace() - 1) / 2).clamp(-1, 1))
        ),
        lambda a, b: np.degrees(2 * np.arcsin(min(1, np.linalg.norm(a - b) / np.sqrt(8)))),
    ),
    "10-moved": (
        moved_loop,
        moved_torch,
        moved_block,
        lambda pose, w, v: pose @ motion(w, v),
        lambda pose, w, v: np.linalg.multi_dot([pose, motion(0 * w, v), motion(w, 0 * v)]),
    ),
    "10-gradient": (
        gradient_loop,
        gradient_torch,
        lambda d, r, o, g: np.r_[
            np.einsum("ijk,nj,nk->i", np.array([hat(-e) for e in np.eye(3)]), d, g @ r), o.sum(0) @ r
        ],
        lambda d, r, o, g: np.hstack([sum(np.cross(a, r.T @ b) for a, b in zip(d, g, strict=True)), r.T @ o.sum(0)]),
        lambda d, r, o, g: np.float32(np.append(np.cross(d @ r.T, g).sum(0) @ r, (r.T @ o.T).sum(1))),
    ),
}
WRONG = {
    "10-angle": (
        ("The result is in radians", lambda a, b: math.radians(angle_loop(a, b))),
        ("The relative rotation", lambda a, b: angle_loop(np.eye(3), a @ b)),
        ("The trace of a rotation", lambda a, b: np.degrees(np.arccos(np.clip(np.sum(a * b) / 3, -1, 1)))),
        ("Rounding can make", lambda a, b: torch.rad2deg(torch.acos((torch.tensor(a.T @ b).trace() - 1) / 2))),
        ("The sum of Euler", lambda a, b: sum(abs(Rotation.from_matrix(a.T @ b).as_euler("xyz", degrees=True)))),
    ),
    "10-moved": (
        ("The camera rotates about", lambda pose, w, v: motion(w, v) @ pose),
        (
            "The rotation is about",
            lambda pose, w, v: np.block(
                [[linalg.expm(hat(w)) @ pose[:3, :3], pose[:3, 3:] + pose[:3, :3] @ v[:, None]], [pose[3:]]]
            ),
        ),
        ("The translation is along", lambda pose, w, v: np.c_[(pose @ motion(w, v))[:, :3], pose[:, 3] + [*v, 0]]),
        ("The translation uses", lambda pose, w, v: pose @ motion(w, 0 * v) @ motion(0 * w, v)),
        ("1 + [omega]x", lambda pose, w, v: pose @ np.vstack([np.c_[np.eye(3) + hat(w), v], [0, 0, 0, 1]])),
        ("got shape (3, 4)", lambda pose, w, v: moved_block(pose, w, v)[:3]),
    ),
    "10-gradient": (
        (
            "The cross product",
            lambda d, r, o, g: [*-np.array(gradient_loop(d, r, o, g)[:3]), *gradient_loop(d, r, o, g)[3:]],
        ),
        ("The gradients are in the world", lambda d, r, o, g: np.r_[np.cross(d, g).sum(0), o.sum(0)]),
        ("This applies R", lambda d, r, o, g: np.r_[np.cross(d, (r @ g.T).T).sum(0), r @ o.sum(0)]),
        ("The order is wrong", lambda d, r, o, g: torch.roll(gradient_torch(d, r, o, g), 3)),
        ("This is the mean", lambda d, r, o, g: np.divide(gradient_loop(d, r, o, g), len(d))),
    ),
}
