"""Command line ``autonerf-lab``: one module per command."""

from autonerf_lab.cli.main import main

__all__ = ["main"]
