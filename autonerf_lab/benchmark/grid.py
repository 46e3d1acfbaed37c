"""Grid of a benchmark: all combinations of policies, scenes, start poses and models."""

import re
import runpy
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from autonerf_lab.errors import DataError, MissingPackageError, UnknownNameError, WrongTypeError
from autonerf_lab.pipeline.context import SCAN_SUFFIXES
from autonerf_lab.presets import preset
from autonerf_lab.segmentation import segmenter_source

PAPER_POLICIES = (
    "random", "frontier-classic", "frontier", "e2e-cov", "e2e-cur", "e2e-nov", "e2e-rec",
    "modular-cov", "modular-sem", "modular-obs", "modular-view",
)  # fmt: skip


CONDITIONS = ("noise", "noise_scale", "depth_noise", "poses", "semantics")  # of the exploration


@dataclass(frozen=True)
class Cell:
    """Cell of a grid: one trajectory, the radiance field trained on it, and its scores."""

    policy: str  # name, path of weights, or module:Class
    scene: str  # name, or path of a file
    start: int  # random seed of the start pose and of everything else
    model: str
    preset: str
    optional: tuple[str, ...] = ()  # optional tasks
    noise: str | None = None  # model of the noise of motion and odometry
    noise_scale: float | None = None  # factor of this noise
    depth_noise: str | None = None  # model of the noise of depth images
    poses: str | None = None  # pose source; None: odometry
    semantics: str | None = None  # source of the classes that the robot sees; None: the simulator
    baselines: bool = False  # also score the baselines, and by the definitions of the paper's code

    def __post_init__(self) -> None:
        object.__setattr__(self, "optional", tuple(self.optional))  # a list if read from JSON

    @property
    def conditions(self) -> dict[str, Any]:
        """Noise, pose source and source of the classes that are set, by name."""
        values = {key: getattr(self, key) for key in CONDITIONS}
        return {key: value for key, value in values.items() if value is not None}

    @property
    def condition(self) -> str:
        """Noise and pose source as printed in tables; empty without noise.

        Example:
            >>> Cell("random", "val-0", 0, "instant-ngp", "fast", noise="ans", depth_noise="redwood",
            ...      poses="estimated").condition
            'noise ans, depth noise redwood, poses estimated'
        """
        return ", ".join(f"{key.replace('_', ' ')} {label(str(value))}" for key, value in self.conditions.items())

    @property
    def variant(self) -> str:
        """Model, with noise and pose source if they are set: what tells rows of one policy apart."""
        return f"{self.model}, {self.condition}" if self.condition else self.model

    @property
    def name(self) -> str:
        """Name of the files of the cell; characters that are not safe in file names are replaced.

        Example:
            >>> Cell("runs/policies/modular-bumps/policy.safetensors", "val-0", 2, "instant-ngp", "fast").name
            'val-0_modular-bumps_2_instant-ngp'
            >>> Cell("my_package.policies:Spiral", "val-0", 2, "instant-ngp", "fast").name
            'val-0_my_package.policies-Spiral_2_instant-ngp'
        """
        parts = [label(self.scene), label(self.policy), str(self.start), self.model]
        if self.condition:
            parts.append("-".join(label(str(value)) for value in self.conditions.values()))
        return "_".join(re.sub(r"[^\w.+-]", "-", part) for part in parts)


