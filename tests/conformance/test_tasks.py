"""Every built-in evaluation task passes the checks that a plug-in must pass."""

import pytest

from autonerf_lab.evaluators import TASKS, Task
from autonerf_lab.evaluators.conformance import check_task


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_built_in_tasks_conform(task: Task) -> None:
    check_task(task)
