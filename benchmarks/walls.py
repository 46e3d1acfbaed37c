"""How much do the scores of all five tasks see? The true geometry is scored, one wall moved by a few centimetres.

In each scene the inner wall with the largest faces moves along its normal, with everything of the building that lies
in it; furniture stays. The first column is what the true geometry scores with the wall in its place. Walls are hollow
and the true geometry is known everywhere, so maps lose only the thin lines of the moved faces: that is why free space
hardly sees what planning sees well. The table is Markdown.
``--quick`` looks at one scene with the smoke preset.

Run: python benchmarks/walls.py [--quick] [--out walls.md]
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from autonerf_lab.config import Preset, preset
from autonerf_lab.evaluators import METRICS, TrueField, evaluate
from autonerf_lab.evaluators.mesh_metrics import normals
from autonerf_lab.scenes import Scene, load_scene
from autonerf_lab.simulator import Simulator

SHIFTS_CM = (0, 1, 2, 5, 10)
THICKNESS = (0.05, 0.3)  # metres, of a wall
EDGE = 0.5  # metres from the bounds: what is nearer is an outer wall
MARGIN = 0.03  # metres: skirtings stand before a wall


def inner_wall(scene: Scene) -> tuple[int, float, float]:
    """The axis (0: x, 1: y) across the largest inner wall, and where its two faces lie, metres."""
    triangles = scene.vertices[scene.faces[(scene.face_class == 0) & (scene.face_instance == 0)]].astype(np.float64)
    normal = normals(triangles)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    best = (0.0, 0, 0.0, 0.0)
    for axis in (0, 1):
        sides = []
        for sign in (-1, 1):  # of a wall's faces, the lower looks down the axis and the upper up
            facing = sign * normal[:, axis] > 0.99
            places, index = np.unique(triangles[facing][:, 0, axis].round(3), return_inverse=True)
            sides.append(list(zip(places.tolist(), np.bincount(index, area[facing]).tolist(), strict=True)))
        low, high = scene.bounds[0, axis] + EDGE, scene.bounds[1, axis] - EDGE
        for a, below in sides[0]:
            for b, above in sides[1]:
                if low < a and b < high and THICKNESS[0] <= b - a <= THICKNESS[1]:
                    best = max(best, (min(below, above), axis, a, b))
    if best[0] == 0:
        raise SystemExit(f"{scene.name} has no inner wall")
    return best[1:]


def moved(scene: Scene, wall: tuple[int, float, float], metres: float) -> Scene:
    """The scene with that wall elsewhere."""
    axis, low, high = wall
    vertices, building = scene.vertices.copy(), np.zeros(len(scene.vertices), bool)
    building[scene.faces[scene.face_instance == 0]] = True
    within = building & (vertices[:, axis] >= low - MARGIN) & (vertices[:, axis] <= high + MARGIN)
    vertices[within, axis] += np.float32(metres)
    return replace(scene, vertices=vertices, bake=lambda: scene.texture)  # the light of the scene as it was


def displaced(scene: Scene, wall: tuple[int, float, float], metres: float, size: Preset, views: int = 1) -> TrueField:
    """The geometry with that wall elsewhere, looking as the test images of a preset do."""
    there = moved(scene, wall, metres)
    return TrueField(there, Simulator.of_preset(there, size), views=views)


def main() -> None:
    """Measure, print the table, and one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smoke preset in one scene")
    parser.add_argument("--scenes", default="dev-0,dev-1,dev-2", help="comma list")
    parser.add_argument("--out", type=Path, default=None, help="where to write the table")
    options = parser.parse_args()
    size, names = (preset("smoke"), ["dev-0"]) if options.quick else (preset("fast"), options.scenes.split(","))
    scores: dict[int, dict[str, list[float]]] = {shift: {} for shift in SHIFTS_CM}
    for name in names:
        scene = load_scene(name)
        wall, views = inner_wall(scene), 60 if options.quick else 600
        cameras = displaced(scene, wall, 0, size, views).cameras
        for shift in SHIFTS_CM:
            field = displaced(scene, wall, shift / 100, size)
            field.cameras = cameras  # drawn anew in the moved scene, they would be others
            for row in evaluate(field, scene, size, progress=False):
                if row.status.startswith("failed"):
                    raise RuntimeError(row.status)
                if row.value is not None:
                    scores[shift].setdefault(f"{row.task}: {row.metric}", []).append(row.value)
    units = {f"{task}: {metric}": unit for task in METRICS for metric, unit in METRICS[task].items()}
    lines = [
        "| score | unit | " + " | ".join(f"{shift} cm" for shift in SHIFTS_CM) + " |",
        "|---|---|" + "---|" * len(SHIFTS_CM),
    ]
    for score, unit in units.items():
        values = [f"{np.mean(scores[shift][score]):.4g}" if score in scores[shift] else "–" for shift in SHIFTS_CM]
        lines.append(f"| {score} | {unit} | " + " | ".join(values) + " |")
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    means = {
        str(shift): {score: float(np.mean(values)) for score, values in of.items()} for shift, of in scores.items()
    }
    print(json.dumps({"preset": size.name, "scenes": names, "scores_by_shift_cm": means}))


if __name__ == "__main__":
    main()
