"""Typed content of Habitat's configuration files; keys that do not concern geometry or semantics are ignored.

Source: habitat-sim, docs/pages/attributesJSON.rst.
"""

from typing import Any

import msgspec

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w x y z
Identity: Quaternion = (1.0, 0.0, 0.0, 0.0)

STAGE, OBJECT, SCENE, DATASET = (
    f".{kind}.json" for kind in ("stage_config", "object_config", "scene_instance", "scene_dataset_config")
)


class Asset(msgspec.Struct):
    """Content of a stage or object configuration."""

    render_asset: str
    up: Vector | None = None  # in the frame of the asset
    front: Vector | None = None
    scale: Vector = (1.0, 1.0, 1.0)
    units_to_meters: float = 1.0
    semantic_id: int | None = None
    com: Vector | None = msgspec.field(default=None, name="COM")  # centre of mass in the frame of the asset


class Placement(msgspec.Struct):
    """Stage or object in a scene instance."""

    template_name: str
    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = Identity
    uniform_scale: float = 1.0
    non_uniform_scale: Vector = (1.0, 1.0, 1.0)
    translation_origin: str | None = None  # "asset_local", "com", or "default": that of the scene


class SceneInstance(msgspec.Struct):
    """Content of a scene instance."""

    stage_instance: Placement
    object_instances: list[Placement] = []
    articulated_object_instances: list[Any] = []
    translation_origin: str = "asset_local"


class DerivedAsset(msgspec.Struct):
    """Entry of ``configs``: a configuration that a dataset defines itself, possibly as a changed copy of a file."""

    template_handle: str | None = None
    original_file: str | None = None
    attributes: dict[str, Any] = {}


class AssetGroup(msgspec.Struct):
    """Configurations of one kind in a dataset."""

    default_attributes: dict[str, Any] = {}
    paths: dict[str, list[str]] = {}  # patterns of folders or files by the ending of the file names
    configs: list[DerivedAsset] = []


class SceneDataset(msgspec.Struct):
    """Content of a dataset configuration."""

    stages: AssetGroup = msgspec.field(default_factory=AssetGroup)
    objects: AssetGroup = msgspec.field(default_factory=AssetGroup)
    scene_instances: AssetGroup = msgspec.field(default_factory=AssetGroup)
    semantic_scene_descriptor_instances: dict[str, Any] = {}  # "paths", and file by handle


class LexiconClass(msgspec.Struct):
    """Class of a semantic lexicon."""

    id: int
    name: str


class Lexicon(msgspec.Struct):
    """Semantic lexicon: the names of the ``semantic_id`` of stages and objects."""

    classes: list[LexiconClass]
