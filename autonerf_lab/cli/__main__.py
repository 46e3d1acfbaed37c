"""Entry point of ``python -m autonerf_lab.cli``."""

import sys

from autonerf_lab.cli import main

if __name__ == "__main__":
    sys.exit(main())
