"""Mutation testing: change one operator or number of a module at a time; a test of the module should fail each time.

    pip install cosmic-ray                                                  # 8.7; not a dependency of the package
    python benchmarks/mutation/mutate.py --sample 40                        # 40 mutants of each module
    python benchmarks/mutation/mutate.py --module evaluators/planning       # every mutant of one module
    python benchmarks/mutation/mutate.py --show --module evaluators/maps    # results so far; runs nothing

A mutant is a copy of a module with one change: a comparison, an arithmetic or logical operator, a condition negated, a
loop that runs no iteration, an integer plus or minus one, or a float times 1.1 or 0.5. Annotations stay as they are.
Tests run in a copy of the repository, each mutant in a forked process with the tests and doctests of its module only
(:data:`TESTS`), until the first failure. A mutant is killed if a test fails, or if the tests take more than five times
the CPU time of the unchanged module.

``--sample N`` takes the N mutants with the smallest hash of the seed and the changed line, so that changes elsewhere in
the module keep the sample. Results are stored in ``runs/mutation``: an interrupted run continues. A survivor runs
again if the tests have changed, a killed mutant only with ``--fresh``. Mutants that no test can kill, because they
change nothing that a caller can observe, are listed in ``survivors.md`` beside this script, with the reason; they do
not count. The exit code is 1 if less than 90 % of the others are killed. The last line of the output is JSON.
"""

import argparse
import ast
import hashlib
import importlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "runs/mutation"
SURVIVORS = Path(__file__).with_name("survivors.md")
COPIED = ("autonerf_lab", "tests", "benchmarks", "examples", "pyproject.toml")
# Imported before the forks, so that a mutant costs its tests and not these imports
PRELOADED = (
    *("numpy", "numba", "scipy.stats", "scipy.ndimage", "scipy.spatial", "skimage.metrics", "skimage.measure"),
    *("torch", "trimesh.creation", "pandas", "msgspec", "safetensors.numpy", "flip_evaluator", "gymnasium"),
    *("torchmetrics.functional", "torchmetrics.functional.image", "PIL.Image", "embreex", "shapely", "pytest"),
)
MIN_RATE = 90.0  # percent
CPU_FACTOR, CPU_EXTRA = 5, 10.0  # a mutant may take this many times the CPU time of the unchanged module, plus seconds
WALL_FACTOR = 10  # limit of the wall-clock time, relative to that of the CPU time

TESTS = {  # module -> its tests; the fastest first
    "benchmark/statistics": ("tests/benchmark/test_statistics.py",),
    "benchmark/fingerprint": ("tests/benchmark/test_fingerprint.py",),
    "evaluators/coverage": ("tests/evaluators/test_coverage.py",),
    "evaluators/maps": ("tests/evaluators/test_maps.py",),
    "evaluators/mesh": ("tests/evaluators/test_mesh.py",),
    "evaluators/mesh_metrics": ("tests/evaluators/test_mesh.py",),
    "evaluators/planning": ("tests/evaluators/test_planning.py",),
    "evaluators/pose_refinement": ("tests/evaluators/test_pose_refinement.py",),
    "evaluators/rendering": ("tests/evaluators/test_rendering.py",),
    "evaluators/semantic_maps": ("tests/evaluators/test_maps.py",),
    "mapping/semantic_map": ("tests/mapping/test_semantic_map.py",),
    "nerf/checkpoint": ("tests/nerf/test_checkpoint.py",),
    "planning/dilation": ("tests/planning/test_planning.py",),
    "planning/fast_marching": ("tests/planning/test_planning.py",),
    "planning/local_policy": ("tests/planning/test_local_policy.py",),
    "rewards/base": ("tests/rewards/test_base.py",),
    "rewards/weighted_sum": ("tests/rewards/test_rewards.py",),
    "training/checkpoint": ("tests/training/test_checkpoint.py",),
    "utils/storage": ("tests/utils/test_storage.py",),
}

