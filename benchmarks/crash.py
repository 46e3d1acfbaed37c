"""Kill a grid at random moments, run it again, and look for what was lost.

    python benchmarks/crash.py                 # 200 kills of a grid of smoke cells; an hour or two
    python benchmarks/crash.py --quick         # 6 kills, to see that it runs

One uninterrupted run says how long a cell takes and what the table must be. Then the same grid is begun in another
folder and killed (SIGKILL, the runner only: its workers have to notice) after a time drawn uniformly from the length of
a cell, so that no stage is spared; the same command goes on, and is killed again, and when the grid is finished before
the kills are spent, another one begins. After each kill every file of the results is read:

    unreadable  a JSON file that does not parse, or one that was cut off and not cleared away in the end
    lost        a finished cell or a finished stage of an unfinished one that was there before and is gone
    duplicated  one of these that is there again, made anew
    different   tables or scores (the column ``seconds`` aside) that are not those of the uninterrupted run

Prints a line for people and, as the last line, one JSON object.
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
from typing import Any

import pandas as pd

from autonerf_lab.run_folder import STAGES

Seen = dict[str, Any]  # cell or "cell stage" -> what would change if it were done again


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="6 kills")
    options = parser.parse_args()
    kills = 6 if options.quick else options.kills
    rng = random.Random(options.seed)
    counts: Counter[str] = Counter(kills=0, unreadable=0, lost=0, duplicated=0, different=0)
    stages: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        started = time.perf_counter()
        subprocess.run(command(whole, options.workers), check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - started
        print(f"uninterrupted: {seconds:.0f} s", flush=True)
        attempt = 0
        while counts["kills"] < kills:
            out = Path(folder) / f"killed-{attempt}"
            attempt += 1
            seen: Seen = {}
            while counts["kills"] < kills and kill_after(rng.uniform(0, seconds), out, options.workers):
                counts["kills"] += 1
                stages[stage_of(out)] += 1
                look(out, seen, counts)
            subprocess.run(command(out, options.workers), check=True, stdout=subprocess.DEVNULL)
            look(out, seen, counts)
            counts["unreadable"] += len([file for file in out.rglob(".*") if file.is_file()])
            counts["different"] += not same_tables(out, whole)
            print(f"{counts['kills']} kills: {dict(counts)}", flush=True)
    print(f"killed in: {dict(stages)}")
    print(json.dumps(counts))


def command(out: Path, workers: int) -> list[str]:
    """The grid: two policies in one apartment, as small as it gets."""
    words = f"bench run --policies random,frontier --scenes dev-0 --starts 1 --preset smoke --workers {workers} --out"
    return [sys.executable, "-m", "autonerf_lab.cli", *words.split(), str(out)]


def kill_after(seconds: float, out: Path, workers: int) -> bool:
    """Whether the grid had not ended by itself before."""
    process = subprocess.Popen(command(out, workers), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        process.wait(timeout=seconds)
        return False
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True


def stage_of(out: Path) -> str:
    """What the cell that was begun last was doing."""
    try:
        runs = sorted(out.glob("work/*/run/run.json"), key=lambda path: path.stat().st_mtime)
        if not runs:
            return "between cells"
        done = json.loads(runs[-1].read_text())["stages"]
    except FileNotFoundError:  # a worker that has not noticed yet clears away
        return "between cells"
    return next((stage for stage in STAGES[:4] if stage not in done), "exploration")


def look(out: Path, seen: Seen, counts: Counter[str]) -> None:
    """Read everything, and compare it with what was there before."""
    found: Seen = {}
    for file in out.rglob("*.json"):
        if file.name.startswith("."):
            continue  # cut off in writing: never read by anybody
        try:
            content = json.loads(file.read_text())
        except FileNotFoundError:
            continue  # a worker that has not noticed yet
        except ValueError:
            counts["unreadable"] += 1
            continue
        if file.parent.name == "cells":
            found[file.stem] = file.read_bytes()
        elif file.name == "run.json":
            found |= {f"{file.parts[-3]} {name}": row["finished"] for name, row in content["stages"].items()}
    for name, before in seen.items():
        if name in found:
            counts["duplicated"] += found[name] != before
        elif name.split()[0] not in found:
            counts["lost"] += 1
    seen.update(found)


def same_tables(out: Path, whole: Path) -> bool:
    """Byte by byte, but for the seconds."""
    scores = [pd.read_csv(folder / "scores.csv").drop(columns="seconds").to_csv() for folder in (out, whole)]
    tables = [[(folder / f"tables.{kind}").read_bytes() for kind in ("md", "tex", "html")] for folder in (out, whole)]
    return scores[0] == scores[1] and tables[0] == tables[1]


if __name__ == "__main__":
    main()
