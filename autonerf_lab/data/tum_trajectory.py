"""Trajectories in the text format of TUM RGB-D, which evo and most SLAM tools read."""

from pathlib import Path
from typing import TYPE_CHECKING

from scipy.spatial.transform import Rotation

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import OPENCV_AXES
from autonerf_lab.utils.storage import write_bytes

if TYPE_CHECKING:
    from autonerf_lab.data.dataset import Dataset


def export_tum(trajectory: "Trajectory | Dataset", path: str | Path) -> Path:
    """Write the poses as lines ``time x y z qx qy qz qw``: OpenCV camera axes (z forward) in the world frame, metres.

    Args:
        trajectory: the time stamps of a TUM sequence are kept; otherwise the time is the number of the frame.
        path: the text file.

    Returns:
        The path.

    Raises:
        DataError: there is no pose, or the file cannot be written.

    Example:
        >>> import tempfile
        >>> import numpy as np
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> rgb = np.zeros((1, 4, 4, 3), np.uint8)
        >>> trajectory = Trajectory(planar_pose(1, 2, 0)[None], rgb, None, None, Intrinsics.from_fov(4, 4))
        >>> print(export_tum(trajectory, tempfile.mkdtemp() + "/t.txt").read_text().splitlines()[1])
        0.000000 1.000000000 2.000000000 0.880000000 -0.500000000 0.500000000 -0.500000000 0.500000000
    """
    path = Path(path)
    if not len(trajectory):
        raise DataError(f"{path}: a trajectory without poses cannot be written")
    stamps = trajectory.meta.get("time_stamps")
    times = stamps if isinstance(stamps, list) and len(stamps) == len(trajectory) else range(len(trajectory))
    lines = ["# time x y z qx qy qz qw"]
    for time, pose in zip(times, trajectory.poses, strict=True):
        quaternion = Rotation.from_matrix((pose @ OPENCV_AXES)[:3, :3]).as_quat(canonical=True)
        lines.append(f"{float(time):.6f} " + " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *quaternion)))
    write_bytes(path, ("\n".join(lines) + "\n").encode())
    return path
