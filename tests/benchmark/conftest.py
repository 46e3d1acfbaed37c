"""Environment of the worker processes: they must find the fake cells."""

import os

import pytest
from fake_grid import SUPPORT


@pytest.fixture(autouse=True)
def workers_find_the_fake_cells(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")]))
