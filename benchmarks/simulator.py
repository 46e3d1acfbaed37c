"""Frames per second of the simulator on one core, compared with pyrender and with ray casting of the same rays.

Prints a table and, as its last line, one JSON object. ``--plot FILE`` plots the frame rate over the number of
triangles; ``--quick`` runs a short version.
"""

import argparse
import json
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from autonerf_lab.errors import AutoNerfError
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.scenes import Scene, load_scene
from autonerf_lab.simulator import Simulator


def frames_per_second(render: Callable[[np.ndarray], object], poses: list[np.ndarray], repeats: int = 3) -> float:
    """Return the frame rate of the fastest of ``repeats`` passes over the poses."""
    render(poses[0])
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        for pose in poses:
            render(pose)
        best = min(best, time.perf_counter() - start)
    return len(poses) / best


def subdivided(scene: Scene, triangles: int) -> Scene:
    """Return the scene with each triangle split into four until it has about ``triangles`` triangles."""
    while 2 * len(scene.faces) < triangles:
        corners, uv = scene.vertices[scene.faces], scene.uv
        scene = Scene(
            scene.name,
            _quarters(corners).reshape(-1, 3),
            np.arange(12 * len(corners), dtype=np.int32).reshape(-1, 3),
            np.repeat(scene.face_class, 4),
            np.repeat(scene.face_instance, 4),
            _quarters(uv),
            bake=partial(np.asarray, scene.texture),
        )
    return scene


def _quarters(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, *corners.shape[1:])


def pyrender_speed(scene: Scene, camera: Intrinsics, poses: list[np.ndarray]) -> float | None:
    """Return pyrender's frame rate for colour and depth, one sample per pixel; None without OpenGL."""
    try:
        from autonerf_lab.simulator.opengl import GLRenderer

        with GLRenderer(scene, camera) as renderer:
            return frames_per_second(renderer.render, poses)
    except AutoNerfError as error:
        print(f"pyrender: {error}")
        return None


def cast_speed(sim: Simulator, poses: list[np.ndarray]) -> float:
    """Return the frame rate of first hits by ray casting (embree), without colours."""

    def cast(pose: np.ndarray) -> None:
        rays_o, rays_d = camera_rays(sim.intrinsics, pose)
        sim.cast(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3))

    return frames_per_second(cast, poses)


def draw(growth: np.ndarray, path: str) -> None:
    """Plot the frame rate over the number of triangles."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(5.5, 3.6), layout="constrained")
    for k, label in enumerate(
        ("colour, depth, classes", "colour, depth, classes, 2x2 supersampled", "embree, first hits only"), start=1
    ):
        ax.loglog(growth[:, 0], growth[:, k], "o-", label=label)
    ax.set(xlabel="number of triangles", ylabel="frames per second (128x128, one core)")
    ax.grid(alpha=0.3, which="both")
    ax.legend(frameon=False)
    fig.savefig(path, dpi=110)


def main() -> None:
    """Run the benchmark and print a table, then one JSON object as the last line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="Render fewer frames and no large meshes.")
    parser.add_argument("--plot", default=None, help="Image file to write the plot to.")
    options = parser.parse_args()
    quick = options.quick
    scene = load_scene("dev-0")
    camera, small = Intrinsics.from_fov(128, 128), Intrinsics.from_fov(64, 48)
    plain, fine = Simulator(scene, camera, supersample=1), Simulator(scene, camera, supersample=2)
    depth_only = Simulator(scene, small, rgb=False)
    rng = np.random.default_rng(0)
    poses = [plain.sample_pose(rng) for _ in range(50 if quick else 300)]
    figures: dict[str, float | None] = {
        "triangles": len(scene.faces),
        "rgbd_fps": frames_per_second(plain.render, poses),
        "rgbd_fps_supersampled": frames_per_second(fine.render, poses),
        "depth_fps": frames_per_second(lambda pose: depth_only.render(pose, rgb=False), poses),
        "pyrender_fps": pyrender_speed(scene, camera, poses),
        "embree_cast_fps": cast_speed(plain, poses),
    }
    growth = []
    for name, size in () if quick else (("10k", 0), ("100k", 100_000), ("1m", 1_000_000)):
        # the smallest frozen scenes have about 10,000 triangles
        large = subdivided(scene, size) if size else load_scene("train-04")
        some = poses[:50] if size else [Simulator(large).sample_pose(rng) for _ in range(50)]
        rows: list[float] = [len(large.faces)]
        for samples in (1, 2):
            sim = Simulator(large, camera, supersample=samples)
            rows.append(frames_per_second(sim.render, some))
            figures[f"fps_{name}" + "_supersampled" * (samples > 1)] = rows[-1]
        rows.append(cast_speed(sim, some[:20]))
        figures[f"embree_cast_fps_{name}"] = rows[-1]
        growth.append(rows)
    if options.plot and growth:
        draw(np.array(growth), options.plot)
    if figures["pyrender_fps"]:
        figures["ratio_to_pyrender"] = float(figures["rgbd_fps"] or 0) / figures["pyrender_fps"]
    print(f"{'one core, 128x128 unless stated otherwise':<42}{'value':>10}")
    for name, value in figures.items():
        print(f"{name:<42}{'missing' if value is None else f'{value:.1f}':>10}")
    print(json.dumps({k: v if v is None else round(v, 2) for k, v in figures.items()}))


if __name__ == "__main__":
    main()
