"""AutoNeRF Lab: explore an apartment, train a semantic NeRF on the trajectory, evaluate what a robot can do with it.

The public names are listed in ``__init__.pyi``, which type checkers and editors read, and load on first use. Importing
the package also registers its Gymnasium environments, by name only.
"""

import os

import lazy_loader

import autonerf_lab.envs  # noqa: F401 - registers the environments
from autonerf_lab.utils.numba_cache import set_numba_cache
from autonerf_lab.version import __version__ as __version__

# open3d and embreex bring a TBB that is too old for numba, which would find it first and warn.
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")
# Waiting threads sleep instead of spinning: a spinning thread takes the core of the thread it waits for. Two trainings
# at once on two cores are over twice as fast, one alone is as fast. Torch's OpenMP reads the variable when it loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# GNU OpenMP lets them spin for about 10 µs first: waking a thread for each small layer of a network doubles its time.
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
set_numba_cache()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
