"""Metrics of the benchmark protocol: each is defined once, here, in the order of the protocol."""

from dataclasses import dataclass

Key = tuple[str, str]  # task, metric

FINETUNING_STAGES = {
    "pretrained": "pre-trained",
    "finetuned": "fine-tuned in the mesh",
    "finetuned_true_mesh": "fine-tuned in the true scene",
}
_DISPLAY_UNITS = {("m", 100.0): "cm", ("m", 1000.0): "mm", ("deg", 1.0): "°", ("m2", 1.0): "m²"}


@dataclass(frozen=True)
class Metric:
    """One metric of a task.

    Example:
        >>> metric = METRICS["rendering", "depth_median_error_m"]
        >>> metric.heading, metric.format(0.0834)
        ('Median depth error [cm]', '8.3')
    """

    task: str
    name: str
    unit: str  # of the stored value; "" for a ratio or a count
    label: str  # as tables and the report print it
    better: int  # +1: higher is better, -1: lower is better, 0: neither
    decimals: int = 1  # of the printed value
    scale: float = 1.0  # printed value / stored value
    paper: tuple[float, float | None] | None = None  # best value and frontier value, Gibson, in the stored unit

    @property
    def key(self) -> Key:
        """Task and name."""
        return self.task, self.name

    @property
    def display_unit(self) -> str:
        """Unit of the printed value."""
        return _DISPLAY_UNITS.get((self.unit, self.scale), self.unit)

    @property
    def heading(self) -> str:
        """Label and unit, as the header of a table column."""
        return f"{self.label} [{self.display_unit}]" if self.display_unit else self.label

    @property
    def full_heading(self) -> str:
        """Task and heading, where the rows of several tasks are in one table."""
        return f"{self.task.replace('_', ' ')}: {self.heading}"

    def format(self, value: float) -> str:
        """Format a stored value for display, without its unit."""
        return f"{value * self.scale:.{self.decimals}f}"


