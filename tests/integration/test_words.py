"""Plain technical English: docstring summaries and the terms that the project has chosen (see CONTRIBUTING.md)."""

import ast
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "autonerf_lab").rglob("*.py"))
TEXTS = [
    *MODULES,
    *(path for folder in ("benchmarks", "examples", "docs") for path in sorted((ROOT / folder).rglob("*.py"))),
    *sorted((ROOT / "autonerf_lab").rglob("*.jinja")),
    *sorted((ROOT / "notebooks").glob("*.ipynb")),
    *sorted(path for path in ROOT.glob("*.md") if path.name != "CHANGELOG.md"),  # which names what was renamed
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "benchmarks").rglob("*.md")),
]
RIDDLE = re.compile(r"(What|Whether|How|Where|Which|Who|Whose|Of|As|That|Those|When)\b")
TERMS = {  # a word or phrase -> the term to write instead
    r"(?<!random[ _-])(?<!os\.)(?<!ast\.)\bwalk(s|ed|ing)?\b(?!_packages)": "trajectory, rollout, episode",
    r"\byardsticks?\b": "baseline",
    r"\bfound (them|it)sel(f|ves)\b": "pose refinement converged",
    r"\bwho(ever)? (does|has|is|knows|waits|wants|stops|chooses|goes|asks)\b": "name the thing",
    r"\bpractis(e|ed|ing)\b": "fine-tuning",
    r"\bsurprise[sd]?\b": "prediction error",
    r"\bTODO\b|\bFIXME\b": "nothing: finish it",
}


def plain_text(path: Path) -> str:
    """The text of a file; of a notebook, the source of its cells."""
    if path.suffix != ".ipynb":
        return path.read_text(encoding="utf-8")
    return "\n".join("".join(cell["source"]) for cell in json.loads(path.read_text(encoding="utf-8"))["cells"])


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_summaries_say_what_a_thing_does_or_is(path: Path) -> None:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        summary = (ast.get_docstring(node) or "").split("\n")[0] if isinstance(node, documented) else ""
        if RIDDLE.match(summary):
            found.append(f"{getattr(node, 'lineno', 1)}: {summary}")
    assert not found


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_terms_are_those_of_the_field(path: Path) -> None:
    found = [
        f"{line}: {match[0]!r}; write {term}"
        for line, text in enumerate(plain_text(path).splitlines(), 1)
        for pattern, term in TERMS.items()
        for match in re.finditer(pattern, text)
    ]
    assert not found
