"""Learning curves of the policies that `policy_training.py` does not draw, from the files beside their weights.

    python benchmarks/learning_curves.py --out docs/learning_curves_others.png

Every update and the running mean over the frames. The last line is JSON: the mean of each quarter of a training.
"""

import argparse
import json

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from scipy.ndimage import uniform_filter1d

from autonerf_lab.policies import WEIGHTS
from autonerf_lab.policies.weights import read_meta

PANELS = {  # weights: quantity and its label
    **{f"e2e-{reward}": ("explored_m2", "explored area (m²)") for reward in ("cov", "cur", "nov", "rec")},
    "paper-obs": ("return", "discounted return"),
    "pointgoal/pretrained": ("success", "success (%)"),
}
SMOOTH = 8  # updates of the running mean


def main() -> None:
    """Draw the figure and print the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="runs/learning_curves.png", help="File of the figure.")
    parser.add_argument("--quick", action="store_true", help="As without; the script takes seconds.")
    options = parser.parse_args()
    figure, quarters = Figure(figsize=(11, 5.4), layout="constrained"), {}
    for ax, (name, (key, label)) in zip(figure.subplots(2, 3).flat, PANELS.items(), strict=True):
        meta = read_meta(WEIGHTS / name)
        frames, values = (np.array([row[column] for row in meta["curve"]]) for column in ("frames", key))
        ax.plot(frames, values, ".", ms=3, color="#0072B2", alpha=0.4)
        ax.plot(frames, uniform_filter1d(values, SMOOTH), color="#0072B2")
        ax.set(title=meta["policy"], xlabel="frames", ylabel=label, ylim=(0, None))
        ax.xaxis.set_major_formatter(EngFormatter(sep=""))
        ax.grid(alpha=0.3)
        quarters[meta["policy"]] = [round(float(part.mean()), 1) for part in np.array_split(values, 4)]
    figure.savefig(options.out, dpi=90)
    print(json.dumps(quarters))


if __name__ == "__main__":
    main()
