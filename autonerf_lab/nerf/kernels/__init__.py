"""The CPU's inner loops, compiled by numba."""

import os

# Threads that wait should sleep, not spin: on two shared cores a spinning thread takes the time of the one it waits
# for. OpenMP reads this when the first parallel kernel starts.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
