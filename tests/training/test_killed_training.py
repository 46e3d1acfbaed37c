"""A training whose process is killed, and continued by the same call."""

import json
import signal
import subprocess
import sys
from dataclasses import asdict

import numpy as np
from interrupted_training import TINY
from safetensors.numpy import load_file

from autonerf_lab.training import train

KILLED = """
import json, os, signal, sys
from autonerf_lab.training import session
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.training.train import train_policy

if __name__ == "__main__":
    session.SAVE_EVERY, rows = 0.0, []

    def kill_in_the_third(row):
        rows.append(row)
        if len(rows) == 3:
            os.kill(os.getpid(), signal.SIGKILL)

    settings = PolicySettings(**json.loads(sys.argv[2]))
    train_policy("modular-cov", sys.argv[1], settings, workers=2, progress=False, callback=kill_in_the_third)
"""


def test_a_killed_training_continues_with_the_same_bits(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    command = [sys.executable, str(script), str(tmp_path / "parts"), json.dumps(asdict(TINY))]
    killed = subprocess.run(command, check=False)
    assert killed.returncode == -signal.SIGKILL and (tmp_path / "parts" / train.CHECKPOINT).exists()
    assert not (tmp_path / "parts/policy.safetensors").exists()
    whole, parts = (
        train.train_policy("modular-cov", tmp_path / name, TINY, workers=1, progress=False)
        for name in ("whole", "parts")
    )
    before, after = (load_file(path.with_suffix(".safetensors")) for path in (whole, parts))
    assert before.keys() == after.keys()
    assert all(np.array_equal(value, after[name]) for name, value in before.items())
    assert (tmp_path / "whole/curve.csv").read_text() == (tmp_path / "parts/curve.csv").read_text()
