"""Export results folders for a repository: their cells, and tables and plots of all of them together.

    python benchmarks/paper_grids.py --grids test/policies test/modular-obs
    python benchmarks/results/export.py runs/paper/test/* benchmarks/results/test

The output has one results folder per run, of the same name, without the figures of the cells, for `bench report`,
`bench compare` and `load_results_table`. Paths in the working directory become relative. A grid may be divided: runs of
the same name, with other scenes, become one results folder, and an earlier output may be one of them. Only scenes are
exported whose cells have all been run under all names, so that all rows are means over the same scenes. A cell that
failed is exported, too: the tables count it as null. Prints the median time per cell, which other load on the machine
changes little.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib import image
from matplotlib.figure import Figure

from autonerf_lab.benchmark import Results, load_results
from autonerf_lab.benchmark.export import table_files
from autonerf_lab.benchmark.figures import coverage_curves, scores_over_policies
from autonerf_lab.benchmark.grid import label
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.utils import storage


def trajectories(runs: list[Results]) -> Figure | None:
    """Plot the trajectory of each policy from one start in one scene in top view; None for runs without figures."""
    scene = runs[0].grid.scenes[0]
    files = (
        (label(cell.policy), run.path / "figures" / f"{cell.name}_trajectory.webp")
        for run in runs
        for cell in run.grid.cells()
        if (cell.scene, cell.start) == (scene, 0) and not cell.conditions
    )
    shown = {policy: file for policy, file in files if file.exists()}
    if not shown:
        return None
    columns = min(6, (len(shown) + 1) // 2)
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.axis("off")
    for ax, (policy, file) in zip(axes, shown.items(), strict=False):
        ax.imshow(image.imread(file))
        ax.set_title(policy)
    return figure


def relative(text: str) -> str:
    """Return a text with paths relative to the working directory."""
    return text.replace(f"{Path.cwd()}/", "")


def complete_scenes(runs: list[Results]) -> dict[str, Results]:
    """Return the scenes whose cells have all been run, each with the first run that has all of them.

    Scenes are named as in the output, with relative paths.
    """
    found: dict[str, Results] = {}
    for run in runs:
        ended = {outcome.cell for outcome in run.outcomes()}
        missing = {cell.scene for cell in run.grid.cells() if cell not in ended}
        found = {relative(scene): run for scene in run.grid.scenes if scene not in missing} | found
    return found


def copy_scenes(scenes: dict[str, Results], out: Path) -> None:
    """Copy the grid and the cells of some scenes of runs of one grid.

    Raises:
        SystemExit: The runs differ in more than their scenes.
    """
    texts: dict[Path, str] = {}
    digests: dict[str, str] = {}
    grids: dict[str, Path] = {}
    for scene, run in scenes.items():
        content = json.loads(relative((run.path / "grid.json").read_text(encoding="utf-8")))
        digests |= {name: sha for name, sha in content["grid"]["scene_files"].items() if name == label(scene)}
        content["grid"] |= {"scenes": None, "scene_files": None}
        grids[json.dumps(content, sort_keys=True)] = run.path
        files = [run.cell_file(cell) for cell in run.grid.cells() if relative(cell.scene) == scene]
        texts |= {file.relative_to(run.path): relative(file.read_text(encoding="utf-8")) for file in files}
    if len(grids) > 1:
        raise SystemExit(f"{' and '.join(map(str, grids.values()))} differ in more than their scenes (grid.json)")
    content = json.loads(next(iter(grids)))
    content["grid"] |= {"scenes": [*scenes], "scene_files": digests}
    texts[Path("grid.json")] = json.dumps(content, indent=1) + "\n"
    for file, text in texts.items():
        storage.write_bytes(out / file, text.encode())


def main() -> None:
    """Copy the cells, write the tables and draw the plots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="results folders of `bench run`")
    parser.add_argument("out", type=Path, help="output folder")
    arguments = parser.parse_args()
    runs = [load_results(path) for path in arguments.runs]
    names = dict.fromkeys(run.path.name for run in runs)
    complete = {name: complete_scenes([run for run in runs if run.path.name == name]) for name in names}
    everywhere = sorted(set.intersection(*map(set, complete.values())))
    if not everywhere:
        raise SystemExit("no scene is complete in all runs: nothing to export")
    for name, scenes in complete.items():
        copy_scenes({scene: scenes[scene] for scene in everywhere}, arguments.out / name)
    found = load_results_table(*(load_results(arguments.out / name) for name in names))
    for name, data in table_files(found).items():
        storage.write_bytes(arguments.out / name, data)
    scores_over_policies(found).savefig(arguments.out / "scores.png", dpi=70)
    coverage_curves(found).savefig(arguments.out / "curves.png", dpi=70)
    if (figure := trajectories(runs)) is not None:
        figure.savefig(arguments.out / "trajectories.jpg", dpi=110)

    seconds = [outcome.seconds for outcome in found.outcomes]
    print(f"{len(seconds)} cells; {np.median(seconds):.0f} s each (median), {sum(seconds) / 3600:.1f} h in total")


if __name__ == "__main__":
    main()
