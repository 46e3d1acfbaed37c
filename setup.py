"""Build step that pyproject.toml cannot express: a wheel carries scenes and notebooks inside the package."""

import shutil
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


setup(cmdclass={"build_py": BuildWithData})
