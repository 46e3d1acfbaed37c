"""``autonerf-lab bench``: run a grid, compare results folders, write a report."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, subcommand

from autonerf_lab.cli.options import (
    NO_LPIPS,
    DepthNoiseName,
    Device,
    LpipsOptions,
    NoiseName,
    NoiseScale,
    OptionalTasks,
    PosesName,
    PresetName,
    SemanticsName,
    option,
    split_names,
)
from autonerf_lab.errors import DataError, RunFolderError

if TYPE_CHECKING:
    from autonerf_lab.benchmark import Grid


@dataclass(frozen=True)
class BenchRunCommand:
    """Run a grid of policies, scenes, starts and models, and write the result tables.

    After an interruption, the same command continues. A failed cell is recorded, and the other cells run.
    """

    out: Annotated[Path, option(help="Results folder.")]
    policies: Annotated[
        str | None,
        option(
            metavar="A,B",
            help="Names, .safetensors files, module:Class, or: all, modular, e2e, paper. Not with --grid.",
        ),
    ] = None
    scenes: Annotated[
        str | None,
        option(metavar="A,B", help="Names, files, or: all, train, dev, val, test, house.", default="val"),
    ] = None
    starts: Annotated[int | None, option(metavar="N", help="Number of start poses per scene.", default="5")] = None
    models: Annotated[
        str | None,
        option(metavar="A,B", help="Names of models, or all.", default="semantic-nerfacto"),
    ] = None
    preset: PresetName = None
    grid: Annotated[
        str | None,
        option(
            metavar="GRID",
            help="Grid that replaces policies, scenes, starts and models: paper, or a Python file that sets GRID.",
        ),
    ] = None
    optional: OptionalTasks = None
    noise: NoiseName = None
    noise_scale: NoiseScale = None
    depth_noise: DepthNoiseName = None
    poses: PosesName = None
    semantics: SemanticsName = None
    baselines: Annotated[
        bool,
        option(help="Also score the oracle, the nearest view and the fused depth, and the field by the paper's code."),
    ] = False
    workers: Annotated[int, option(help="Number of worker processes; 0: run in this process.")] = 1
    scheduler: Annotated[
        str | None, option(metavar="ADDRESS", help="Address of a dask.distributed scheduler that runs the cells.")
    ] = None
    timeout: Annotated[
        float | None,
        option(
            metavar="X",
            help="Time limit per cell in seconds.",
            default="3600; with finetuning: 43200",
        ),
    ] = None
    memory_gb: Annotated[
        float | None,
        option(metavar="X", help="Memory limit per cell in GB.", default="an equal share of 90 % of the memory"),
    ] = None
    retry: Annotated[
        str | None,
        option(
            metavar="A,B",
            help="Run cells with this status again: timeout, oom, died; or failed: all cells that have not succeeded.",
        ),
    ] = None
    save_runs: Annotated[bool, option(help="Save the run folder of each cell in OUT/runs.")] = False
    device: Device = None
    dry_run: Annotated[bool, option(help="Print the cells and the estimated cost, and exit.")] = False
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Run the grid and write scores and tables."""
        from autonerf_lab.benchmark import run_grid
        from autonerf_lab.benchmark.cost_estimate import dry_run
        from autonerf_lab.benchmark.export import export_results, summary
        from autonerf_lab.benchmark.results_table import load_results_table

        grid = self._grid().checked()
        lpips, retry = self.lpips.load(), split_names(self.retry) or ()
        if self.dry_run:
            print(dry_run(grid, self.out, self.workers, retry, None if lpips is None else lpips.sha256))
            return
        results = run_grid(
            grid, self.out, self.workers, self.scheduler, self.timeout, self.memory_gb, retry, self.save_runs,
            lpips=self.lpips.lpips_weights, device=self.device,
        )  # fmt: skip
        found = load_results_table(results)
        print(f"\n{summary(found)}")
        for path in export_results(found, results.path):
            print(path)

    def _grid(self) -> "Grid":
        from autonerf_lab.benchmark.grid import CONDITIONS, Grid, load_grid
        from autonerf_lab.presets import preset

        chosen: dict[str, Any] = {
            "policies": split_names(self.policies),
            "scenes": split_names(self.scenes),
            "starts": self.starts,
            "models": split_names(self.models),
        }
        chosen = {key: value for key, value in chosen.items() if value is not None}
        noise = {key: getattr(self, key) for key in CONDITIONS if getattr(self, key) is not None}
        if self.grid is not None:
            if chosen:
                raise DataError(f"--grid {self.grid} defines the whole grid: remove --{next(iter(chosen))}")
            grid = load_grid(self.grid)
            return replace(
                grid, preset=self.preset or grid.preset, optional=split_names(self.optional) or grid.optional,
                baselines=self.baselines or grid.baselines, **noise,
            )  # fmt: skip
        if "policies" not in chosen:
            raise DataError("no policies: give --policies, such as random,frontier, or --grid, such as paper")
        return Grid(
            **{"scenes": ("val",), **chosen, **noise},
            preset=preset(self.preset).name,
            optional=split_names(self.optional) or (),
            baselines=self.baselines,
        )


