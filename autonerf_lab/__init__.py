"""AutoNeRF Lab: a robot explores an apartment, a semantic NeRF learns it, and the field is put to work.

The names below are the first lesson. They load on first use, so that importing a submodule never pulls in the rest.
Importing the package registers its Gymnasium environments, by name only.
"""

import os
from importlib import import_module

import autonerf_lab.envs  # noqa: F401

# open3d and embreex bring a TBB that is too old for numba: it would be found first, warned of, and passed over.
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")
# Threads that wait should sleep, not spin: a spinning thread takes the core of the one it waits for. Two
# trainings at once on two cores are over twice as fast, one alone is as fast. Torch's OpenMP reads this when it loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_HOME = {
    "Scene": "autonerf_lab.scenes",
    "generate_apartment": "autonerf_lab.scenes",
    "load_scene": "autonerf_lab.scenes",
    "import_scene": "autonerf_lab.scenes",
    "Simulator": "autonerf_lab.simulator",
    "Dataset": "autonerf_lab.data.dataset",
    "Trajectory": "autonerf_lab.data.trajectory",
    "explore": "autonerf_lab.exploration",
    "load_trajectory": "autonerf_lab.data.trajectory",
    "load_dataset": "autonerf_lab.data.dataset",
    "fit": "autonerf_lab.nerf",
    "load_nerf": "autonerf_lab.nerf",
    "evaluate": "autonerf_lab.evaluators",
    "extract_mesh": "autonerf_lab.evaluators",
    "play": "autonerf_lab.viz.player.player",
    "preset": "autonerf_lab.config",
}

__version__ = "0.1.0"
__all__ = list(_HOME)


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'autonerf_lab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
