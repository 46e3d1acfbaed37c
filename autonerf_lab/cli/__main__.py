"""``python -m autonerf_lab.cli``."""

import sys

from autonerf_lab.cli.main import main

sys.exit(main())
