"""A grid: which policy walks in which scene from which start, and which model learns from the walk."""

import re
import runpy
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path

from autonerf_lab.config import preset
from autonerf_lab.errors import DataError, MissingPackageError, UnknownNameError, WrongTypeError
from autonerf_lab.pipeline.stages import SCANS

PAPER_POLICIES = (
    "random", "frontier", "e2e-cov", "e2e-cur", "e2e-nov", "e2e-rec",
    "modular-cov", "modular-sem", "modular-obs", "modular-view",
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One walk, the field that learned from it, and its scores."""

    policy: str  # a name, or the path of weights
    scene: str  # a name, or the path of a file
    start: int  # the seed of everything in it
    model: str
    preset: str
    optional: tuple[str, ...] = ()  # tasks that take long

    def __post_init__(self) -> None:
        object.__setattr__(self, "optional", tuple(self.optional))  # JSON gives a list back

    @property
    def name(self) -> str:
        """What its files are called.

        Example:
            >>> Cell("runs/policies/modular-bumps/policy.safetensors", "val-0", 2, "instant-ngp", "fast").name
            'val-0_modular-bumps_2_instant-ngp'
        """
        parts = (label(self.scene), label(self.policy), str(self.start), self.model)
        return "_".join(re.sub(r"[^\w.+-]", "-", part) for part in parts)


@dataclass(frozen=True)
class Grid:
    """Every policy in every scene from every start, learned by every model.

    A grid is also a short Python file that makes one and calls it ``GRID``.

    Example:
        >>> grid = Grid(policies=("random", "frontier"), scenes=("val-0",), starts=2)
        >>> [cell.name for cell in grid.cells()][:2]
        ['val-0_random_0_semantic-nerfacto', 'val-0_random_1_semantic-nerfacto']
    """

    policies: tuple[str, ...]
    scenes: tuple[str, ...]
    starts: int = 5
    models: tuple[str, ...] = ("semantic-nerfacto",)
    preset: str = "fast"
    optional: tuple[str, ...] = ()  # tasks that take long: navigation (minutes a cell), finetuning (hours)

    def cells(self) -> list[Cell]:
        """All cells, scene by scene."""
        return [
            Cell(policy, scene, start, model, self.preset, self.optional)
            for scene, policy, start, model in product(self.scenes, self.policies, range(self.starts), self.models)
        ]

    def checked(self) -> "Grid":
        """The same grid with its groups of names written out and its paths made absolute.

        Raises:
            WrongTypeError: a field that is not what it should be, such as a name where a tuple of names belongs.
            UnknownNameError: a name that does not exist; lists the valid ones.
            DataError: a file is missing, two entries would share a name, or nothing is left to run.
            MissingPackageError: fine-tuning, without the extra ``training``.
        """
        self._check_types()
        from autonerf_lab.evaluators.tasks import OPTIONAL
        from autonerf_lab.nerf.models import available
        from autonerf_lab.policies import POLICIES, make_policy
        from autonerf_lab.scenes import scene_names

        learned = {kind: [n for n in POLICIES if n.startswith(kind + "-")] for kind in ("modular", "e2e")}
        groups = {"all": [*POLICIES], "paper": [*PAPER_POLICIES]} | {k: v for k, v in learned.items() if v}
        policies = _expand(self.policies, groups)
        for policy in policies:
            if not is_path(policy) and policy not in POLICIES:
                raise UnknownNameError("policy", policy, [*POLICIES, *groups])
            make_policy(policy)
        splits = {"all": scene_names()} | {split: scene_names(split) for split in ("train", "dev", "val")}
        scenes = _expand(self.scenes, splits)
        for scene in scenes:
            if is_path(scene):
                if not Path(scene).is_file():
                    raise DataError(f"{scene} does not exist: a scene is a name of the library or a file")
            elif scene not in scene_names():
                raise UnknownNameError("scene", scene, [*scene_names(), *splits])
        models = _expand(self.models, {"all": [*available()]})
        for model in models:
            if model not in available():
                raise UnknownNameError("model", model, [*available(), "all"])
        for task in self.optional:
            if task not in OPTIONAL:
                raise UnknownNameError("optional task", task, OPTIONAL)
        if "finetuning" in self.optional:
            _check_finetuning()
        if self.starts < 1:
            raise DataError(f"starts must be at least 1, not {self.starts}")
        size, optional = preset(self.preset).name, tuple(dict.fromkeys(self.optional))
        grid = replace(self, policies=policies, scenes=scenes, models=models, preset=size, optional=optional)
        names = [cell.name for cell in grid.cells()]
        if not names:
            raise DataError("the grid has no cell: name at least one policy, one scene and one model")
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise DataError(f"two cells would be called {twice[0]}: rename one of the files that the grid names")
        return grid

    def _check_types(self) -> None:
        for key in ("policies", "scenes", "models", "optional"):
            value = getattr(self, key)
            if not isinstance(value, tuple | list) or not all(isinstance(name, str) for name in value):
                raise WrongTypeError(f"{key} must be a tuple of names, such as ('random',), not {value!r}")
        if type(self.starts) is not int:
            raise WrongTypeError(f"starts must be a whole number, not {self.starts!r}")
        if not isinstance(self.preset, str):
            raise WrongTypeError(f"preset must be a name, such as 'fast', not {self.preset!r}")


def _check_finetuning() -> None:
    """Fail before the first cell, not after an hour of it."""
    from autonerf_lab.evaluators.finetuning import PRETRAINED

    for path in (PRETRAINED, PRETRAINED.with_suffix(".json")):
        if not path.is_file():
            raise DataError(
                f"finetuning goes on with a PointGoal policy, and {path} does not exist: `autonerf-lab train-policy "
                "--policy pointgoal` makes one, or leave finetuning out"
            )
    if find_spec("stable_baselines3") is None:
        raise MissingPackageError('finetuning trains a policy: pip install "autonerf-lab[training]"')


def label(name: str) -> str:
    """A name as tables print it: that of a file without its folder and ending.

    Example:
        >>> label("frontier"), label("runs/policies/modular-bumps/policy.safetensors"), label("/tmp/flat.glb")
        ('frontier', 'modular-bumps', 'flat')
    """
    if not is_path(name):
        return name
    path = Path(name)
    return path.parent.name if path.stem == "policy" else path.stem


def paper_grid(preset_name: str = "fast") -> Grid:
    """The paper's policies, and ``random``, in the five validation scenes from five starts."""
    return Grid(PAPER_POLICIES, ("val",), 5, preset=preset_name)


def load_grid(name: str) -> Grid:
    """The grid ``paper``, or the ``GRID`` of a Python file. The file is code: it is run.

    Raises:
        UnknownNameError: neither a grid nor a Python file.
        DataError: the file fails, or holds no grid.
    """
    if name == "paper":
        return paper_grid()
    if not name.endswith(".py"):
        raise UnknownNameError("grid", name, ["paper", "FILE.py"])
    try:
        grid = runpy.run_path(name).get("GRID")
    except (Exception, SystemExit) as error:  # whatever a stranger's file raises
        raise DataError(f"{name} cannot be run: {type(error).__name__}: {error}") from error
    if not isinstance(grid, Grid):
        raise DataError(f"{name} must set GRID = autonerf_lab.benchmark.Grid(...)")
    return grid


def is_path(name: str) -> bool:
    """Whether a policy or scene is a file; cameras and editors write the endings of scans in capitals too.

    Example:
        >>> is_path("flat.GLB"), is_path("runs/mine/policy.safetensors"), is_path("val-0")
        (True, True, False)
    """
    return name.endswith((".safetensors", ".json")) or Path(name).suffix.lower() in SCANS


def _expand(names: Iterable[str], groups: dict[str, list[str]]) -> tuple[str, ...]:
    found = [one for name in names for one in groups.get(name, [name])]
    return tuple(dict.fromkeys(str(Path(name).resolve()) if is_path(name) else name for name in found))
