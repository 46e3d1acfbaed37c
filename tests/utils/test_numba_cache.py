"""Where numba keeps compiled kernels if the package and the user's cache are read-only."""

import os
import subprocess
import sys

from autonerf_lab.utils import numba_cache

CODE = """
import pathlib, sys, tempfile
from autonerf_lab.utils import numba_cache
numba_cache._PACKAGE = pathlib.Path("/proc")  # not writable, for root neither
tempfile.tempdir = sys.argv[1]
numba_cache.set_numba_cache()
import numba
print(numba.config.CACHE_DIR)
"""


def cache_of(folder, **changes):
    env = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"} | changes
    found = subprocess.run(
        [sys.executable, "-c", CODE, str(folder)], env=env, capture_output=True, text=True, check=True
    )
    return found.stdout.strip()


def test_kernels_go_to_a_private_temporary_folder_only_if_there_is_no_other(tmp_path):
    nowhere = {"HOME": "/proc/nowhere", "XDG_CACHE_HOME": "/proc/nowhere"}
    used = cache_of(tmp_path, **nowhere)
    assert used == str(numba_cache.private_folder(tmp_path)) and os.stat(used).st_mode & 0o777 == 0o700
    assert cache_of(tmp_path, **nowhere | {"NUMBA_CACHE_DIR": "/else"}) == "/else"
    assert cache_of(tmp_path, **nowhere | {"XDG_CACHE_HOME": str(tmp_path / "cache")}) == ""


def test_a_folder_that_others_can_write_is_not_used(tmp_path):
    folder = numba_cache.private_folder(tmp_path)
    folder.chmod(0o777)
    assert numba_cache.private_folder(tmp_path) != folder
    folder.rmdir()
    folder.symlink_to("/proc")
    assert numba_cache.private_folder(tmp_path) != folder