@dataclass(frozen=True)
class Grid:
    """All combinations of policies, scenes, starts and models.

    A Python file that sets the variable ``GRID`` can define a grid too, see :func:`load_grid`.

    Example:
        >>> grid = Grid(policies=("random", "frontier"), scenes=("val-0",), starts=2)
        >>> [cell.name for cell in grid.cells()][:2]
        ['val-0_random_0_semantic-nerfacto', 'val-0_random_1_semantic-nerfacto']
    """

    policies: tuple[str, ...]  # names, paths of weights, module:Class, or names of groups
    scenes: tuple[str, ...]  # names, paths, or names of splits
    starts: int = 5  # number of start poses per scene
    models: tuple[str, ...] = ("semantic-nerfacto",)
    preset: str = "fast"
    optional: tuple[str, ...] = ()  # optional tasks: navigation (minutes per cell), finetuning (an hour per cell)
    noise: str | None = None  # model of the noise of motion and odometry; None: exact
    noise_scale: float | None = None  # factor of this noise
    depth_noise: str | None = None  # model of the noise of depth images; None: exact
    poses: str | None = None  # pose source: odometry, estimated, refined or true; None: odometry
    semantics: str | None = None  # source of the classes: true, predicted, noisy or a segmenter; None: true
    baselines: bool = False  # also score the baselines, and by the definitions of the paper's code: 1.4 times the time

    def cells(self) -> list[Cell]:
        """Return all cells, scene by scene."""
        same = {key: getattr(self, key) for key in ("preset", "optional", *CONDITIONS, "baselines")}
        return [
            Cell(policy, scene, start, model, **same)
            for scene, policy, start, model in product(self.scenes, self.policies, range(self.starts), self.models)
        ]

    def checked(self) -> "Grid":
        """Return a validated grid with expanded groups of names and absolute paths.

        Raises:
            WrongTypeError: A field has the wrong type, such as a name instead of a tuple of names.
            UnknownNameError: A name does not exist. The message lists the valid names.
            DataError: A file is missing, two cells would have the same name, or the grid is empty.
            MissingPackageError: Fine-tuning needs the extra ``training``.
        """
        self._check_types()
        from autonerf_lab.evaluators.tasks import optional_tasks
        from autonerf_lab.nerf.models import available
        from autonerf_lab.pipeline.run import check_arguments
        from autonerf_lab.policies import POLICIES, make_policy
        from autonerf_lab.policies import available as available_policies
        from autonerf_lab.scenes import scene_names
        from autonerf_lab.scenes.library import SPLITS

        learned = {kind: [n for n in POLICIES if n.startswith(kind + "-")] for kind in ("modular", "e2e")}
        groups = {"all": [*POLICIES], "paper": [*PAPER_POLICIES]} | {k: v for k, v in learned.items() if v}
        policies = _expand(self.policies, groups)
        for policy in policies:
            if not is_path(policy) and ":" not in policy and policy not in available_policies():
                raise UnknownNameError("policy", policy, [*available_policies(), *groups])
            make_policy(policy)
        splits = {split: scene_names(split) for split in SPLITS}
        splits["all"] = [*splits["train"], *splits["dev"], *splits["val"]]
        scenes = _expand(self.scenes, splits)
        for scene in scenes:
            if is_path(scene):
                if not Path(scene).is_file():
                    raise DataError(f"{scene} does not exist: a scene must be a name of the library or a file")
            elif scene not in scene_names():
                raise UnknownNameError("scene", scene, [*scene_names(), *splits])
        models = _expand(self.models, {"all": [*available()]})
        for model in models:
            if model not in available():
                raise UnknownNameError("model", model, [*available(), "all"])
        for task in self.optional:
            if task not in optional_tasks():
                raise UnknownNameError("optional task", task, optional_tasks())
        check_arguments(**{key: getattr(self, key) for key in CONDITIONS})
        source = segmenter_source(self.semantics)
        if "finetuning" in self.optional:
            _check_finetuning()
        if self.starts < 1:
            raise DataError(f"starts must be at least 1, not {self.starts}")
        size, optional = preset(self.preset).name, tuple(dict.fromkeys(self.optional))
        grid = replace(
            self, policies=policies, scenes=scenes, models=models, preset=size, optional=optional, semantics=source
        )
        names = [cell.name for cell in grid.cells()]
        if not names:
            raise DataError("the grid has no cell: give at least one policy, one scene and one model")
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise DataError(f"two cells would have the name {twice[0]}: rename one of the files or classes of the grid")
        return grid

    def _check_types(self) -> None:
        for key in ("policies", "scenes", "models", "optional"):
            value = getattr(self, key)
            if not isinstance(value, tuple | list) or not all(isinstance(name, str) for name in value):
                raise WrongTypeError(f"{key} must be a tuple of names, such as ('random',), not {value!r}")
        if type(self.starts) is not int:
            raise WrongTypeError(f"starts must be a whole number, not {self.starts!r}")
        if type(self.baselines) is not bool:
            raise WrongTypeError(f"baselines must be True or False, not {self.baselines!r}")
        if not isinstance(self.preset, str):
            raise WrongTypeError(f"preset must be a name, such as 'fast', not {self.preset!r}")


def _check_finetuning() -> None:
    """Check the requirements of fine-tuning before the first cell runs."""
    from autonerf_lab.evaluators.finetuning import PRETRAINED

    for path in (PRETRAINED, PRETRAINED.with_suffix(".json")):
        if not path.is_file():
            raise DataError(
                f"finetuning starts from a PointGoal policy, but {path} does not exist: train one with `autonerf-lab "
                "train-policy --policy pointgoal`, or remove finetuning"
            )
    if find_spec("stable_baselines3") is None:
        raise MissingPackageError('finetuning needs an extra: pip install "autonerf-lab[training]"')


def label(name: str) -> str:
    """Return a policy or scene name as printed in tables: files without folder and suffix.

    Example:
        >>> label("frontier"), label("runs/policies/modular-bumps/policy.safetensors"), label("/tmp/flat.glb")
        ('frontier', 'modular-bumps', 'flat')
    """
    if not is_path(name):
        return name
    path = Path(name)
    return path.parent.name if path.stem == "policy" else path.stem


def paper_grid(preset_name: str = "fast") -> Grid:
    """Return the grid of the paper, plus ``random`` and our ``frontier``: five validation scenes, five starts."""
    return Grid(PAPER_POLICIES, ("val",), 5, preset=preset_name)


def load_grid(name: str) -> Grid:
    """Load a grid: ``paper``, or the variable ``GRID`` of a Python file. The file is executed.

    Raises:
        UnknownNameError: ``name`` is neither a known grid nor a Python file.
        DataError: The file raises an exception or defines no grid.
    """
    if name == "paper":
        return paper_grid()
    if not name.endswith(".py"):
        raise UnknownNameError("grid", name, ["paper", "FILE.py"])
    try:
        grid = runpy.run_path(name).get("GRID")
    except (Exception, SystemExit) as error:  # user code may raise anything
        raise DataError(f"{name} cannot be run: {type(error).__name__}: {error}") from error
    if not isinstance(grid, Grid):
        raise DataError(f"{name} must set GRID = autonerf_lab.benchmark.Grid(...)")
    return grid


def is_path(name: str) -> bool:
    """Return True if a policy or scene is given as a file. Suffixes of scans may be upper case.

    Example:
        >>> is_path("flat.GLB"), is_path("runs/mine/policy.safetensors"), is_path("val-0")
        (True, True, False)
    """
    return name.endswith((".safetensors", ".json")) or Path(name).suffix.lower() in SCAN_SUFFIXES


def _expand(names: Iterable[str], groups: dict[str, list[str]]) -> tuple[str, ...]:
    found = [one for name in names for one in groups.get(name, [name])]
    return tuple(dict.fromkeys(str(Path(name).resolve()) if is_path(name) else name for name in found))
