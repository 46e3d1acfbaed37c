"""``autonerf-lab course``: the notebooks for a student, and as assignments for grading tools."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg, subcommand

from autonerf_lab.cli.options import option, split_names


@dataclass(frozen=True)
class CourseStartCommand:
    """Copy the notebooks into a folder and open them in JupyterLab."""

    folder: Annotated[Positional[Path], option(help="Folder for the notebooks; those that it holds are kept.")]
    overwrite: Annotated[bool, option(help="Replace notebooks of the same name, with the answers in them.")] = False
    no_browser: Annotated[bool, option(help="Start JupyterLab without a browser; it prints its address.")] = False
    copy_only: Annotated[bool, option(help="Copy the notebooks and stop.")] = False

    def run(self) -> None:
        """Copy, say what is missing, and run JupyterLab until it is stopped."""
        from autonerf_lab.course.notebooks import copy_notebooks, missing_parts, open_jupyterlab

        copied, kept = copy_notebooks(self.folder, self.overwrite)
        print(f"{self.folder}: {len(copied)} notebooks copied, {len(kept)} kept" + (" (see --overwrite)" * bool(kept)))
        for line in missing_parts():
            print(f"note: {line}")
        if not self.copy_only:
            open_jupyterlab(self.folder, browser=not self.no_browser)


@dataclass(frozen=True)
class CourseExportCommand:
    """Export the notebooks as assignments: student versions, and instructor versions with solutions and points."""

    to: Annotated[Literal["nbgrader", "otter"], arg(help="Grading tool; its extra must be installed.")]
    out: Annotated[Path, option(help="Output folder.")]
    notebooks: Annotated[
        str | None, option(metavar="A,B", help="Numbers of notebooks, such as 00,06.", default="all")
    ] = None

    def run(self) -> None:
        """Write the assignments and print the student versions."""
        from autonerf_lab import course

        for path in course.export(self.to, self.out, split_names(self.notebooks)):
            print(path)


@dataclass(frozen=True)
class CourseCommand:
    """Start the course as a student, or export it for a grading tool."""

    command: Annotated[CourseStartCommand, subcommand("start")] | Annotated[CourseExportCommand, subcommand("export")]

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()