# The paper's values are those of tables 1 to 4: the best policy and the frontier policy. Navigation and fine-tuning
# were measured for one policy (modular-obs). The semantic map scores of the paper are exact, without a tolerance.
_PROTOCOL = (
    Metric("rendering", "psnr", "dB", "PSNR", 1, 2, paper=(25.56, 19.75)),
    Metric("rendering", "ssim", "", "SSIM", 1, 3, paper=(0.846, 0.743)),
    Metric("rendering", "lpips", "", "LPIPS", -1, 3, paper=(0.203, 0.343)),
    Metric("rendering", "flip", "", "FLIP", -1, 3),
    Metric("rendering", "per_class_accuracy", "%", "Per-class accuracy", 1, paper=(91.9, 81.4)),
    Metric("rendering", "miou", "%", "mIoU", 1, paper=(83.2, 65.7)),
    Metric("rendering", "miou_objects", "%", "mIoU of objects", 1),
    Metric("rendering", "depth_median_error_m", "m", "Median depth error", -1, 1, 100.0),
    Metric("maps", "free_accuracy", "%", "Free space accuracy", 1, paper=(88.1, 81.2)),
    Metric("maps", "free_precision", "%", "Free space precision", 1, paper=(90.9, 86.9)),
    Metric("maps", "free_recall", "%", "Free space recall", 1, paper=(77.0, 49.9)),
    Metric("maps", "occupancy_precision", "%", "Obstacle precision (5 cm)", 1),
    Metric("maps", "occupancy_recall", "%", "Obstacle recall (5 cm)", 1),
    Metric("maps", "semantic_accuracy", "%", "Semantic accuracy", 1, paper=(99.8, 99.7)),
    Metric("maps", "semantic_precision", "%", "Semantic precision", 1, paper=(37.4, 26.6)),
    Metric("maps", "semantic_recall", "%", "Semantic recall", 1, paper=(30.2, 21.0)),
    Metric("maps", "semantic_precision_5cm", "%", "Semantic precision (5 cm)", 1),
    Metric("maps", "semantic_recall_5cm", "%", "Semantic recall (5 cm)", 1),
    Metric("planning", "pointgoal_success", "%", "PointGoal success", 1, paper=(39.5, 22.4)),
    Metric("planning", "pointgoal_spl", "%", "PointGoal SPL", 1, paper=(39.0, 21.4)),
    Metric("planning", "objectgoal_success", "%", "ObjectGoal success", 1, paper=(16.0, 9.6)),
    Metric("planning", "objectgoal_spl", "%", "ObjectGoal SPL", 1, paper=(15.4, 9.1)),
    Metric("pose_refinement", "convergence_rate", "%", "Convergence rate", 1, paper=(23.0, 7.2)),
    Metric("pose_refinement", "rotation_convergence_rate", "%", "Rotation convergence rate (3°)", 1),
    Metric("pose_refinement", "translation_convergence_rate", "%", "Translation convergence rate (2 cm)", 1),
    Metric("pose_refinement", "rotation_error_deg", "deg", "Rotation error", -1, 3, paper=(0.283, 0.383)),
    Metric("pose_refinement", "translation_error_m", "m", "Translation error", -1, 2, 1000.0, (0.00734, 0.00955)),
    Metric("mesh", "accuracy_m", "m", "Accuracy", -1, 1, 100.0),
    Metric("mesh", "completion_m", "m", "Completion", -1, 1, 100.0),
    Metric("mesh", "completion_ratio", "%", "Completion ratio (5 cm)", 1),
    Metric("mesh", "normal_consistency", "", "Normal consistency", 1, 3),
    Metric("mesh", "completion_m_all", "m", "Completion, whole scene", -1, 1, 100.0),
    Metric("mesh", "completion_ratio_all", "%", "Completion ratio (5 cm), whole scene", 1),
    Metric("mesh", "normal_consistency_all", "", "Normal consistency, whole scene", 1, 3),
    Metric("navigation", "success", "%", "Success in the mesh", 1, paper=(78.4, None)),
    Metric("navigation", "spl", "%", "SPL in the mesh", 1, paper=(67.7, None)),
    Metric("navigation", "success_true_mesh", "%", "Success in the true scene", 1, paper=(88.1, None)),
    Metric("navigation", "spl_true_mesh", "%", "SPL in the true scene", 1, paper=(73.3, None)),
    *(
        Metric("finetuning", f"{name}_{stage}", "%", f"{title}, {FINETUNING_STAGES[stage]}", 1, paper=(value, None))
        for stage, success, spl in (
            ("pretrained", 90.2, 82.9),
            ("finetuned", 92.9, 86.7),
            ("finetuned_true_mesh", 99.7, 97.9),
        )
        for name, title, value in (("success", "Success", success), ("spl", "SPL", spl))
    ),
    Metric("trajectory", "ate_m", "m", "Trajectory error (ATE)", -1, 1, 100.0),
    Metric("trajectory", "ate_unaligned_m", "m", "Trajectory error without alignment", -1, 1, 100.0),
    Metric("trajectory", "heading_error_deg", "deg", "Heading error", -1, 2),
    Metric("trajectory", "error_per_metre", "%", "Position error per metre of path", -1, 2),
    Metric("trajectory", "error_per_degree", "%", "Heading error per degree turned", -1, 2),
    Metric("segmentation", "per_class_accuracy", "%", "Per-class accuracy of predicted labels", 1),
    Metric("segmentation", "miou", "%", "mIoU of predicted labels", 1),
    Metric("segmentation", "precision", "%", "Precision of predicted objects", 1),
    Metric("segmentation", "recall", "%", "Recall of predicted objects", 1),
    *(
        metric
        for name, title in (("", "Area"), ("obstacle_", "Obstacle"), ("semantic_", "Semantic"), ("viewpoint_", "View"))
        for metric in (
            Metric("exploration", f"{name}coverage", "%", f"{title} coverage", 1),
            Metric("exploration", f"{name}coverage_auc", "%", f"{title} coverage, mean over steps", 1),
        )
    ),
    Metric("exploration", "explored_area_m2", "m2", "Explored area", 1),
    Metric("exploration", "collisions", "", "Collisions", -1, 0),
    Metric("exploration", "path_length_m", "m", "Path length", 0),
    *(Metric("reward", name, "m2", f"Summed reward {name}", 1) for name in ("cov", "obs", "sem", "view")),
)
BASELINES = {  # of a run or cell, with their meaning
    "upstream": "the field by the definitions of the code that was released with the paper",
    "nearest_view": "the nearest training view in place of a rendering",
    "tsdf": "the mesh of the fused depth images",
    "fused_labels": "the labels of the frames, fused in a point cloud",
    "oracle": "the true geometry, an upper bound",
}
METRICS: dict[Key, Metric] = {metric.key: metric for metric in _PROTOCOL}


def metrics_of(task: str) -> tuple[Metric, ...]:
    """Return the built-in metrics of a task, in the order of the protocol.

    Example:
        >>> [metric.name for metric in metrics_of("planning")][:2]
        ['pointgoal_success', 'pointgoal_spl']
    """
    return tuple(metric for metric in _PROTOCOL if metric.task == task)
