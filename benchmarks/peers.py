"""Quality over seconds of training, on the CPU, beside nerfstudio's Nerfacto on the same images.

    python benchmarks/peers.py --peer-python ENVIRONMENT/bin/python --out runs/peers

``ENVIRONMENT`` is one into which nerfstudio was installed (``pip install nerfstudio``); it is not a dependency of this
package. Both train on the same views of a development scene, one after the other, with the same number of threads. The
clock counts the training only. Images and depth at the same test views are scored by the same code. Nerfacto is trained
as its authors registered it, and once more with settings that suit few steps: 512 rays a batch, a density that does not
start transparent, no embedding of the appearance of an image, and the poses, which are exact, kept. ``--quick`` takes
few views and seconds.

Prints a table and, as the last line, one JSON object; writes ``peers.csv``, ``peers.json`` and ``peers.png``.
"""

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common.output import write_csv
from common.training import fit_and_score, in_fresh_process
from common.views import read_views, write_views

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.scenes import scene_names
from autonerf_lab.types import Rendering

MARKS = (5, 10, 20, 30, 40, 60, 120, 300, 600)  # seconds of training at which both are scored
PEERS = {
    "nerfstudio nerfacto, as registered": [],
    "nerfstudio nerfacto, settings for few steps": ["--few-steps"],
}
PANELS = {"psnr": "PSNR [dB]", "ssim": "SSIM", "depth_median_error_m": "median depth error [m]"}


class RenderedViews:
    """Views that were rendered elsewhere, with the interface of a radiance field.

    Args:
        poses: (N, 4, 4) camera-to-world poses of the views.
        path: file of the colours and the depth.
    """

    def __init__(self, poses: np.ndarray, path: Path) -> None:
        self.poses, self.views = poses, np.load(path)

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Return the view of a pose."""
        (k,) = np.flatnonzero((self.poses == c2w).all(axis=(1, 2)))
        depth = self.views["depth"][k]
        return Rendering(self.views["rgb"][k].astype(np.float32), depth, None, np.ones_like(depth))


def train_peer(options: argparse.Namespace, views: Path, arguments: list[str]) -> tuple[list[dict], dict]:
    """Train a peer in its environment; return its scores at the marks and the versions of its packages."""
    script = Path(__file__).parent / "common" / "nerfstudio_nerfacto.py"
    marks = [f"{mark:g}" for mark in options.marks]
    with tempfile.TemporaryDirectory() as folder:
        command = [options.peer_python, script, "--train", views / "train", "--test", views / "test", "--out", folder]
        command += ["--marks", *marks, "--threads", str(options.threads), *arguments]
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"CUDA_VISIBLE_DEVICES": ""}
        found = subprocess.run([*map(str, command)], env=environment, stdout=subprocess.PIPE, text=True, check=True)
        result = json.loads(found.stdout.splitlines()[-1])
        _, test = read_views(views)
        targets = Dataset.from_trajectory(test)
        rows = []
        for row in result["rows"]:
            rendered = RenderedViews(test.poses, Path(folder) / f"views-{row['mark_s']:g}.npz")
            rows.append(row | evaluate_rendering(rendered, photographed_views(targets)).values)
    return rows, result["versions"]


def plot(rows: list[dict[str, Any]], title: str, path: Path) -> None:
    """Plot the scores over the seconds of training, a line per method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(PANELS), figsize=(13, 3.8), layout="constrained")
    for ax, (key, label) in zip(axes, PANELS.items(), strict=True):
        for method in dict.fromkeys(row["method"] for row in rows):
            here = [row for row in rows if row["method"] == method]
            ax.plot([row["seconds"] for row in here], [row[key] for row in here], "o-", ms=4, label=method)
        ax.set(xscale="log", xlabel="seconds of training", ylabel=label)
        ticks = [mark for mark in MARKS if mark <= 1.1 * max(row["seconds"] for row in rows)]
        ax.set_xticks(ticks, [str(tick) for tick in ticks])
        ax.minorticks_off()
        ax.grid(alpha=0.3)
    axes[2].set(yscale="log")
    figure.legend(*axes[0].get_legend_handles_labels(), frameon=False, loc="outside lower center", ncols=3)
    figure.suptitle(title)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Train, score and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", type=Path, help="Python of an environment with nerfstudio.")
    parser.add_argument("--scene", default=scene_names("dev")[0], help="Name of the scene.")
    parser.add_argument("--models", nargs="+", default=["semantic-nerfacto"], help="Own models.")
    parser.add_argument("--seconds", type=float, default=300, help="Seconds of training of the peer.")
    parser.add_argument("--views", type=int, default=600, help="Training views.")
    parser.add_argument("--test-views", type=int, default=30, help="Test views.")
    parser.add_argument("--threads", type=int, default=2, help="Number of threads.")
    parser.add_argument("--out", type=Path, default=Path("runs/peers"), help="Output folder.")
    parser.add_argument("--quick", action="store_true", help="Few views, 10 seconds.")
    options = parser.parse_args()
    if options.quick:
        options.seconds, options.views, options.test_views = 10, 100, 4
    options.marks = [mark for mark in MARKS if mark <= options.seconds]
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    versions: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        views = Path(folder)
        in_fresh_process(options.threads, write_views, options.scene, views, options.views, options.test_views)
        for model in options.models:
            settings = MODELS[model].settings["smoke" if options.quick else "fast"]
            marks = tuple(options.marks)
            found = in_fresh_process(options.threads, fit_and_score, views, settings, marks, model)["rows"]
            rows += [{"method": f"{model}, fast"} | row for row in found]
        for method, arguments in PEERS.items() if options.peer_python else ():
            found, versions = train_peer(options, views, arguments)
            rows += [{"method": method} | row for row in found]
    keys = ("method", "mark_s", "seconds", "step", *PANELS)
    rows = [{key: row[key] for key in keys} for row in rows]
    print(f"{'method':<44}{'seconds':>9}{'steps':>8}{'PSNR':>8}{'SSIM':>8}{'depth error':>14}")
    for row in rows:
        scores = f"{row['psnr']:>8.2f}{row['ssim']:>8.3f}{100 * row['depth_median_error_m']:>11.2f} cm"
        print(f"{row['method']:<44}{row['seconds']:>9.1f}{row['step']:>8}{scores}")
    write_csv(options.out / "peers.csv", rows)
    machine = {"scene": options.scene, "threads": options.threads, "views": options.views, **versions}
    plot(rows, f"{options.scene}: {options.views} views, {options.threads} threads", options.out / "peers.png")
    text = json.dumps({**machine, "rows": rows})
    (options.out / "peers.json").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
