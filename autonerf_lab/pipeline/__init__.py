"""Stages of a run, the run folder and its report."""

from autonerf_lab.pipeline.context import StageContext, StageOptions, find_scene
from autonerf_lab.pipeline.run import (
    check_arguments,
    load_finished_field,
    load_finished_trajectory,
    run_pipeline,
    run_stage,
    score_table,
)

__all__ = [
    "StageContext",
    "StageOptions",
    "check_arguments",
    "find_scene",
    "load_finished_field",
    "load_finished_trajectory",
    "run_pipeline",
    "run_stage",
    "score_table",
]
