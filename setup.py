"""Build steps that pyproject.toml cannot express: data inside the wheel, absolute links on PyPI's page."""

import runpy
import shutil
import tomllib
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithData(build_py):
    """Copy scenes and notebooks into the package; an editable installation reads them from the checkout."""

    def run(self) -> None:
        """Build, then copy."""
        super().run()
        if not self.editable_mode:
            self.copy_tree("data/procedural_scenes", f"{self.build_lib}/autonerf_lab/procedural_scenes")
            notebooks = Path(self.build_lib, "autonerf_lab/notebooks")
            notebooks.mkdir(parents=True, exist_ok=True)
            for path in Path("notebooks").glob("*.ipynb"):
                shutil.copyfile(path, notebooks / path.name)


def package_page() -> str:
    """Return the README with links that work on PyPI."""
    owner = runpy.run_path("docs/set_owner.py")
    version = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    page: str = owner["package_page"](Path("README.md").read_text(encoding="utf-8"), owner["repository"](), version)
    return page


setup(
    cmdclass={"build_py": BuildWithData},
    long_description=package_page(),
    long_description_content_type="text/markdown",
)
