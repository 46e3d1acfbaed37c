"""The tables of the paper, and its figures on Gibson (Marza et al., 2023): what stands beside ours."""

from dataclasses import dataclass

from autonerf_lab.evaluators.scores import PAPER

Key = tuple[str, str]  # task, metric

POLICY_NAMES = {
    "frontier": "Frontier",
    "e2e-cov": "E2E (cov.)",
    "e2e-cur": "E2E (cur.)",
    "e2e-nov": "E2E (nov.)",
    "e2e-rec": "E2E (rec.)",
    "modular-cov": "Ours (cov.)",
    "modular-sem": "Ours (sem.)",
    "modular-obs": "Ours (obs.)",
    "modular-view": "Ours (view.)",
}


@dataclass(frozen=True)
class Column:
    """One score as a table prints it."""

    task: str
    metric: str
    title: str
    better: int  # 1: more is better, -1: less is
    decimals: int = 1
    scale: float = 1.0  # of what is printed to what is kept

    @property
    def key(self) -> Key:
        """Of its score."""
        return self.task, self.metric


_R, _M, _P, _F, _N, _T = "rendering", "maps", "planning", "pose_refinement", "navigation", "finetuning"
PSNR, SSIM = Column(_R, "psnr", "PSNR [dB]", 1, 2), Column(_R, "ssim", "SSIM", 1, 3)
LPIPS = Column(_R, "lpips", "LPIPS", -1, 3)
PER_CLASS, MIOU = Column(_R, "per_class_accuracy", "Per-class acc. [%]", 1), Column(_R, "miou", "mIoU [%]", 1)
SEMANTIC = (
    Column(_M, "semantic_accuracy", "Sem. acc. [%]", 1),
    Column(_M, "semantic_precision", "Sem. prec. [%]", 1),
    Column(_M, "semantic_recall", "Sem. rec. [%]", 1),
)
OBJECTGOAL = (
    Column(_P, "objectgoal_success", "ObjectGoal succ. [%]", 1),
    Column(_P, "objectgoal_spl", "ObjectGoal SPL [%]", 1),
)

RENDERING = (PSNR, SSIM, LPIPS, PER_CLASS, MIOU, Column(_R, "depth_median_error_m", "Depth error [cm]", -1, 1, 100))
MAPS = (
    Column(_M, "free_accuracy", "Free acc. [%]", 1),
    Column(_M, "free_precision", "Free prec. [%]", 1),
    Column(_M, "free_recall", "Free rec. [%]", 1),
    Column(_M, "occupancy_precision", "Occ. prec. 5 cm [%]", 1),
    Column(_M, "occupancy_recall", "Occ. rec. 5 cm [%]", 1),
    *SEMANTIC,
    Column(_M, "semantic_precision_5cm", "Sem. prec. 5 cm [%]", 1),
    Column(_M, "semantic_recall_5cm", "Sem. rec. 5 cm [%]", 1),
)
PLANNING = (
    Column(_P, "pointgoal_success", "PointGoal succ. [%]", 1),
    Column(_P, "pointgoal_spl", "PointGoal SPL [%]", 1),
    *OBJECTGOAL,
)
POSE = (
    Column(_F, "convergence_rate", "Conv. rate [%]", 1),
    Column(_F, "rotation_error_deg", "Rot. error [deg]", -1, 3),
    Column(_F, "translation_error_m", "Trans. error [mm]", -1, 2, 1000),
)
MESH = (
    Column("mesh", "accuracy_m", "Accuracy [cm]", -1, 1, 100),
    Column("mesh", "completion_m", "Completion [cm]", -1, 1, 100),
    Column("mesh", "completion_ratio", "Completed 5 cm [%]", 1),
    Column("mesh", "normal_consistency", "Normals", 1, 3),
)
EXPLORATION = (
    Column("exploration", "coverage_auc", "Area [%]", 1),
    Column("exploration", "obstacle_coverage_auc", "Obstacles [%]", 1),
    Column("exploration", "semantic_coverage_auc", "Semantics [%]", 1),
    Column("exploration", "viewpoint_coverage_auc", "Viewpoints [%]", 1),
    Column("exploration", "explored_area_m2", "Explored [m²]", 1),
    Column("exploration", "collisions", "Collisions", -1, 0),
    Column("exploration", "path_length_m", "Path [m]", 0),
)
NAVIGATION = (
    Column(_N, "success", "Success, mesh [%]", 1),
    Column(_N, "spl", "SPL, mesh [%]", 1),
    Column(_N, "success_true_mesh", "Success, true [%]", 1),
    Column(_N, "spl_true_mesh", "SPL, true [%]", 1),
)
FINETUNING = tuple(
    Column(_T, f"{metric}_{stage}", f"{title}, {words} [%]", 1)
    for stage, words in (
        ("pretrained", "pre-trained"), ("finetuned", "fine-tuned"), ("finetuned_true_mesh", "in the true mesh"),
    )
    for metric, title in (("success", "Success"), ("spl", "SPL"))
)  # fmt: skip
HEADLINES = (PSNR, MIOU, MAPS[2], MAPS[8], PLANNING[0], PLANNING[2], POSE[0], MESH[2])


