"""Context of a stage: run folder, options and inputs."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from autonerf_lab.errors import DataError
from autonerf_lab.pipeline.run_folder import RunFolder
from autonerf_lab.presets import Preset, preset

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.evaluators.lpips import Lpips
    from autonerf_lab.nerf import NeRF
    from autonerf_lab.scenes import Scene

SCAN_SUFFIXES = (".glb", ".obj", ".ply")


@dataclass(frozen=True)
class StageOptions:
    """Options of single stages. They are not part of the configuration of a run."""

    lpips: "Lpips | None" = None
    device: str | None = None  # of the radiance field; None: compiled kernels on the CPU
    upstream: bool = False  # also compute the scores as defined by the released code of the paper
    baselines: bool = True  # also score the nearest view, the fused depth and the oracle
    optional_tasks: Sequence[str] = ()  # such as "navigation"
    interest_regions: bool = False  # pose refinement samples its pixels in interest regions
    voxel: float | None = None  # of the mesh, metres; None: as in the preset
    mesh_format: str = "glb"  # or "ply", "obj"
    figures: Collection[str] | None = None  # names of the figures to draw; None: all


class StageContext:
    """Run folder and options of a stage. Scene, trajectory and radiance field are loaded on first use."""

    def __init__(self, run: RunFolder, scene: "Scene | None" = None, options: StageOptions | None = None) -> None:
        self.run, self.options = run, options or StageOptions()
        if scene is not None:
            self.scene = scene

    @property
    def preset(self) -> Preset:
        """Preset of the run, with the overrides of its configuration."""
        config, base = self.run.config, preset(self.run.config.preset)
        overrides: dict[str, Any] = {
            "episode_steps": config.steps, "width": config.width, "height": config.height, "hfov_deg": config.hfov_deg,
            "refine_interest": self.options.interest_regions or None,
        }  # fmt: skip
        return replace(base, **{key: value for key, value in overrides.items() if value is not None})

    @cached_property
    def scene(self) -> "Scene":
        """Scene of the run.

        Raises:
            DataError: The scene has changed since the run began.
        """
        scene = find_scene(self.run.config.scene)
        if scene.sha256 != self.run.config.scene_sha256:
            raise DataError(
                f"{self.run.path}: scene {self.run.config.scene!r} has changed since the run began; start a new run"
            )
        return scene

    @property
    def trajectory(self) -> "Trajectory":
        """Trajectory of the run, with the poses on which its field is trained; errors are those of :attr:`recorded`."""
        poses = self.run.config.fit_poses
        return self.recorded if poses is None else self.recorded.with_poses(poses)

    @cached_property
    def recorded(self) -> "Trajectory":
        """Trajectory of the run, as recorded.

        Raises:
            DataError: A file is missing or damaged, or the trajectory was recorded in another scene.
        """
        from autonerf_lab.data.trajectory import load_trajectory

        folder = self.run / "trajectory"
        trajectory = load_trajectory(folder)
        found = trajectory.meta.get("scene_sha256")
        if found != self.run.config.scene_sha256:
            raise DataError(
                f"{folder} was recorded in another scene ({str(trajectory.meta.get('scene'))[:80]!r}), the scene of "
                f"this run is {self.run.config.scene!r}; restore the folder, or run `autonerf-lab explore` again with "
                "--overwrite"
            )
        return trajectory

    @cached_property
    def nerf(self) -> "NeRF":
        """Radiance field of the run.

        Raises:
            DataError: A file is missing or damaged.
        """
        from autonerf_lab.nerf import load_nerf

        return load_nerf(self.run / "nerf", self.options.device)


def scene_source(name: str) -> str:
    """Return the name of a scene, or the absolute path of its file, which does not depend on the working directory."""
    return str(Path(name).resolve()) if Path(name).suffix else name


def find_scene(name: str) -> "Scene":
    """Load a scene of the library by its name, or a specification (JSON), a scan or a Habitat scene by its path.

    Raises:
        UnknownNameError: The name does not exist. The message lists the names of the library.
        SceneError: The file does not hold a scene.
    """
    from autonerf_lab.scenes import import_scene, load_scene
    from autonerf_lab.scenes.habitat import is_habitat_config

    path = Path(name)
    return import_scene(name) if path.suffix.lower() in SCAN_SUFFIXES or is_habitat_config(path) else load_scene(name)
