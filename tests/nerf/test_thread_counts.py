"""Fields have the same bits with 1, 2 and 4 threads: no sum and no rounding depends on the division of the work."""

import os
import subprocess
import sys

CODE = """
import hashlib
from dataclasses import replace

import numba
import numpy as np
from toy_scene import two_rooms

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import fit, model_spec
from autonerf_lab.nerf.ray_batch import to_numpy
from autonerf_lab.simulator import Simulator

camera = Intrinsics.from_fov(24, 24)
sim, rng = Simulator(two_rooms(), camera, supersample=1), np.random.default_rng(0)
poses = np.stack([sim.sample_pose(rng) for _ in range(12)])
frames = [sim.render(pose) for pose in poses]
layers = (np.stack([getattr(f, k) for f in frames]) for k in ("rgb", "depth", "semantics"))
trajectory = Trajectory(poses, *layers, camera, {"scene": "toy"})
for name in ("semantic-nerfacto", "semantic-nerfacto-rgbd", "instant-ngp"):
    settings = replace(model_spec(name).settings["smoke"], steps=20)
    for threads in (1, 2, 4):
        numba.set_num_threads(threads)
        field = fit(trajectory, name, preset="smoke", settings=settings, progress=False)
        digest = hashlib.sha256()
        for value in (*field.model.parameters.values(), field.render(poses[0]).rgb, field.render(poses[0]).depth):
            digest.update(to_numpy(value).tobytes())
        print(name, digest.hexdigest())
"""


def test_fields_do_not_depend_on_the_number_of_threads() -> None:
    result = subprocess.run(
        [sys.executable, "-c", CODE],
        env={**os.environ, "NUMBA_NUM_THREADS": "4", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert len(lines) == 9 and len({*lines}) == 3, result.stdout
