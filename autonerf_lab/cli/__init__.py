"""The command line ``autonerf-lab``."""

from autonerf_lab.cli.main import main

__all__ = ["main"]
