"""Fields have the same bits with any number of threads and in any order of loading the compiled kernels."""

import os
import subprocess
import sys

FIT = """
import hashlib
import sys
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
    for threads in map(int, sys.argv[1:]):
        numba.set_num_threads(threads)
        field = fit(trajectory, name, preset="smoke", settings=settings, progress=False)
        digest = hashlib.sha256()
        for value in (*field.model.parameters.values(), field.render(poses[0]).rgb, field.render(poses[0]).depth):
            digest.update(to_numpy(value).tobytes())
        print(name, digest.hexdigest())
"""


# Loads the compiled functions that are in numba's cache, those that other kernels call before their callers.
LOAD = """
import importlib, pkgutil
from numba.core.registry import CPUDispatcher
from autonerf_lab.nerf import kernels

loaded = 0
for module in pkgutil.iter_modules(kernels.__path__, kernels.__name__ + "."):
    for function in list(vars(importlib.import_module(module.name)).values()):
        if isinstance(function, CPUDispatcher) and hasattr(function._cache, "_cache_file"):
            for signature, _, _ in list(function._cache._cache_file._load_index()):
                function.compile(signature)
                loaded += 1
assert loaded > 20, loaded
"""


def digests(code: str, *threads: int) -> list[str]:
    """Fit three models with each number of threads in a new process; return a line per model and number."""
    result = subprocess.run(
        [sys.executable, "-c", code, *map(str, threads)],
        env={**os.environ, "NUMBA_NUM_THREADS": "4", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


def test_fields_do_not_depend_on_the_number_of_threads_nor_on_the_order_of_loading() -> None:
    lines = digests(FIT, 1, 2, 4)
    assert len(lines) == 9 and len({*lines}) == 3, lines
    assert digests(LOAD + FIT, 1) == lines[::3], "the first process has filled the cache"