def _table(columns: tuple[Column, ...], rows: str, names: tuple[str, ...]) -> dict[str, dict[Key, float]]:
    values = [[float(v) for v in row.split()] for row in rows.strip().splitlines()]
    return {
        name: {c.key: v / c.scale for c, v in zip(columns, row, strict=True)}
        for name, row in zip(names, values, strict=True)
    }


_POLICIES = tuple(POLICY_NAMES)
_TABLES = (
    _table(
        RENDERING[:5],
        """19.75 .743 .343 81.4 65.7
        20.94 .750 .332 80.1 63.9
        20.60 .747 .338 78.7 61.9
        23.36 .801 .268 84.6 71.4
        23.17 .797 .270 84.1 70.5
        24.89 .837 .218 90.2 81.2
        25.34 .843 .207 91.9 81.8
        25.56 .846 .203 91.8 83.2
        25.17 .842 .211 91.3 82.0""",
        _POLICIES,
    ),
    _table(
        (*MAPS[:3], *SEMANTIC),
        """81.2 86.9 49.9 99.7 26.6 21.0
        77.1 86.2 50.4 99.7 22.1 16.1
        81.8 90.3 50.7 99.7 19.2 12.5
        83.1 88.7 61.3 99.7 25.5 18.3
        81.6 87.6 60.0 99.7 26.2 18.0
        86.8 89.1 74.7 99.8 35.1 27.1
        86.6 88.3 76.5 99.8 35.7 29.8
        86.4 89.4 76.5 99.8 36.2 29.8
        88.1 90.9 77.0 99.8 37.4 30.2""",
        _POLICIES,
    ),
    _table(
        PLANNING,
        """22.4 21.4 9.6 9.1
        30.0 29.3 8.9 8.3
        29.8 29.2 8.5 8.0
        32.3 31.9 11.4 10.8
        32.8 32.6 10.5 10.0
        39.5 39.0 14.8 14.3
        37.7 37.4 16.0 15.4
        38.2 37.8 15.8 15.3
        39.0 38.6 15.9 15.3""",
        _POLICIES,
    ),
    _table(
        POSE,
        """7.2 .383 9.55
        15.4 .319 7.75
        12.5 .325 7.99
        19.4 .315 7.74
        19.3 .292 7.34
        20.2 .283 7.34
        23.0 .319 7.84
        22.5 .305 7.65
        21.1 .316 7.69""",
        _POLICIES,
    ),
    {"modular-obs": {column.key: PAPER[column.key][0] for column in (*NAVIGATION, *FINETUNING)}},  # of one policy only
)
BY_POLICY: dict[str, dict[Key, float]] = {
    policy: {key: value for table in _TABLES for key, value in table.get(policy, {}).items()} for policy in _POLICIES
}
BY_MODEL = _table((PSNR, SSIM, LPIPS), "25.56 .846 .203\n24.92 .806 .279", ("semantic-nerfacto", "instant-ngp"))
PREDICTED_COLUMNS = (PER_CLASS, MIOU, *SEMANTIC, *OBJECTGOAL)
PREDICTED = _table(PREDICTED_COLUMNS, "65.4 61.1 99.7 14.1 8.5 6.8 6.5", ("modular-obs",))["modular-obs"]
NOISE_COLUMNS = (*RENDERING[:5], *MAPS[:3], *SEMANTIC, *PLANNING, *POSE)
NOISE = _table(
    NOISE_COLUMNS,
    "20.87 .761 .264 85.4 73.6 86.8 89.8 69.6 99.7 29.9 24.1 34.5 33.8 12.9 12.4 7.9 .405 11.25",
    ("modular-obs",),
)["modular-obs"]

CORRELATED = (
    PSNR, PER_CLASS, MAPS[2], SEMANTIC[2], PLANNING[0], PLANNING[2],
    Column(_F, "rotation_convergence_rate", "Rot. conv. rate", 1),
    Column(_F, "translation_convergence_rate", "Trans. conv. rate", 1),
)  # fmt: skip
_R_OF = """
.73 .77 .95 .48 - | - .59 .97 .60 - | .50 .75 .94 .47 - | - .47 .93 - - | - - .63 - - | - - .62 - - | .49 - .69 - - | .54 - .72 - -
.52 - .84 .62 - | - .66 .82 .61 - | .53 .60 .80 .48 .46 | - .73 .72 - - | - - - - - | - - .44 - - | .67 - .70 - - | .52 - .73 .63 .49
.88 .83 .96 .70 - | .48 .79 .95 .76 .48 | .73 .87 .94 .56 .64 | - .72 .91 - - | - - .66 - - | - - .66 - - | .69 - .72 - .59 | .66 - .75 .52 .65
.83 .55 .93 .67 .55 | - .48 .87 .70 .55 | .66 - .88 .53 .69 | - .60 .80 - - | - - .60 - .53 | - - .60 - .53 | .74 - .75 - .66 | .70 - .78 .60 .81
"""  # noqa: E501
CORRELATIONS: dict[tuple[str, Key], list[str]] = {  # reward and score -> r in each of its five scenes
    (reward, column.key): values.split()
    for reward, row in zip(("cov", "sem", "obs", "view"), _R_OF.strip().splitlines(), strict=True)
    for column, values in zip(CORRELATED, row.split("|"), strict=True)
}
