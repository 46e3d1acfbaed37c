"""``autonerf-lab bench``: run a grid, compare two, write the page."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg, subcommand

from autonerf_lab.cli.options import NO_LPIPS, LpipsFile, names_of
from autonerf_lab.errors import DataError

if TYPE_CHECKING:
    from autonerf_lab.benchmark import Grid

# Heavy imports wait inside the commands: `--help` answers at once.


@dataclass(frozen=True)
class BenchRun:
    """Run every policy in every scene from every start, train every model, score it; write the tables.

    Interrupted, the same command goes on. A cell that fails is written down, and the others run.
    """

    out: Annotated[Path, arg(help="The results folder.")]
    policies: Annotated[
        str | None, arg(metavar="A,B", help="Names, .safetensors of your own, or: all, modular, e2e, paper.")
    ] = None
    scenes: Annotated[str | None, arg(metavar="A,B", help="Names, files, or: all, train, dev, val. val without.")] = (
        None
    )
    starts: Annotated[int | None, arg(help="Seeded starts in each scene; 5 without.")] = None
    models: Annotated[str | None, arg(metavar="A,B", help="Names, or all; semantic-nerfacto without.")] = None
    preset: Annotated[str | None, arg(metavar="NAME", help="smoke, fast or paper; AUTONERF_LAB_PRESET, else fast.")] = (
        None
    )
    grid: Annotated[
        str | None, arg(metavar="GRID", help="paper, or a Python file that sets GRID; instead of names.")
    ] = None
    optional: Annotated[
        str | None, arg(metavar="A,B", help="Tasks that take long: navigation (minutes a cell), finetuning (hours).")
    ] = None
    workers: Annotated[int, arg(help="Cells at a time, which share threads and memory; 0: in this process.")] = 1
    scheduler: Annotated[str | None, arg(metavar="ADDRESS", help="Of dask.distributed: its workers run the cells.")] = (
        None
    )
    timeout: Annotated[float | None, arg(help="Seconds a cell; 3600 without, 43200 with finetuning.")] = None
    memory_gb: Annotated[float | None, arg(help="A cell may hold; its share of the machine without.")] = None
    retry: Annotated[
        str | None, arg(metavar="A,B", help="Run again what is failed (all of it), timeout, oom or died.")
    ] = None
    keep: Annotated[bool, arg(help="Leave walk, field and figures of each cell in OUT/runs.")] = False
    dry_run: Annotated[bool, arg(help="Print the cells and what they will cost, and do nothing.")] = False
    lpips: LpipsFile = NO_LPIPS

    def run(self) -> None:
        """Run, and write scores and tables."""
        from autonerf_lab.benchmark import run_grid
        from autonerf_lab.benchmark.estimate import dry_run
        from autonerf_lab.benchmark.export import publish, summary
        from autonerf_lab.benchmark.results_table import collect

        grid = self._grid().checked()
        lpips, retry = self.lpips.load(), names_of(self.retry) or ()
        if self.dry_run:
            print(dry_run(grid, self.out, self.workers, retry, None if lpips is None else lpips.sha256))
            return
        results = run_grid(
            grid, self.out, self.workers, self.scheduler, self.timeout, self.memory_gb, retry, self.keep,
            lpips=self.lpips.lpips_weights,
        )  # fmt: skip
        print(f"\n{summary(collect(results))}")
        for path in publish(results):
            print(path)

    def _grid(self) -> "Grid":
        from autonerf_lab.benchmark.grid import Grid, load_grid
        from autonerf_lab.config import preset

        said: dict[str, Any] = {
            "policies": names_of(self.policies),
            "scenes": names_of(self.scenes),
            "starts": self.starts,
            "models": names_of(self.models),
        }
        said = {key: value for key, value in said.items() if value is not None}
        if self.grid is not None:
            if said:
                raise DataError(f"--grid {self.grid} says it all: leave --{next(iter(said))} out")
            grid = load_grid(self.grid)
            return replace(grid, preset=self.preset or grid.preset, optional=names_of(self.optional) or grid.optional)
        if "policies" not in said:
            raise DataError("name the --policies, such as random,frontier, or a --grid, such as paper")
        return Grid(
            **{"scenes": ("val",), **said}, preset=preset(self.preset).name, optional=names_of(self.optional) or ()
        )


@dataclass(frozen=True)
class BenchCompare:
    """How much more the second results folder has than the first, paired by scene and start."""

    first: Annotated[Positional[Path], arg(help="A results folder.")]
    second: Annotated[Positional[Path], arg(help="Another one.")]

    def run(self) -> None:
        """Print a table in Markdown."""
        from autonerf_lab.benchmark import load_results
        from autonerf_lab.benchmark.compare import compare
        from autonerf_lab.benchmark.results_table import collect

        print(compare(collect(load_results(self.first)), collect(load_results(self.second))).markdown())


@dataclass(frozen=True)
class BenchReport:
    """Write one page about a results folder, or about several in the same tables."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="FOLDER ...", help="Results folders.")]
    out: Annotated[Path | None, arg(help="The .html file; report.html in the first folder without.")] = None

    def run(self) -> None:
        """Draw and write."""
        from autonerf_lab.benchmark import load_results
        from autonerf_lab.benchmark.report import write_report

        if not self.folders:
            raise DataError("name at least one results folder")
        print(write_report([load_results(path) for path in self.folders], self.out or self.folders[0] / "report.html"))


@dataclass(frozen=True)
class Bench:
    """Grids of runs and the paper's tables for them."""

    command: (
        Annotated[BenchRun, subcommand("run")]
        | Annotated[BenchCompare, subcommand("compare")]
        | Annotated[BenchReport, subcommand("report")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()
