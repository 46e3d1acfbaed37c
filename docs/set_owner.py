"""Write the address of the repository into README, notebooks and citation file.

    python docs/set_owner.py            # write
    python docs/set_owner.py --check    # only report files that differ

``[project.urls] Repository`` in ``pyproject.toml`` is the one place that decides the address. While it is not set,
no badge and no link to Colab, Binder or the repository is shown; run this script after setting or changing it.
``setup.py`` calls :func:`package_page` for the page on PyPI.
"""

import argparse
import json
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COLAB, BINDER = "https://colab.research.google.com/github", "https://mybinder.org/v2/gh"
RUN_IT = (
    "**Run it**: `autonerf-lab course start FOLDER` copies all notebooks and opens them; in a copy of the repository, "
    "`make lab` does.\nThe first cell loads packages, which takes some seconds. In the first run after the "
    "installation, kernels are compiled: some cells then take up to a minute longer."
)
INSTALL = """# Colab has Jupyter but not the package: install it, once (some minutes). Elsewhere this cell does nothing.
import importlib.util

if importlib.util.find_spec("autonerf_lab") is None:
    %pip install -q "autonerf-lab[training,viewer] @ git+https://github.com/{}" anywidget"""


def repository() -> str | None:
    """Return OWNER/NAME on GitHub, or None while it is not set."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    url = project.get("urls", {}).get("Repository")
    return url.removeprefix("https://github.com/").rstrip("/") if url else None


def links(name: str, notebook: str) -> tuple[str, str]:
    """Return the Colab and the Binder address of a notebook."""
    return (
        f"{COLAB}/{name}/blob/main/notebooks/{notebook}",
        f"{BINDER}/{name}/main?urlpath=lab/tree/notebooks/{notebook}",
    )


def readme(text: str, name: str | None) -> str:
    """Return the README with its badges, or without them."""
    badges = ""
    if name:
        colab, binder = links(name, "00_tour.ipynb")
        badges = (
            f"[![Open in Colab](https://colab.research.google.com/assets/colab-badge.svg)]({colab})\n"
            f"[![Open in Binder](https://mybinder.org/badge_logo.svg)]({binder})\n"
        )
    return re.sub(r"(?s)<!-- badges -->\n.*?<!-- /badges -->", f"<!-- badges -->\n{badges}<!-- /badges -->", text)


def package_page(text: str, name: str | None, version: str) -> str:
    """Return the README for PyPI, where relative links are dead: they become absolute.

    They lead to the tag of the version, or to the branch main before a release. Without an address, only their text is
    left, and pictures are left out.
    """
    reference = "main" if "dev" in version else f"v{version}"

    def absolute(match: re.Match[str]) -> str:
        image, label, target = match.groups()
        if "://" in target or target.startswith("#"):
            return match[0]
        if not name:
            return "" if image else label
        base = f"https://raw.githubusercontent.com/{name}" if image else f"https://github.com/{name}/blob"
        return f"{image}[{label}]({base}/{reference}/{target})"

    return re.sub(r"(!?)\[([^][]*)\]\(([^)\s]+)\)", absolute, text)


def citation(text: str, name: str | None) -> str:
    """Return the citation file with the address of the repository, or without it."""
    text = re.sub(r"(?m)^repository-code: .*\n", "", text)
    return re.sub(r"(?m)^(license: .*\n)", rf"\1repository-code: https://github.com/{name}\n", text) if name else text


def notebook(text: str, name: str | None, path: Path) -> str:
    """Return a notebook whose title says where it runs, and which installs the package on Colab."""
    content = json.loads(text)
    cells = [cell for cell in content["cells"] if cell["id"] != "setup-colab"]
    old = "".join(cells[0]["source"]).split("\n\n")
    run_it, setup = RUN_IT, []
    if name:
        colab, binder = links(name, path.name)
        run_it += f"\nIn the browser: [Colab]({colab}) · [Binder]({binder})."
        setup = [{"cell_type": "code", "execution_count": None, "id": "setup-colab", "metadata": {}, "outputs": []}]
        setup[0]["source"] = INSTALL.format(name).splitlines(keepends=True)
    paragraphs = [paragraph for paragraph in old if not paragraph.startswith("**Run it**") and COLAB not in paragraph]
    cells[0]["source"] = "\n\n".join([*paragraphs, run_it]).splitlines(keepends=True)
    content["cells"] = [cells[0], *setup, *cells[1:]]
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def main() -> int:
    """Write the files, or report those that differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="Change nothing; fail if a file differs.")
    check, name, differ = parser.parse_args().check, repository(), []
    for path in [ROOT / "README.md", ROOT / "CITATION.cff", *sorted((ROOT / "notebooks").glob("*.ipynb"))]:
        text = path.read_text()
        if path.suffix == ".ipynb":
            new = notebook(text, name, path)
        else:
            new = readme(text, name) if path.suffix == ".md" else citation(text, name)
        if new != text:
            differ.append(str(path.relative_to(ROOT)))
            if not check:
                path.write_text(new)
    print("\n".join(differ) if differ else f"every file says {name or 'that the address is not set'}")
    return int(check and bool(differ))


if __name__ == "__main__":
    sys.exit(main())
