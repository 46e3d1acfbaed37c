"""Kill a grid at random moments, run it again, and look for what was lost.

    python benchmarks/crash.py                 # 200 kills of a grid of smoke cells; an hour or two
    python benchmarks/crash.py --quick         # 6 kills, to see that it runs

One uninterrupted run says how long the grid takes and what the table must be. Then the same grid is begun in another
folder and killed (SIGKILL, the runner only: its workers have to notice) after a time drawn uniformly from the length of
the whole run, so that no cell and no stage is spared; the same command goes on, and is killed again, and when the grid
is finished before the kills are spent, another one begins. After each kill every file of the results is read, JSON,
CSV, Parquet, arrays and pictures, those of unfinished cells too:

    unreadable  a file that does not parse, or one that was cut off and not cleared away in the end
    lost        a finished cell or a finished stage of an unfinished one that was there before and is gone
    duplicated  one of these that is there again, made anew
    different   tables or scores (the column ``seconds`` aside) that are not those of the uninterrupted run

Prints a line for people and, as the last line, one JSON object, with the stages that were hit. Exits with 1 if anything
was found, or if a hundred kills have spared a stage.
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

Seen = dict[str, Any]  # cell or "cell stage" -> what would change if it were done again
HIT = (*STAGES[:4], "exploration")  # what a cell does, one after the other
ENOUGH = 100  # kills that must have hit all of it


def main() -> None:
    """Kill, look, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="6 kills")
    options = parser.parse_args()
    kills = 6 if options.quick else options.kills
    rng = random.Random(options.seed)
    found: Counter[str] = Counter(unreadable=0, lost=0, duplicated=0, different=0)
    stages: Counter[str] = Counter(dict.fromkeys(HIT, 0))
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
                look(out, seen, found)
            subprocess.run(command(out, options.workers), check=True, stdout=subprocess.DEVNULL)
            look(out, seen, found)
            found["unreadable"] += sum(file.is_file() for file in out.rglob(".*"))
            found["different"] += not same_tables(out, whole)
            print(f"{done} kills: {dict(found)}", flush=True)
    spared = [stage for stage in HIT if not stages[stage]]
    print(f"killed in: {dict(stages)}" + (f"; never in {', '.join(spared)}" if spared else ""))
    print(json.dumps({"kills": done, **found, "stages": stages}))
    sys.exit(1 if found.total() or (spared and done >= ENOUGH) else 0)


def command(out: Path, workers: int) -> list[str]:
    """The grid: two policies from two starts in one apartment, so that some cells begin where others have ended."""
    words = f"bench run --policies random,frontier --scenes dev-0 --starts 2 --preset smoke --workers {workers} --out"
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


def stages_of(out: Path) -> list[str]:
    """What the cells that were under way were doing: as many as there are workers, or nothing yet."""
    stages = []
    for path in out.glob("work/*/run/run.json"):
        try:
            done = read_json(path)["stages"]
        except ValueError:  # a worker that has not noticed yet clears away
            continue
        stages.append(next((stage for stage in STAGES[:4] if stage not in done), "exploration"))
    return stages or ["between cells"]


def read_picture(file: Path) -> None:
    """Every pixel of it."""
    with Image.open(file) as image:
        image.load()


READERS: dict[str, Callable[[Path], Any]] = {
    ".json": read_json,
    ".csv": pd.read_csv,
    ".parquet": pd.read_parquet,
    ".safetensors": read_arrays,
    ".png": read_picture,
    ".webp": read_picture,
}


def unfinished_walk(file: Path) -> bool:
    """Whether it is a frame that nobody will read: transforms.json says that a walk is whole, and is written last."""
    return file.name.startswith("frame_") and not (file.parents[1] / "transforms.json").exists()


def look(out: Path, seen: Seen, counts: Counter[str]) -> None:
    """Read everything, and compare it with what was there before."""
    found: Seen = {}
    for file in out.rglob("*"):
        if file.name.startswith(".") or file.suffix not in READERS:
            continue  # cut off in writing: never read by anybody; or text, which any bytes are
        try:
            content = READERS[file.suffix](file)
            whole = file.read_bytes()
        except (OSError, ValueError) as error:
            if file.exists() and not unfinished_walk(file):  # else a worker that has not noticed yet clears away
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
    """Byte by byte, but for the seconds."""
    scores = [pd.read_csv(folder / "scores.csv").drop(columns="seconds").to_csv() for folder in (out, whole)]
    tables = [[(folder / f"tables.{kind}").read_bytes() for kind in ("md", "tex", "html")] for folder in (out, whole)]
    return scores[0] == scores[1] and tables[0] == tables[1]


if __name__ == "__main__":
    main()
