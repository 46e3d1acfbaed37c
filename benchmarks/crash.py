"""Kill the run of a grid at random times, continue it, and check that no result is lost.

    python benchmarks/crash.py                 # 200 kills of a grid of smoke cells; an hour or two
    python benchmarks/crash.py --quick         # 6 kills, as a check of the script

An uninterrupted run measures the duration and gives the reference tables. The same grid then runs in another folder and
is killed (SIGKILL, the main process only; its workers must stop by themselves) after a uniform random time within that
duration. The same command continues the run and is killed again; a finished grid is followed by a new one. After each
kill, all files of the results are read, including those of unfinished cells:

    unreadable  a file that cannot be read, or a temporary file that is left at the end
    lost        a finished cell, or a finished stage of an unfinished cell, that has disappeared
    duplicated  a finished cell or stage that was computed again
    different   tables or scores (except the column ``seconds``) that differ from the uninterrupted run

Prints a summary and, as the last line, one JSON object with the stages that were hit. The exit code is 1 if an error is
found, or if a stage is never hit in a hundred kills.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from autonerf_lab.pipeline.run_folder import STAGES
from autonerf_lab.utils.storage import read_arrays, read_json

Seen = dict[str, Any]  # cell or "cell stage" -> content that changes if it is computed again
CELL_STAGES = (*STAGES[:4], "exploration")  # stages of a cell, in order
MIN_KILLS = 100  # number of kills that must hit every stage


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="6 kills")
    options = parser.parse_args()
    kills = 6 if options.quick else options.kills
    rng = random.Random(options.seed)
    found: Counter[str] = Counter(unreadable=0, lost=0, duplicated=0, different=0)
    stages: Counter[str] = Counter(dict.fromkeys(CELL_STAGES, 0))
    done = attempt = 0
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        started = time.perf_counter()
        subprocess.run(command(whole, options.workers), check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - started
        print(f"uninterrupted: {seconds:.0f} s", flush=True)
        while done < kills:
            out = Path(folder) / f"killed-{attempt}"
            attempt += 1
            seen: Seen = {}
            while done < kills and kill_after(rng.uniform(0, seconds), out, options.workers):
                done += 1
                stages.update(stages_of(out))
                check_files(out, seen, found)
            subprocess.run(command(out, options.workers), check=True, stdout=subprocess.DEVNULL)
            check_files(out, seen, found)
            found["unreadable"] += sum(file.is_file() for file in out.rglob(".*"))
            found["different"] += not same_tables(out, whole)
            print(f"{done} kills: {dict(found)}", flush=True)
    missed = [stage for stage in CELL_STAGES if not stages[stage]]
    print(f"killed in: {dict(stages)}" + (f"; never in {', '.join(missed)}" if missed else ""))
    print(json.dumps({"kills": done, **found, "stages": stages}))
    sys.exit(1 if found.total() or (missed and done >= MIN_KILLS) else 0)


def command(out: Path, workers: int) -> list[str]:
    """Return the command of the grid: two policies, two starts, one scene; more cells than workers."""
    words = f"bench run --policies random,frontier --scenes dev-0 --starts 2 --preset smoke --workers {workers} --out"
    return [sys.executable, "-m", "autonerf_lab.cli", *words.split(), str(out)]


def kill_after(seconds: float, out: Path, workers: int) -> bool:
    """Run the grid and kill it after some seconds; return False if it has finished before."""
    process = subprocess.Popen(command(out, workers), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        process.wait(timeout=seconds)
        return False
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True


def stages_of(out: Path) -> list[str]:
    """Return the current stages of the running cells; at most one per worker."""
    stages = []
    for path in out.glob("work/*/run/run.json"):
        try:
            done = read_json(path, dict[str, Any])["stages"]
        except ValueError:  # a worker that is still running removes the folder
            continue
        stages.append(next((stage for stage in STAGES[:4] if stage not in done), "exploration"))
    return stages or ["between cells"]


def read_image(file: Path) -> None:
    """Read all pixels of an image."""
    with Image.open(file) as image:
        image.load()


READERS: dict[str, Callable[[Path], Any]] = {
    ".json": lambda file: json.loads(file.read_bytes()),
    ".csv": pd.read_csv,
    ".parquet": pd.read_parquet,
    ".safetensors": lambda file: read_arrays(file, dict[str, Any]),
    ".png": read_image,
    ".webp": read_image,
}


def check_files(out: Path, seen: Seen, counts: Counter[str]) -> None:
    """Read all files and compare the finished cells and stages with those seen before."""
    found: Seen = {}
    for file in out.rglob("*"):
        if file.name.startswith(".") or file.suffix not in READERS:
            continue  # a temporary file or a text file
        try:
            content = READERS[file.suffix](file)
            whole = file.read_bytes()
        except (OSError, ValueError) as error:
            if file.exists():  # a running worker may have removed it
                print(f"unreadable: {file}: {error}", flush=True)
                counts["unreadable"] += 1
            continue
        if file.parent.name == "cells":
            found[file.stem] = whole
        elif file.name == "run.json":
            found |= {f"{file.parts[-3]} {name}": row["finished"] for name, row in content["stages"].items()}
    for name, before in seen.items():
        if name in found:
            counts["duplicated"] += found[name] != before
        elif name.split()[0] not in found:
            counts["lost"] += 1
    seen.update(found)


def same_tables(out: Path, whole: Path) -> bool:
    """Return True if scores (except ``seconds``) and tables are equal byte by byte."""
    scores = [pd.read_csv(folder / "scores.csv").drop(columns="seconds").to_csv() for folder in (out, whole)]
    tables = [[(folder / f"tables.{kind}").read_bytes() for kind in ("md", "tex", "html")] for folder in (out, whole)]
    return scores[0] == scores[1] and tables[0] == tables[1]


if __name__ == "__main__":
    main()
