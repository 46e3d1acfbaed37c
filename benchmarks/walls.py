"""Sensitivity of the scores of all five tasks: evaluate the true geometry with one wall moved by a few centimetres.

In each scene the inner wall with the largest faces moves along its normal, together with the parts of the building
inside it; furniture does not move. The first column is the score of the unchanged geometry. Walls are hollow and the
true geometry is known everywhere, so maps lose only the thin lines of the moved faces: free-space scores hardly change
while planning scores do. The table is Markdown. ``--quick`` evaluates one scene with the smoke preset.

Run: python benchmarks/walls.py [--quick] [--out walls.md]
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from autonerf_lab.evaluators import DEFAULT_TASKS, METRICS, TrueField, evaluate
from autonerf_lab.evaluators.mesh_metrics import normals
from autonerf_lab.presets import Preset, preset
from autonerf_lab.scenes import Scene, load_scene
from autonerf_lab.simulator import Simulator

SHIFTS_CM = (0, 1, 2, 5, 10)
THICKNESS = (0.05, 0.3)  # metres, range of the thickness of a wall
EDGE = 0.5  # metres from the bounds of the scene; nearer walls are outer walls
MARGIN = 0.03  # metres in front of a wall that move with it: skirting boards


def inner_wall(scene: Scene) -> tuple[int, float, float]:
    """Return the axis across the largest inner wall (0: x, 1: y) and the positions of its two faces, metres."""
    triangles = scene.vertices[scene.faces[(scene.face_class == 0) & (scene.face_instance == 0)]].astype(np.float64)
    normal = normals(triangles)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    best = (0.0, 0, 0.0, 0.0)
    for axis in (0, 1):
        sides = []
        for sign in (-1, 1):  # the lower face of a wall faces down the axis, the upper one up
            facing = sign * normal[:, axis] > 0.99
            positions, index = np.unique(triangles[facing][:, 0, axis].round(3), return_inverse=True)
            sides.append(list(zip(positions.tolist(), np.bincount(index, area[facing]).tolist(), strict=True)))
        low, high = scene.bounds[0, axis] + EDGE, scene.bounds[1, axis] - EDGE
        for a, below in sides[0]:
            for b, above in sides[1]:
                if low < a and b < high and THICKNESS[0] <= b - a <= THICKNESS[1]:
                    best = max(best, (min(below, above), axis, a, b))
    if best[0] == 0:
        raise SystemExit(f"{scene.name} has no inner wall; choose other scenes with --scenes")
    return best[1:]


def move_wall(scene: Scene, wall: tuple[int, float, float], metres: float) -> Scene:
    """Return the scene with a wall moved along its normal by a distance in metres."""
    axis, low, high = wall
    vertices, building = scene.vertices.copy(), np.zeros(len(scene.vertices), bool)
    building[scene.faces[scene.face_instance == 0]] = True
    within = building & (vertices[:, axis] >= low - MARGIN) & (vertices[:, axis] <= high + MARGIN)
    vertices[within, axis] += np.float32(metres)
    return replace(scene, vertices=vertices, bake=lambda: scene.texture)  # with the texture of the unchanged scene


def displaced(scene: Scene, wall: tuple[int, float, float], metres: float, size: Preset, views: int = 1) -> TrueField:
    """Return the true field with a moved wall, rendered with the camera of a preset."""
    changed = move_wall(scene, wall, metres)
    return TrueField(changed, Simulator.from_preset(changed, size), views=views)


def main() -> None:
    """Evaluate, print the table, and print one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Evaluate one scene with the smoke preset.")
    parser.add_argument("--scenes", default="dev-0,dev-1,dev-2", help="Names of the scenes, separated by commas.")
    parser.add_argument("--out", type=Path, default=None, help="Markdown file to write the table to.")
    options = parser.parse_args()
    size, names = (preset("smoke"), ["dev-0"]) if options.quick else (preset("fast"), options.scenes.split(","))
    scores: dict[int, dict[str, list[float]]] = {shift: {} for shift in SHIFTS_CM}
    for name in names:
        scene = load_scene(name)
        wall, views = inner_wall(scene), 60 if options.quick else 600
        cameras = displaced(scene, wall, 0, size, views).poses
        for shift in SHIFTS_CM:
            field = displaced(scene, wall, shift / 100, size)
            field.poses = cameras  # the same views for every shift
            for row in evaluate(field, scene, size, progress=False):
                if row.status.startswith("failed"):
                    raise RuntimeError(row.status)
                if row.value is not None:
                    scores[shift].setdefault(f"{row.task}: {row.metric}", []).append(row.value)
    units = {f"{m.task}: {m.name}": m.unit for m in METRICS.values() if m.task in DEFAULT_TASKS}
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
