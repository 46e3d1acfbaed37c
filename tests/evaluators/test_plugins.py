"""Tasks of installed packages: found by name, scored, reported; a broken one is left out."""

from pathlib import Path

import pytest
import toy_scene
from installed_plugins import Site, install_example, run_example_tests

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.evaluators import TASKS, Metric, Scores, Task, TaskResult, TrueField, available, evaluate
from autonerf_lab.evaluators.conformance import check_run
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.tasks import metric_of, optional_tasks, run_task
from autonerf_lab.pipeline.figures import draw_scores
from autonerf_lab.pipeline.report import render
from autonerf_lab.pipeline.run_folder import RunConfig, open_run
from autonerf_lab.presets import preset
from autonerf_lab.types import Score
from autonerf_lab.utils.plugins import PluginWarning

GOOD = """
from autonerf_lab.evaluators import Metric, Task, TaskResult
class Good(Task):
    name, title, text = "good", "Good", "Always one."
    metrics = (Metric("good", "one", "m", "One", 1),)
    def run(self, context):
        return TaskResult({"one": 1.0}, {"one": 1})
TASK = Good()
"""
BROKEN = {
    "missing import": ("import nobody_has_this", "ModuleNotFoundError: No module named 'nobody_has_this'"),
    "no task": ("TASK = 5", "it is a int, not a Task"),
    "a class": (GOOD.replace("TASK = Good()", "TASK = Good"), "not a Task"),
    "no metric": (GOOD.replace('(Metric("good", "one", "m", "One", 1),)', "()"), "needs at least one Metric"),
    "metric of another task": (GOOD.replace('Metric("good"', 'Metric("maps"'), "belongs to task 'maps', not 'good'"),
    "no text": (GOOD.replace('"Always one."', '""'), "text of a task must be a text"),
}


class Toy(Task):
    """One value, or none."""

    name, title, text = "toy", "Toy", "A toy."
    metrics = (Metric("toy", "value", "m", "Value of the toy", -1, 1, 100.0),)

    def __init__(self, values=None):
        self.values = {"value": 0.25} if values is None else values

    def run(self, context):
        return TaskResult(self.values, {"value": 3})


@pytest.fixture(scope="module")
def context() -> EvaluationContext:
    scene = toy_scene.two_rooms()
    return EvaluationContext(TrueField(scene, views=1), scene, preset("smoke"))


def test_the_example_is_scored_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = install_example("evaluator_plugin", tmp_path)
    monkeypatch.syspath_prepend(target)
    assert list(available()) == [*TASKS, "depth_by_distance"] and "depth_by_distance" in optional_tasks()

    scene = toy_scene.two_rooms()
    field = TrueField(scene, views=1)
    scores = evaluate(field, scene, "smoke", tasks=["depth_by_distance"], progress=False)
    assert scores["depth_by_distance", "rmse_near_m"] == 0

    run = open_run(tmp_path / "run", RunConfig("toy", "f00d", "frontier", "smoke", 0, "semantic-nerfacto"))
    scores.save(run / "scores.json")
    draw_scores(run / "figures", field, scene, scores.artifacts)
    page = render(run)
    for text in ("Depth error by distance", "in three bands of distance", "Depth RMSE, 0 to 2 m", "Bar chart of the"):
        assert text in page


def test_the_test_of_the_example_passes(tmp_path: Path) -> None:
    assert "1 passed" in run_example_tests("evaluator_plugin", tmp_path)


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_task_is_left_out_with_a_warning(site: Site, kind: str) -> None:
    code, reason = BROKEN[kind]
    site.install("bad-task", "bad", code, "TASK", "evaluators")
    site.install("good-task", "good", GOOD, "TASK", "evaluators")
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert list(found) == [*TASKS, "good"]
    (message,) = [str(warning.message) for warning in caught]
    assert "'bad'" in message and reason in message


def test_an_unknown_task_lists_those_of_installed_packages(site: Site, context: EvaluationContext) -> None:
    site.install("good-task", "good", GOOD, "TASK", "evaluators")
    with pytest.raises(UnknownNameError, match="good"):
        evaluate(context.field, context.scene, "smoke", tasks=["god"], progress=False)
    scores = evaluate(context.field, context.scene, "smoke", tasks=["good"], progress=False)
    assert scores["good", "one"] == 1.0 and metric_of(scores[0]).label == "One"
    assert metric_of(Score("gone", "some_value", 1.0, "m")).label == "some value"


@pytest.mark.parametrize(
    ("values", "rule"),
    [({}, "lacks the metric 'value'"), ({"value": 1}, "must be a float or None"), ({"value": None}, "needs a status")],
)
def test_results_of_a_task_are_checked(context: EvaluationContext, values: dict, rule: str) -> None:
    with pytest.raises(AssertionError, match=rule):
        check_run(Toy(values), context)
    assert check_run(Toy(), context).values == {"value": 0.25}


def test_a_task_without_its_values_has_rows_that_give_the_reason(context: EvaluationContext) -> None:
    (row,), _ = run_task(context, Toy({}))
    assert row.value is None and row.status == "failed: ValueError: task 'toy' returned no value for value"
    (row,), _ = run_task(context, Toy())
    assert (row.value, row.unit, row.n, row.task) == (0.25, "m", 3, "toy")
    assert Scores([row])["toy", "value"] == 0.25
