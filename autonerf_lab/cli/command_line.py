"""Parser and error handling of the command line.

Heavy packages are imported in the ``run`` methods of the commands, so that ``--help`` is fast.
"""

import contextlib
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro
from tyro.conf import subcommand

from autonerf_lab.cli.bench import BenchCommand
from autonerf_lab.cli.course import CourseCommand
from autonerf_lab.cli.demo import DemoCommand
from autonerf_lab.cli.episodes import EpisodesCommand
from autonerf_lab.cli.evaluate import EvaluateCommand
from autonerf_lab.cli.explore import ExploreCommand
from autonerf_lab.cli.export import AdoptCommand, ExportCommand
from autonerf_lab.cli.fit import FitCommand
from autonerf_lab.cli.lpips_weights import LpipsWeightsCommand
from autonerf_lab.cli.mesh import MeshCommand
from autonerf_lab.cli.options import option
from autonerf_lab.cli.play import PlayCommand
from autonerf_lab.cli.point_cloud import PointCloudCommand
from autonerf_lab.cli.refine_poses import RefinePosesCommand
from autonerf_lab.cli.report import ReportCommand
from autonerf_lab.cli.rewards import RewardsCommand
from autonerf_lab.cli.scenes import ScenesCommand
from autonerf_lab.cli.train_odometry import TrainOdometryCommand
from autonerf_lab.cli.train_policy import TrainPolicyCommand
from autonerf_lab.cli.train_segmentation import TrainSegmentationCommand
from autonerf_lab.cli.video import VideoCommand
from autonerf_lab.cli.view import ViewCommand
from autonerf_lab.errors import AutoNerfError
from autonerf_lab.utils import plugins
from autonerf_lab.utils.resources import claim_blas_buffers, is_out_of_memory
from autonerf_lab.utils.storage import is_disk_full
from autonerf_lab.version import __version__


@dataclass(frozen=True)
class CommandLine:
    """AutoNeRF Lab: autonomous exploration, semantic NeRFs and their evaluation for robotics tasks."""

    command: (
        Annotated[DemoCommand, subcommand("demo")]
        | Annotated[ScenesCommand, subcommand("scenes")]
        | Annotated[ExploreCommand, subcommand("explore")]
        | Annotated[RefinePosesCommand, subcommand("refine-poses")]
        | Annotated[PlayCommand, subcommand("play")]
        | Annotated[FitCommand, subcommand("fit")]
        | Annotated[EvaluateCommand, subcommand("evaluate")]
        | Annotated[EpisodesCommand, subcommand("episodes")]
        | Annotated[MeshCommand, subcommand("mesh")]
        | Annotated[ReportCommand, subcommand("report")]
        | Annotated[ExportCommand, subcommand("export")]
        | Annotated[AdoptCommand, subcommand("adopt")]
        | Annotated[PointCloudCommand, subcommand("point-cloud")]
        | Annotated[VideoCommand, subcommand("video")]
        | Annotated[ViewCommand, subcommand("view")]
        | Annotated[TrainPolicyCommand, subcommand("train-policy")]
        | Annotated[TrainSegmentationCommand, subcommand("train-segmentation")]
        | Annotated[TrainOdometryCommand, subcommand("train-odometry")]
        | Annotated[BenchCommand, subcommand("bench")]
        | Annotated[CourseCommand, subcommand("course")]
        | Annotated[RewardsCommand, subcommand("rewards")]
        | Annotated[LpipsWeightsCommand, subcommand("lpips-weights")]
    )
    debug: Annotated[bool, option(help="Show the traceback of an error.")] = False
    strict_plugins: Annotated[bool, option(help="Treat broken plug-ins as errors.")] = False
    version: Annotated[bool, option(help="Show the version and exit.")] = False


_STYLE = (
    tyro.conf.OmitSubcommandPrefixes,
    tyro.conf.OmitArgPrefixes,
    tyro.conf.CascadeSubcommandArgs,
    tyro.conf.FlagCreatePairsOff,
)


def run(arguments: Sequence[str]) -> int:
    """Run a command and return its exit code; see :func:`autonerf_lab.cli.main`."""
    if "--version" in arguments:  # needs no command
        print(f"autonerf-lab {__version__}")
        return 0
    debug = False
    try:
        parsed = tyro.cli(CommandLine, prog="autonerf-lab", args=arguments, config=_STYLE)
        debug = parsed.debug
        with plugins.strict() if parsed.strict_plugins else contextlib.nullcontext(), _plain_warnings():
            claim_blas_buffers()
            parsed.command.run()
        sys.stdout.flush()  # a full disk is reported here, not by the interpreter at its end
    except AutoNerfError as error:
        if debug:
            traceback.print_exc()
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if debug:
            traceback.print_exc()
        raise
    except BrokenPipeError:  # the reader of the pipe, such as `head`, has ended
        _discard_output()
    except Exception as error:
        if not debug and is_out_of_memory(error):
            print(
                f"error: out of memory ({str(error) or 'no details'}); raise its limit or end others", file=sys.stderr
            )
            return 1
        if debug or not isinstance(error, OSError) or not is_disk_full(error) or error.filename is not None:
            raise
        _discard_output()
        print(f"error: cannot write the output of the command: {error.strerror}", file=sys.stderr)
        return 1
    return 0


@contextlib.contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show a warning of the package, a UserWarning, like an error: in one line, without the code that raised it."""
    usual = warnings.formatwarning

    def plain(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
    ) -> str:
        if category is UserWarning:
            return f"warning: {message}\n"
        return usual(message, category, filename, lineno, line)

    warnings.formatwarning = plain
    try:
        yield
    finally:
        warnings.formatwarning = usual


def _discard_output() -> None:
    """Send standard output nowhere, so that the interpreter can flush it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
