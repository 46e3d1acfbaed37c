"""Benchmark: grids of runs, result tables and statistics."""

from autonerf_lab.benchmark.grid import Cell, Grid, paper_grid
from autonerf_lab.benchmark.results import Outcome, Results, load_results
from autonerf_lab.benchmark.run import run_grid

__all__ = ["Cell", "Grid", "Outcome", "Results", "load_results", "paper_grid", "run_grid"]
