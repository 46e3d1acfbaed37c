"""Fake installed packages with entry points."""

import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Site:
    """Folder of installed packages."""

    folder: Path

    def install(self, package: str, name: str, code: str, value: str = "SPEC", group: str = "models") -> None:
        """Write the files of an installed package with one module and one entry point."""
        module = package.replace("-", "_")
        sys.modules.pop(module, None)  # from a previous test
        (self.folder / f"{module}.py").write_text(code)
        info = self.folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[autonerf_lab.{group}]\n{name} = {module}:{value}\n")

    def uninstall(self, package: str) -> None:
        """Remove the metadata of a package."""
        module = package.replace("-", "_")
        for file in (self.folder / f"{module}-1.0.dist-info").iterdir():
            file.unlink()
        (self.folder / f"{module}-1.0.dist-info").rmdir()
