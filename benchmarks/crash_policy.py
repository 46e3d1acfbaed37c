"""Kill the training of a policy at random times, continue it, and check that the result is that of an unkilled one.

    python benchmarks/crash_policy.py            # 200 kills of a tiny training with two worker processes
    python benchmarks/crash_policy.py --quick    # 3 kills, as a check of the script

An uninterrupted training measures the duration and gives the reference weights and learning curve. The same training
then runs in another folder and is killed (SIGKILL, the main process only; its workers must stop by themselves) after a
uniform random time within that duration; the same call continues it and is killed again, until it ends and a new one
begins. The training learns a reward too, and writes a checkpoint between any two rollouts.

    unreadable  a checkpoint that cannot be read after a kill
    lost        frames of the last checkpoint that were lost
    different   weights, learning curve or checkpoint that differ from those of the uninterrupted training
    orphans     worker processes that run on a minute after the kill

The last line of the output is JSON; the exit code is 1 if one of these is found.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import psutil

from autonerf_lab.errors import DataError
from autonerf_lab.training.checkpoint import CHECKPOINT
from autonerf_lab.training.session import CheckpointHeader
from autonerf_lab.utils.storage import read_arrays

TRAINING = """
import sys
from autonerf_lab.training import session
from autonerf_lab.training.settings import settings_of
from autonerf_lab.training.train import train_policy

if __name__ == "__main__":
    session.SAVE_EVERY = 0.0
    settings = settings_of("e2e-cur", frames=400, environments=2, rollout=20, epochs=1, batch=8, sensor=16, episode=20,
                           scenes=("train-00",))
    train_policy("e2e-cur", sys.argv[1], settings, workers=2, progress=False)
"""
FILES = ("policy.safetensors", "curve.csv")


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="3 kills")
    options = parser.parse_args()
    kills = 3 if options.quick else options.kills
    rng = random.Random(options.seed)
    found: Counter[str] = Counter(unreadable=0, lost=0, different=0, orphans=0)
    done = attempt = resumed = 0
    with tempfile.TemporaryDirectory() as folder:
        script, whole = Path(folder) / "training.py", Path(folder) / "whole"
        script.write_text(TRAINING)
        started = time.perf_counter()
        subprocess.run([sys.executable, str(script), str(whole)], check=True)
        seconds = time.perf_counter() - started
        print(f"uninterrupted: {seconds:.0f} s", flush=True)
        while done < kills:
            out, frames = Path(folder) / f"killed-{attempt}", 0
            attempt += 1
            command = [sys.executable, str(script), str(out)]
            while done < kills and kill_after(rng.uniform(0, seconds), command, found):
                done += 1
                if (out / CHECKPOINT).exists():
                    resumed += 1
                    frames = check_checkpoint(out / CHECKPOINT, frames, found)
            subprocess.run(command, check=True)
            found["different"] += sum((out / name).read_bytes() != (whole / name).read_bytes() for name in FILES)
            found["different"] += not same_arrays(out / CHECKPOINT, whole / CHECKPOINT)
            print(f"{done} kills, {resumed} with a checkpoint: {dict(found)}", flush=True)
    print(json.dumps({"kills": done, "with_checkpoint": resumed, **found}))
    sys.exit(1 if found.total() else 0)


def kill_after(seconds: float, command: list[str], found: Counter[str]) -> bool:
    """Train and kill the training after some seconds; return False if it has finished before."""
    process = subprocess.Popen(command)
    try:
        process.wait(timeout=seconds)
        return False
    except subprocess.TimeoutExpired:
        workers = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        process.wait()
        alive = psutil.wait_procs(workers, timeout=60)[1]
        found["orphans"] += len(alive)
        return True


def check_checkpoint(path: Path, frames: int, found: Counter[str]) -> int:
    """Read a checkpoint and return its frames, at least those of the checkpoint before."""
    try:
        header = read_arrays(path, CheckpointHeader)[1]
    except DataError as error:
        print(f"unreadable: {error}", flush=True)
        found["unreadable"] += 1
        return frames
    found["lost"] += header.frames < frames
    return header.frames


def same_arrays(one: Path, other: Path) -> bool:
    """Return True if the arrays of two checkpoints are equal bit for bit; their headers hold times."""
    a, b = (read_arrays(path, CheckpointHeader)[0] for path in (one, other))
    return a.keys() == b.keys() and all(a[name].tobytes() == b[name].tobytes() for name in a)


if __name__ == "__main__":
    main()
