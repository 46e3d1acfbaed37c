"""Task segmentation, and the fusion of the frames' labels in a point cloud."""

from dataclasses import replace

import numpy as np
import pytest
from toy_scene import to_scene, two_rooms

from autonerf_lab.data.dataset import Dataset, load_dataset
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import TrueField, evaluate
from autonerf_lab.evaluators.fused_labels import FusedLabels
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.exploration import explore
from autonerf_lab.presets import preset
from autonerf_lab.segmentation import NoisyLabels
from autonerf_lab.segmentation.metrics import class_scores, confusion_matrix
from autonerf_lab.simulator import Simulator
from autonerf_lab.viz import figures

SMALL = replace(preset("smoke"), test_poses=12)


@pytest.fixture(scope="module")
def scene():
    return to_scene(two_rooms())


@pytest.fixture(scope="module")
def noisy(scene) -> Trajectory:
    sim = Simulator.from_preset(scene, SMALL, semantics=NoisyLabels(confusion=0.3, boundary=1.0))
    return explore(sim, "frontier", 60, seed=0, progress=False)


def field(scene, semantics: str | None) -> TrueField:
    made = TrueField(scene, Simulator.from_preset(scene, SMALL))
    made.meta = {**made.meta, **({} if semantics is None else {"semantics": semantics})}
    return made


def test_scores_of_the_task_and_its_figures(scene) -> None:
    scores = evaluate(field(scene, "noisy"), scene, SMALL, tasks=["segmentation"], progress=False)
    values = {row.metric: row.value for row in scores}
    assert list(values) == ["per_class_accuracy", "miou", "precision", "recall"]
    assert 50 < values["miou"] < values["per_class_accuracy"] < 100 and values["recall"] < 100
    artifact = scores.artifacts["segmentation"]
    assert class_scores(artifact["confusion"])["miou"] == values["miou"]
    errors = artifact["errors"]
    assert errors.by_distance[..., 0].sum() == errors.by_size[..., 0].sum() == errors.confusion.sum()
    assert errors.by_size[..., 1].sum() == np.trace(errors.confusion)
    assert [ax.get_title() for ax in figures.segmentation_views(artifact).axes[:4]] == [
        *("image", "predicted", "field", "ground truth")
    ]
    for name in ("segmentation_views", "segmentation_failures", "reliability_diagram"):
        assert getattr(figures, name)(artifact).axes and getattr(figures, name)({}).axes


def test_the_legend_names_the_classes_of_all_images() -> None:
    view = {name: np.full((4, 4), k, np.uint8) for k, name in enumerate(("predicted", "field", "truth"), start=1)}
    view["rgb"] = np.zeros((4, 4, 3), np.uint8)
    for field, expected in ((view["field"], ["chair", "couch", "potted plant"]), (None, ["chair", "potted plant"])):
        figure = figures.segmentation_views({"views": [view | {"field": field}]})
        assert [text.get_text() for text in figure.legends[0].get_texts()] == expected


def test_true_labels_have_nothing_to_score(scene) -> None:
    scores = evaluate(field(scene, None), scene, SMALL, tasks=["segmentation"], progress=False)
    assert {(row.value, row.status) for row in scores} == {(None, "true labels: no segmenter")}


def test_fused_labels_are_better_than_those_of_the_frames(scene) -> None:
    true, segmenter = Simulator.from_preset(scene, SMALL), NoisyLabels(confusion=0.3, boundary=1.0)
    segmenter.reset(np.random.default_rng(0))
    poses = np.repeat(sample_test_poses(true, 5, seed=4), 15, axis=0)
    frames = [true.render(pose) for pose in poses]
    truth = np.stack([frame.semantics for frame in frames])
    rgb, depth = np.stack([frame.rgb for frame in frames]), np.stack([frame.depth for frame in frames])
    found = segmenter(rgb, depth, truth)
    sure = np.rint(255 * found.confidence).astype(np.uint8)
    noisy = Trajectory(poses, rgb, depth, found.labels, true.intrinsics, {"scene": scene.name}, confidence=sure)
    scores = evaluate(field(scene, "noisy"), scene, SMALL, tasks=["rendering"], trajectory=noisy, progress=False)
    fused = scores.baselines["fused_labels"]
    assert fused["rendering", "psnr"] == scores["rendering", "psnr"], "the colours are those of the field"
    seen = FusedLabels(field(scene, "noisy"), noisy)
    labels = np.stack([seen.render(pose, noisy.intrinsics).semantics for pose in poses[::15]])
    single, many = (
        class_scores(confusion_matrix(*pair))["miou"] for pair in ((found.labels, truth), (labels, truth[::15]))
    )
    assert single < 70 and many > single + 15
    with pytest.raises(DataError, match="needs a trajectory with depth, predicted labels and confidences"):
        FusedLabels(field(scene, None), replace(noisy, confidence=None))


def test_a_folder_keeps_the_confidences_and_an_old_one_has_none(noisy, tmp_path) -> None:
    noisy.save(tmp_path)
    loaded = load_trajectory(tmp_path)
    np.testing.assert_array_equal(loaded.confidence, noisy.confidence)
    assert loaded.meta["semantics"] == "NoisyLabels"
    assert np.array_equal(np.stack(load_dataset(tmp_path).confidences or []), noisy.confidence)
    train, _ = Dataset.from_trajectory(loaded).split()
    assert train.confidences is not None and len(train.confidences) == len(train)
    replace(noisy, confidence=None).save(tmp_path)
    assert load_trajectory(tmp_path).confidence is None and not [*(tmp_path / "confidence").glob("*.png")]
    with pytest.raises(DataError, match=r"trajectory\.confidence has the shape"):
        replace(noisy, confidence=noisy.confidence[:, :4]).save(tmp_path)
