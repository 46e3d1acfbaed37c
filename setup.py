"""Build step that pyproject.toml cannot express: a wheel carries the frozen scenes inside the package."""

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithScenes(build_py):
    """Copy ``data/procedural_scenes`` into the package; an editable installation reads it from the checkout."""

    def run(self) -> None:
        """Build, then copy."""
        super().run()
        if not self.editable_mode:
            self.copy_tree("data/procedural_scenes", f"{self.build_lib}/autonerf_lab/procedural_scenes")


setup(cmdclass={"build_py": BuildWithScenes})