@dataclass(frozen=True)
class BenchCompareCommand:
    """Compare results folders: a leaderboard, and the difference of each folder from the first."""

    folders: Annotated[Positional[tuple[Path, ...]], option(metavar="FOLDER ...", help="Two or more results folders.")]

    def run(self) -> None:
        """Print Markdown tables."""
        from autonerf_lab.benchmark import load_results
        from autonerf_lab.benchmark.compare import compare
        from autonerf_lab.benchmark.leaderboard import leaderboard
        from autonerf_lab.benchmark.results_table import load_results_table

        if len(self.folders) < 2:
            raise DataError("nothing to compare: give at least two results folders")
        first, *others = tables = [load_results_table(load_results(path)) for path in self.folders]
        made = [compare(first, other) for other in others]
        try:
            print(leaderboard({str(path): found for path, found in zip(self.folders, tables, strict=True)}).markdown())
        except RunFolderError as error:  # the differences may have values
            print(f"no leaderboard: {error}")
        for path, table in zip(self.folders[1:], made, strict=True):
            print(f"\n{path} minus {self.folders[0]}\n\n{table.markdown()}")


@dataclass(frozen=True)
class BenchReportCommand:
    """Write a report of one or more results folders: static pages with tables, figures, a leaderboard and cards.

    The output folder also has the scores (CSV) and the tables (Markdown, LaTeX, HTML) of all folders together.
    """

    folders: Annotated[Positional[tuple[Path, ...]], option(metavar="FOLDER ...", help="One or more results folders.")]
    out: Annotated[Path | None, option(metavar="DIR", help="Output folder.", default="report in the first folder")] = (
        None
    )

    def run(self) -> None:
        """Write the report."""
        from autonerf_lab.benchmark import load_results
        from autonerf_lab.benchmark.report import write_report

        if not self.folders:
            raise DataError("no results folder: give at least one")
        print(write_report([load_results(path) for path in self.folders], self.out or self.folders[0] / "report"))


@dataclass(frozen=True)
class BenchLpipsCommand:
    """Add LPIPS to the finished cells of a results folder, from the fields that --save-runs saved."""

    folder: Annotated[Positional[Path], option(help="Results folder.")]
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Compute LPIPS and write the tables again."""
        from autonerf_lab.benchmark import load_results
        from autonerf_lab.benchmark.add_lpips import add_lpips
        from autonerf_lab.benchmark.export import export_results
        from autonerf_lab.benchmark.results_table import load_results_table

        network = self.lpips.load()
        if network is None:
            raise DataError("no weights: give --lpips-weights; `autonerf-lab lpips-weights FILE` writes them")
        results = add_lpips(load_results(self.folder, to_run=True), network)
        for path in export_results(load_results_table(results), results.path):
            print(path)


@dataclass(frozen=True)
class BenchCommand:
    """Benchmarks: run grids and make the tables of the paper."""

    command: (
        Annotated[BenchRunCommand, subcommand("run")]
        | Annotated[BenchCompareCommand, subcommand("compare")]
        | Annotated[BenchReportCommand, subcommand("report")]
        | Annotated[BenchLpipsCommand, subcommand("lpips")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()