_SWAPS = {
    "ReplaceComparisonOperator": "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot "
    "IsNot_Is",
    "ReplaceBinaryOperator": "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Mul Mod_Mul Pow_Mul BitAnd_BitOr BitOr_BitAnd "
    "BitXor_BitAnd LShift_RShift RShift_LShift",
    "ReplaceUnaryOperator": "USub_UAdd Delete_Not Delete_Invert",
}
_OTHERS = (
    *("AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "NumberReplacer"),
)
FACTORS = (1.1, 0.5)  # of a float


@dataclass(frozen=True)
class Mutant:
    """One change of a module."""

    id: str  # hash of the module, the change and the changed lines
    line: int  # first changed line, from 1
    change: str  # old -> new text of the changed lines
    source: str  # of the mutated module


@dataclass(frozen=True)
class Result:
    """Outcome of the tests of a mutant."""

    id: str
    line: int
    change: str
    outcome: str  # killed, timeout or survived
    tests: str  # hash of the tests
    seconds: float  # CPU time


def main() -> int:
    """Run the mutants and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--module", nargs="*", choices=TESTS, default=list(TESTS), metavar="MODULE")
    parser.add_argument("--sample", type=int, help="number of mutants of each module; default: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--fresh", action="store_true", help="run killed mutants again")
    parser.add_argument("--show", action="store_true", help="print the stored results only")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        if not options.show:
            _prepare(copy)
        for name in options.module:
            rows.append(_run_module(name, copy, options))
    total = {key: sum(row[key] for row in rows) for key in rows[0] if key != "module"}
    print(f"{'module':30}" + "".join(f"{key:>12}" for key in total) + f"{'rate':>8}")
    for row in [*rows, {"module": "all", **total}]:
        print(f"{row['module']:30}" + "".join(f"{row[key]:12}" for key in total) + f"{_rate(row):7.1f}%")
    print(json.dumps({"rate": round(_rate(total), 1), **total, "modules": {row["module"]: _rate(row) for row in rows}}))
    return int(_rate(total) < MIN_RATE)


def _rate(counts: dict[str, Any]) -> float:
    """Return the percentage of the mutants that are not equivalent that were killed."""
    return 100 * counts["killed"] / max(1, counts["killed"] + counts["survived"])


def _prepare(copy: Path) -> None:
    """Copy the repository, and import what all tests use."""
    ignored = shutil.ignore_patterns("__pycache__", "results")
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=ignored)
        else:
            shutil.copy(source, copy)
    for name in ("data", "benchmarks/results"):  # large, and only read
        (copy / name).symlink_to(ROOT / name)
    sys.path.insert(0, str(copy))
    os.environ |= {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy / "numba"), "MPLBACKEND": "Agg"}
    for module in PRELOADED:
        importlib.import_module(module)


def _run_module(name: str, copy: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Run the mutants of a module that have no result, print its survivors, and count the outcomes."""
    path = ROOT / f"autonerf_lab/{name}.py"
    found = mutants(name, path.read_text(), options.sample, options.seed)
    store = RESULTS / f"{name.replace('/', '.')}.jsonl"
    tests = _tests_hash(name)
    stored = {}
    if store.exists():
        lines = (Result(**json.loads(line)) for line in store.read_text().splitlines())
        stored = {result.id: result for result in lines}
    usable = {
        id: result
        for id, result in stored.items()
        if (result.tests == tests or (result.outcome != "survived" and not options.fresh))
    }
    todo = [mutant for mutant in found if mutant.id not in usable]
    if todo and not options.show:
        store.parent.mkdir(parents=True, exist_ok=True)
        target = copy / f"autonerf_lab/{name}.py"
        _test(name, target, path.read_text(), 1e4, bytecode=True)  # compiles what the mutants share
        outcome, base = _test(name, target, path.read_text(), 1e4)
        if outcome != "survived":
            raise SystemExit(f"{name}: the tests fail without a mutant; run them with pytest")
        limit = CPU_FACTOR * base + CPU_EXTRA
        print(f"{name}: {len(todo)} of {len(found)} mutants to run, {base:.1f} s of CPU time each", flush=True)
        for mutant in todo:
            outcome, seconds = _test(name, target, mutant.source, limit)
            result = Result(mutant.id, mutant.line, mutant.change, outcome, tests, round(seconds, 2))
            usable[mutant.id] = result
            with store.open("a") as file:
                file.write(json.dumps(asdict(result)) + "\n")
        target.write_text(path.read_text())
    listed = SURVIVORS.read_text().partition("## Not equivalent")[0]
    equivalent = set(re.findall(r"^\| `([0-9a-f]{10})` \|", listed, re.MULTILINE))
    counts = Counter(mutants=len(found), run=0, killed=0, survived=0, equivalent=0)
    for mutant in found:
        if mutant.id not in usable:
            continue
        survived = usable[mutant.id].outcome == "survived"
        counts["run"] += 1
        counts["equivalent" if survived and mutant.id in equivalent else "survived" if survived else "killed"] += 1
        if survived and mutant.id not in equivalent:
            print(f"survived: {mutant.id} autonerf_lab/{name}.py:{mutant.line}: {mutant.change}")
    return {"module": name, **counts}


def _tests_hash(name: str) -> str:
    files = [ROOT / test for test in TESTS[name]] + sorted((ROOT / "tests/support").glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:10]


def _test(name: str, target: Path, source: str, limit: float, bytecode: bool = False) -> tuple[str, float]:
    """Run the tests of a module with a source of it in a forked process; return the outcome and the CPU time."""
    target.write_text(source)
    for stale in (target.parent / "__pycache__").glob(f"{target.stem}.*.pyc"):
        stale.unlink()  # bytecode is compared by size and whole seconds only
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    pid = os.fork()
    if pid == 0:
        os._exit(_run_tests(name, target, limit, bytecode))
    ends = time.monotonic() + WALL_FACTOR * limit
    while (done := os.waitpid(pid, os.WNOHANG))[0] == 0 and time.monotonic() < ends:
        time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # the process and what it has started
    status = done[1] if done[0] else os.waitpid(pid, 0)[1]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
        return "timeout", seconds
    return ("survived" if status == 0 else "killed"), seconds


def _run_tests(name: str, target: Path, limit: float, bytecode: bool) -> int:
    """Run pytest in this process; return its exit code."""
    import pytest

    os.setsid()
    os.chdir(target.parents[len(Path(name).parts)])
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
    sys.dont_write_bytecode = not bytecode
    if not bytecode:
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    log = os.open(os.environ.get("MUTATION_LOG", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    options = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist")
    try:
        return int(pytest.main([*options, *TESTS[name], f"autonerf_lab/{name}.py"]))
    except BaseException:
        return 1


def mutants(name: str, source: str, sample: int | None = None, seed: int = 0) -> list[Mutant]:
    """Return the mutants of a module in the order of their lines, or the first ``sample`` by a hash of the seed."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code

    lines, counts, excluded = source.splitlines(), Counter[str](), _excluded(source)
    nodes = list(ast_nodes(get_ast(source)))
    places = []
    for label, operator in _operators():
        for occurrence, (node, start) in enumerate(_positions(nodes, operator)):
            is_float = node.type == "number" and isinstance(ast.literal_eval(node.value), float)
            if (label == "NumberReplacer" and is_float) or any(low <= start < high for low, high in excluded):
                continue
            key = f"{name} {label} {lines[start[0] - 1].strip()}"
            counts[key] += 1
            key = f"{key} {counts[key]}"
            order = hashlib.sha256(f"{seed} {key}".encode()).hexdigest()
            places.append((order, hashlib.sha256(key.encode()).hexdigest()[:10], start[0], operator, occurrence))
    places = sorted(places, key=lambda place: place[0])[:sample]
    found = []
    for _, id, line, operator, occurrence in sorted(places, key=lambda place: place[2]):
        mutated = mutate_code(source, operator, occurrence)
        changed = mutated.splitlines()
        pairs = [(a.strip(), b.strip()) for a, b in zip(lines, changed, strict=False) if a != b]
        change = " -> ".join(" ".join(part) for part in zip(*pairs, strict=True)) if pairs else "no change"
        found.append(Mutant(id, line, change, mutated))
    return found


def _operators() -> Iterator[tuple[str, Any]]:
    from cosmic_ray.operators.operator import Operator
    from cosmic_ray.plugins import get_operator
    from parso.python.tree import Number

    class ScaleFloat(Operator):
        """Multiply a float that is not zero by a factor."""

        def mutation_positions(self, node: Any) -> Iterator[tuple[Any, Any]]:
            value = ast.literal_eval(node.value) if isinstance(node, Number) else 0
            if isinstance(value, float) and value:
                yield from ((node.start_pos, node.end_pos) for _ in FACTORS)

        def mutate(self, node: Any, index: int) -> Any:
            return Number(f"{node.prefix}{ast.literal_eval(node.value) * FACTORS[index]:.12g}", node.start_pos)

        @classmethod
        def examples(cls) -> tuple[Any, ...]:
            return ()

    swaps = [f"{kind}_{swap}" for kind, text in _SWAPS.items() for swap in text.split()]
    for label in chain(swaps, _OTHERS):
        yield label, get_operator(f"core/{label}")()
    yield "ScaleFloat", ScaleFloat()


def _positions(nodes: list[Any], operator: Any) -> Iterator[tuple[Any, tuple[int, int]]]:
    """Yield the node, line and column of each occurrence of an operator, in the order of cosmic-ray."""
    for node in nodes:
        for start, _ in operator.mutation_positions(node):
            yield node, start


def _excluded(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return where annotations and decorators start and end: line and column each."""
    found = []
    for node in ast.walk(ast.parse(source)):
        parts = [getattr(node, name, None) for name in ("annotation", "returns")] + getattr(node, "decorator_list", [])
        found += [((p.lineno, p.col_offset), (p.end_lineno, p.end_col_offset)) for p in parts if p is not None]
    return found


if __name__ == "__main__":
    raise SystemExit(main())
