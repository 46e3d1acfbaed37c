"""Stages of the main job, the run folder they share, and its report."""

from autonerf_lab.pipeline.stages import (
    STAGE_FUNCTIONS,
    Options,
    Workspace,
    begin,
    check_names,
    find_scene,
    finished_field,
    finished_walk,
    resume,
    run_stages,
    summary,
)

__all__ = [
    "STAGE_FUNCTIONS",
    "Options",
    "Workspace",
    "begin",
    "check_names",
    "find_scene",
    "finished_field",
    "finished_walk",
    "resume",
    "run_stages",
    "summary",
]
