"""Report of an import: what was found in the files, how it was interpreted, and what is doubtful about it."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.scenes.scene import Scene

SMALL_FLOOR = 4.0  # m2
LOW_CEILING, HIGH_CEILING = 1.9, 6.0  # metres
STOREY = 1.8  # metres, least distance of two floors
_SHOWN = 8  # names in a line


@dataclass(frozen=True)
class ImportReport:
    """Findings of :func:`~autonerf_lab.scenes.import_scene`, in ``scene.import_report``; print it."""

    source: str  # path of the imported file
    up: str  # axis that points up in the file, and why it was chosen
    offset: tuple[float, float, float]  # metres; position in the scene = position in the file (z up) - offset
    floors: tuple[float, ...]  # heights of the floors, metres; the robot moves on the one at 0
    floor_area: float  # of the floor at z = 0, m2
    ceiling: float  # height of the highest surface above the floor, metres
    classes: Mapping[str, int]  # number of objects by class
    unknown: Mapping[str, int]  # number of objects by name, for names that stand for none of the 15 classes
    left_out: Mapping[str, int] = field(default_factory=dict)  # number of parts that were not imported, by reason

    @property
    def warnings(self) -> list[str]:
        """Signs of a wrong unit, a wrong up axis or missing semantics; empty if the scene is plausible."""
        found = []
        if self.floor_area < SMALL_FLOOR:
            found.append(
                f"the floor has only {self.floor_area:.1f} m2; check the unit and the up axis (--up y or --up z)"
            )
        if self.ceiling < LOW_CEILING:
            found.append(
                f"the highest surface is only {self.ceiling:.2f} m above the floor; check the unit and the up axis"
            )
        elif self.ceiling > HIGH_CEILING and len(self.floors) == 1:
            found.append(f"the highest surface is {self.ceiling:.1f} m above the only floor; check the unit")
        if not self.classes and self.unknown:
            found.append("no name of an object stands for one of the 15 classes; map the names with --aliases")
        elif not self.classes:
            found.append("no object has a name: all surfaces are background; name the nodes, or add a semantics file")
        return found

    def __str__(self) -> str:
        floors = ", ".join(f"{height:.2f}" for height in self.floors)
        lines = [
            f"source:      {self.source}",
            f"up axis:     {self.up}",
            f"floors:      at {floors} m; {self.floor_area:.1f} m2 at 0; highest surface {self.ceiling:.2f} m",
            f"classes:     {_counts(self.classes) or 'none: all surfaces are background'}",
        ]
        if self.unknown:
            lines.append(f"background:  {_counts(self.unknown)}")
        lines += [f"left out:    {count} {reason}" for reason, count in self.left_out.items()]
        lines += [f"warning:     {text}" for text in self.warnings]
        return "\n".join(lines)


def make_report(
    scene: Scene, source: str, up: str, offset: np.ndarray, unknown: Counter[str], left_out: Mapping[str, int]
) -> ImportReport:
    """Describe an imported scene.

    Args:
        scene: Imported scene, floor at z = 0.
        source: Path of the imported file.
        up: Axis that points up in the file, and why it was chosen.
        offset: (3,) metres, see :class:`ImportReport`.
        unknown: Number of objects by name, for names that stand for no class.
        left_out: Number of parts that were not imported, by reason.
    """
    floors, area, top = measure_floors(scene.vertices[scene.faces].astype(np.float64))
    classes = Counter(CLASS_NAMES[i.class_id] for i in scene.instances if i.class_id)
    x, y, z = (float(v) for v in offset)
    return ImportReport(
        source, up, (x, y, z), floors, area, top, dict(classes.most_common()), dict(unknown.most_common()), left_out
    )


def measure_floors(triangles: np.ndarray) -> tuple[tuple[float, ...], float, float]:
    """Return the heights of the floors, the area of the one at z = 0 (m2) and the height of the highest surface.

    Args:
        triangles: (F, 3, 3) float64, metres, z up, floor at z = 0.
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1)
    z = triangles[..., 2].mean(axis=1)
    level = np.abs(normal[:, 2]) > 0.9 * np.maximum(area, 1e-12)
    zero = np.abs(z) < 0.08
    upward = level & (normal[:, 2] > 0)
    if area[zero & upward].sum() > area[zero & level].sum() / 4:  # else: inverted faces
        level = upward
    z, weight = z[level], area[level]
    at_zero = float(weight[zero[level]].sum())
    top = float(np.quantile(triangles[..., 2], 0.999))
    floors = [0.0]
    chosen = (z > STOREY) & (z < top - STOREY)  # a floor has room above it, unlike the top of a ceiling
    bins = (z[chosen] / 0.1).astype(int)
    for k in np.flatnonzero(np.bincount(bins, weight[chosen]) > at_zero / 3):
        if 0.1 * k - floors[-1] > STOREY:
            floors.append(round(float(np.average(z[chosen][bins == k], weights=weight[chosen][bins == k])), 2))
    return tuple(floors), at_zero, top


def _counts(counts: Mapping[str, int]) -> str:
    shown = ", ".join(f"{count} {name}" for name, count in list(counts.items())[:_SHOWN])
    more = len(counts) - _SHOWN
    return f"{shown} and {more} more names" if more > 0 else shown
