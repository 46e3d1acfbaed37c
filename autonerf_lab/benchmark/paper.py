"""Tables of the paper: which metrics they have, and the published values on Gibson (Marza et al., 2023)."""

from collections.abc import Collection

from autonerf_lab.benchmark.results_table import Row
from autonerf_lab.evaluators.metrics import METRICS, Key, Metric, metrics_of

POLICY_NAMES = {
    "frontier-classic": "Frontier",
    "e2e-cov": "E2E (cov.)",
    "e2e-cur": "E2E (cur.)",
    "e2e-nov": "E2E (nov.)",
    "e2e-rec": "E2E (rec.)",
    "modular-cov": "Ours (cov.)",
    "modular-sem": "Ours (sem.)",
    "modular-obs": "Ours (obs.)",
    "modular-view": "Ours (view.)",
}


def _metrics(task: str, *names: str) -> tuple[Metric, ...]:
    return tuple(METRICS[task, name] for name in names)


RENDERING = _metrics("rendering", "psnr", "ssim", "lpips", "per_class_accuracy", "miou", "depth_median_error_m")
PSNR, SSIM, LPIPS, PER_CLASS, MIOU, _ = RENDERING
MAPS, PLANNING = metrics_of("maps"), metrics_of("planning")
FREE, SEMANTIC, OBJECTGOAL = MAPS[:3], MAPS[5:8], PLANNING[2:]
POSE = _metrics("pose_refinement", "convergence_rate", "rotation_error_deg", "translation_error_m")
MESH = _metrics("mesh", "completion_ratio_all", "accuracy_m", "completion_m", "completion_ratio", "normal_consistency")
EXPLORATION = (
    *(metric for metric in metrics_of("exploration") if metric.name.endswith("_auc")),
    *_metrics("exploration", "explored_area_m2", "collisions", "path_length_m"),
)
NAVIGATION, FINETUNING = metrics_of("navigation"), metrics_of("finetuning")
HEADLINES = (PSNR, MIOU, MAPS[2], MAPS[8], PLANNING[0], PLANNING[2], POSE[0], MESH[0])


def _table(metrics: tuple[Metric, ...], rows: str, names: tuple[str, ...]) -> dict[str, dict[Key, float]]:
    values = [[float(v) for v in row.split()] for row in rows.strip().splitlines()]
    return {
        name: {m.key: v / m.scale for m, v in zip(metrics, row, strict=True)}
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
        (*FREE, *SEMANTIC),
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
    {"modular-obs": {m.key: m.paper[0] for m in (*NAVIGATION, *FINETUNING) if m.paper}},  # measured for one policy
)
BY_POLICY: dict[str, dict[Key, float]] = {
    policy: {key: value for table in _TABLES for key, value in table.get(policy, {}).items()} for policy in _POLICIES
}
BY_MODEL = _table((PSNR, SSIM, LPIPS), "25.56 .846 .203\n24.92 .806 .279", ("semantic-nerfacto", "instant-ngp"))
PREDICTED_METRICS = (PER_CLASS, MIOU, *SEMANTIC, *OBJECTGOAL)
PREDICTED = _table(PREDICTED_METRICS, "65.4 61.1 99.7 14.1 8.5 6.8 6.5", ("modular-obs",))["modular-obs"]
NOISE_METRICS = (*RENDERING[:5], *FREE, *SEMANTIC, *PLANNING, *POSE)
NOISE = _table(
    NOISE_METRICS,
    "20.87 .761 .264 85.4 73.6 86.8 89.8 69.6 99.7 29.9 24.1 34.5 33.8 12.9 12.4 7.9 .405 11.25",
    ("modular-obs",),
)["modular-obs"]

CORRELATED = (
    PSNR, PER_CLASS, MAPS[2], SEMANTIC[2], PLANNING[0], PLANNING[2],
    *_metrics("pose_refinement", "rotation_convergence_rate", "translation_convergence_rate"),
)  # fmt: skip
_R_OF = """
.73 .77 .95 .48 - | - .59 .97 .60 - | .50 .75 .94 .47 - | - .47 .93 - - | - - .63 - - | - - .62 - - | .49 - .69 - - | .54 - .72 - -
.52 - .84 .62 - | - .66 .82 .61 - | .53 .60 .80 .48 .46 | - .73 .72 - - | - - - - - | - - .44 - - | .67 - .70 - - | .52 - .73 .63 .49
.88 .83 .96 .70 - | .48 .79 .95 .76 .48 | .73 .87 .94 .56 .64 | - .72 .91 - - | - - .66 - - | - - .66 - - | .69 - .72 - .59 | .66 - .75 .52 .65
.83 .55 .93 .67 .55 | - .48 .87 .70 .55 | .66 - .88 .53 .69 | - .60 .80 - - | - - .60 - .53 | - - .60 - .53 | .74 - .75 - .66 | .70 - .78 .60 .81
"""  # noqa: E501
CORRELATIONS: dict[tuple[str, Key], list[str]] = {  # reward and metric -> r in each of the five scenes
    (reward, metric.key): values.split()
    for reward, row in zip(("cov", "sem", "obs", "view"), _R_OF.strip().splitlines(), strict=True)
    for metric, values in zip(CORRELATED, row.split("|"), strict=True)
}


def published_scores(row: Row, rows: Collection[Row]) -> dict[Key, float]:
    """Return the paper's scores of a policy with Semantic Nerfacto, without noise; empty for other rows.

    Args:
        row: policy and model.
        rows: those of the table. In one without ``frontier-classic``, ``frontier`` stands beside the paper's frontier.
    """
    policy, model = row
    if policy == "frontier" and ("frontier-classic", model) not in rows:
        policy = "frontier-classic"
    return BY_POLICY.get(policy, {}) if model == "semantic-nerfacto" else {}
