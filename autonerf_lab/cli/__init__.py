"""Command line ``autonerf-lab``: one module per command."""

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: Command-line arguments without the name of the program; None: those of the process.

    Returns:
        Exit code: 0, 1 after an error of the package, 130 after Ctrl-C.

    Raises:
        SystemExit: With code 0 after ``--help``, with code 2 after invalid arguments.
    """
    try:  # an interrupted import must not end with a traceback
        from autonerf_lab.cli.command_line import run

        return run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt as error:
        place = f" ({error})" if str(error) else ""  # the policy or reward that was running
        print(f"\ninterrupted{place}: run the same command again to continue", file=sys.stderr)
        return 130
