"""Refinement of rough poses: of trajectories, RGB-D sequences and photographs."""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from autonerf_lab import presets
from autonerf_lab.bundle_adjustment.adjustment import Adjusted, adjust
from autonerf_lab.bundle_adjustment.color import adjust_by_color
from autonerf_lab.bundle_adjustment.range_images import range_images
from autonerf_lab.data.dataset import COVARIANCE_KEY, Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import is_planar, rotation_angle

Views = TypeVar("Views", Trajectory, Dataset)
_TYPICAL_DEPTH = 2.0  # metres; images of unknown scale are scaled to this median depth


def refine_poses(
    views: Views,
    *,
    planar: bool | None = None,
    preset: str | presets.Preset | None = None,
    steps: int | None = None,
    seed: int = 0,
    progress: bool = True,
) -> Views:
    """Refine rough poses by bundle adjustment.

    **With depth.** All poses are adjusted at once, so that the surfaces and the brightness that overlapping images
    measured agree, and the relative motions of the rough poses are kept within their noise, which is estimated. Errors
    of up to about 30 cm and 5 degrees between images that overlap are corrected. No field is trained.

    **Colour alone.** A field is trained while its poses are refined (``refine_cameras``), coarse to fine.

    A trajectory keeps its first pose. The refined poses of a dataset have the mean position and orientation of the
    rough ones, because none is better known than another.

    Args:
        views: rough poses with images. Consecutive frames should be neighbours for the prior to be of use; others, like
            photographs in any order, are allowed.
        planar: move cameras in x, y and heading only, as those of a robot on a floor. None: if the rough poses differ
            in nothing else.
        preset: hyper-parameters of the field that is trained for colour alone.
        steps: number of training steps of this field instead of the preset's.
        seed: random seed; the same seed gives the same bits.
        progress: show a progress bar.

    Returns:
        The same views with refined poses, whose source is ``refined``; a trajectory keeps the rough ones, too.
        ``meta["refined_covariance"]`` holds the covariance of each pose: of x, y and heading, or of a translation and a
        rotation vector along the axes of the world; :func:`pose_deviations` reads it.

    Raises:
        DataError: too few views overlap, or the data is not consistent.

    Example::

        sequence = lab.load_dataset("rgbd_dataset_freiburg3_long_office_household")
        nerf = lab.fit(lab.refine_poses(sequence), "semantic-nerfacto-rgbd")
    """
    data = Dataset.from_trajectory(views) if isinstance(views, Trajectory) else views
    if len(data) < 2:
        raise DataError(f"{len(data)} view: poses are refined against other views; two or more are needed")
    data.check()
    planar = is_planar(data.poses) if planar is None else planar
    if data.depths is None:
        found = adjust_by_color(data, planar, preset, steps, seed, progress)
    else:
        found = _adjusted_by_depth(data, planar, np.random.default_rng(seed), progress)
    meta = {**views.meta, COVARIANCE_KEY: found.covariances.tolist()}
    if isinstance(views, Trajectory):
        first = views.poses[0] @ np.linalg.inv(found.poses[0])
        return replace(views.with_poses("refined", first @ found.poses), meta=meta)
    return replace(views, poses=with_mean(found.poses, views.poses), meta=meta, pose_source="refined")


def _adjusted_by_depth(data: Dataset, planar: bool, rng: np.random.Generator, progress: bool) -> Adjusted:
    """Adjust the poses of images with depth, in units in which their depth is that of a room."""
    assert data.depths is not None
    depth = np.concatenate([layer[layer > 0] for layer in data.depths])
    unit = 1.0 if data.metric or not len(depth) else float(np.median(depth)) / _TYPICAL_DEPTH
    poses = data.poses.copy()
    poses[:, :3, 3] /= unit
    images = range_images(replace(data, depths=[layer / np.float32(unit) for layer in data.depths]))
    found = adjust(images, poses, planar, rng, progress)
    found.poses[:, :3, 3] *= unit
    lengths = [unit] * 2 + [1.0] if planar else [unit] * 3 + [1.0] * 3
    return Adjusted(found.poses, found.covariances * np.outer(lengths, lengths))


def with_mean(poses: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Move (T, 4, 4) poses together, so that their mean position and orientation are those of the rough poses.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> rough = np.stack([planar_pose(0, 0, 0), planar_pose(2, 0, 0)])
        >>> moved = planar_pose(5, 5, 1.0) @ rough
        >>> bool(np.allclose(with_mean(moved, rough), rough))
        True
    """
    turn = Rotation.from_matrix(rough[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)).mean().as_matrix()
    together = np.eye(4)
    together[:3, :3] = turn
    together[:3, 3] = rough[:, :3, 3].mean(axis=0) - turn @ poses[:, :3, 3].mean(axis=0)
    return together @ poses


def pose_deviations(views: Trajectory | Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard deviations of refined poses: (T,) of the position, metres, and (T,) of the rotation, radians.

    They are the square roots of the traces of the covariances. With depth, these are calibrated on training apartments.
    A pose without depth depends on its neighbours in the sequence, and on nothing where these have none, either.

    Raises:
        DataError: the poses were not refined.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> meta = {"refined_covariance": [np.diag([9e-6, 16e-6, 4e-6]).tolist()]}
        >>> rgb = np.zeros((1, 2, 2, 3), np.uint8)
        >>> views = Trajectory(np.eye(4)[None], rgb, None, None, Intrinsics.from_fov(2, 2), meta, "refined")
        >>> position, rotation = pose_deviations(views)
        >>> position.round(4), rotation.round(4)
        (array([0.005]), array([0.002]))
    """
    stored = views.meta.get(COVARIANCE_KEY)
    if views.pose_source != "refined" or stored is None:
        raise DataError("these poses have no covariance: they were not refined; call refine_poses first")
    variances = np.einsum("tii->ti", np.array(stored))
    angles = 1 if variances.shape[1] == 3 else 3  # x, y, heading; or three translations and three rotations
    return np.sqrt(variances[:, :-angles].sum(axis=1)), np.sqrt(variances[:, -angles:].sum(axis=1))


def describe_refinement(rough: Trajectory, refined: Trajectory) -> str:
    """Return lines about the corrections and uncertainties of refined poses."""
    moved = np.linalg.norm(refined.poses[:, :3, 3] - rough.poses[:, :3, 3], axis=1)
    turned = np.degrees(rotation_angle(rough.poses, refined.poses))
    position, rotation = pose_deviations(refined)
    worst = int(position.argmax())
    lines = [
        f"corrections: {100 * np.median(moved):.1f} cm and {np.median(turned):.2f} degrees (median), "
        f"at most {100 * moved.max():.1f} cm and {turned.max():.2f} degrees",
        f"standard deviation: {1000 * np.median(position):.1f} mm and {np.degrees(np.median(rotation)):.2f} degrees "
        f"(median); least certain: frame {worst}, {1000 * position[worst]:.1f} mm",
    ]
    return "\n".join(lines)
