"""Minutes, processor time and memory of each notebook of the course.

Every notebook runs in a fresh kernel and an empty folder, one after another. Processor time is that of the kernel and
its worker processes; a wall time is worth as much as the machine is idle. Cells above five seconds that show neither a
progress bar nor another output while they run are listed.

Run: python benchmarks/notebooks.py [--quick] [--notebooks 05 06] [--preset fast] [--out DIR]
"""

import argparse
import json
import os
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from autonerf_lab.course.assignments import select_notebooks

SLOW = 5.0  # seconds
USAGE = """\
import json, resource
_own, _workers = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(json.dumps([sum(u.ru_utime + u.ru_stime for u in (_own, _workers)), _own.ru_maxrss * 1024 / 1e9]))"""
LIVE = {"application/vnd.jupyter.widget-view+json"}  # bars of tqdm and controls are drawn while a cell runs


def seconds_of(cell: Any) -> float:
    """Return the duration of an executed cell, seconds."""
    stamps = cell.metadata.get("execution", {})
    if not {"iopub.execute_input", "shell.execute_reply"} <= set(stamps):
        return 0.0
    start, end = (datetime.fromisoformat(stamps[k]) for k in ("iopub.execute_input", "shell.execute_reply"))
    return (end - start).total_seconds()


def is_live(cell: Any) -> bool:
    """Tell whether a cell shows its progress: a bar, or a control that is drawn again."""
    return any(LIVE & set(out.get("data", {})) or out.get("name") == "stderr" for out in cell.get("outputs", []))


def measure(path: Path, size: str, out: Path | None) -> dict[str, Any]:
    """Run a notebook and return its row of the table; save it with its outputs to a folder, if there is one."""
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(USAGE))
    os.environ["AUTONERF_LAB_PRESET"] = size
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(notebook, timeout=1800, kernel_name="python3", resources={"metadata": {"path": folder}})
        client.execute()
    cpu, memory = json.loads(notebook.cells.pop().outputs[0].text)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, out / path.name)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    silent = {cell.id: round(seconds_of(cell)) for cell in code if seconds_of(cell) > SLOW and not is_live(cell)}
    minutes = sum(map(seconds_of, code)) / 60
    return {"notebook": path.stem, "minutes": minutes, "cpu_minutes": cpu / 60, "memory_gb": memory, "silent": silent}


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Preset smoke.")
    parser.add_argument("--preset", default="fast", help="Preset.")
    parser.add_argument("--notebooks", nargs="+", default=None, help="Numbers, such as 05 06.")
    parser.add_argument("--out", type=Path, default=None, help="Folder for the executed notebooks.")
    options = parser.parse_args()
    size = "smoke" if options.quick else options.preset
    rows = []
    print("| notebook | minutes | processor minutes | memory (GB) | silent cells above 5 s |\n|---|---|---|---|---|")
    for path in select_notebooks(options.notebooks):
        rows.append(measure(path, size, options.out))
        row = rows[-1]
        silent = ", ".join(f"{name} ({seconds} s)" for name, seconds in row["silent"].items()) or "none"
        figures = " | ".join(f"{row[key]:.1f}" for key in ("minutes", "cpu_minutes", "memory_gb"))
        print(f"| {row['notebook']} | {figures} | {silent} |", flush=True)
    print(json.dumps({"preset": size, "notebooks": rows}))


if __name__ == "__main__":
    main()
