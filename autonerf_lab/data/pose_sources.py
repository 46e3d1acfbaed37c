"""Pose sources of a trajectory: true, measured by odometry, estimated online, refined by bundle adjustment.

They are stored in ``transforms.json`` under the key ``autonerf_lab``: ``pose_source`` names the source of the
``transform_matrix`` of the frames, and ``other_poses`` holds those of the other sources.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from autonerf_lab.data.transforms import read_rigid_pose
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import planar_pose

POSE_SOURCES = ("true", "odometry", "estimated", "refined")


def check_source(name: str, known: Iterable[str] = POSE_SOURCES) -> str:
    """Return the name of a pose source.

    Args:
        name: one of :data:`POSE_SOURCES`.
        known: the sources that exist where the name is used.

    Raises:
        UnknownNameError: there is no pose source of that name.
        DataError: the source exists, but not in ``known``.

    Example:
        >>> check_source("refined", ["true", "odometry"])
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: there are no 'refined' poses, only true, odometry
    """
    known = list(known)
    if name not in POSE_SOURCES:
        raise UnknownNameError("pose source", name, known)
    if name not in known:
        raise DataError(f"there are no {name!r} poses, only {', '.join(known)}")
    return name


def sources_to_json(active: str, others: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the entries of ``transforms.json``; none for a trajectory that has only its true poses.

    Example:
        >>> sources_to_json("true", {}), sources_to_json("refined", {})
        ({}, {'pose_source': 'refined'})
    """
    entries: dict[str, Any] = {} if active == "true" and not others else {"pose_source": active}
    return entries | ({"other_poses": {name: poses.tolist() for name, poses in others.items()}} if others else {})


def read_sources(meta: dict[str, Any], count: int, where: object) -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
    """Read the pose sources of a trajectory.

    Args:
        meta: content of the key ``autonerf_lab``. Release 0.1 stored the true poses of a noisy trajectory as
            ``true_poses``, x, y and heading.
        count: number of frames.
        where: file, for messages.

    Returns:
        Name of the active source; (T, 4, 4) poses of the others by name; metadata without these entries.

    Raises:
        DataError: an entry is not valid.
    """
    rest = {key: value for key, value in meta.items() if key not in ("pose_source", "other_poses", "true_poses")}
    active, stored, planar = (meta.get(key) for key in ("pose_source", "other_poses", "true_poses"))
    if active is None:
        active = "true" if planar is None else "odometry"
    if active not in POSE_SOURCES:
        names = ", ".join(POSE_SOURCES)
        raise DataError(f"{where}: 'pose_source' must be one of {names}, not {str(active)[:40]!r}")
    if not isinstance(stored, dict | None):
        raise DataError(f"{where}: 'other_poses' must be a JSON object")
    others = {}
    for name, matrices in (stored or {}).items():
        if name not in POSE_SOURCES or name == active:
            raise DataError(f"{where}: 'other_poses' has the entry {name[:40]!r}, which is not another pose source")
        entry = f"{where}: 'other_poses' {name!r}"
        if not isinstance(matrices, list) or len(matrices) != count:
            raise DataError(f"{entry} must be a list of {count} poses, one for each frame")
        others[name] = np.stack([read_rigid_pose(matrix, f"{entry}: frame {t}") for t, matrix in enumerate(matrices)])
    if planar is not None:
        others["true"] = _from_planar(planar, count, f"{where}: 'true_poses'")
    return active, others, rest


def _from_planar(rows: object, count: int, where: str) -> np.ndarray:
    try:
        values = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (count, 3) or not (np.abs(values) < 1e9).all():
        raise DataError(f"{where} must be {count} rows of x, y and heading")
    return np.stack([planar_pose(*row) for row in values])
