"""Semantic NeRFs: train a field on a trajectory or on photographs, load it, render and query it."""

from autonerf_lab.nerf.fit import fit
from autonerf_lab.nerf.models import MODELS, available, model_spec
from autonerf_lab.nerf.radiance_field import NeRF, load_nerf
from autonerf_lab.types import Rendering

__all__ = ["MODELS", "NeRF", "Rendering", "available", "fit", "load_nerf", "model_spec"]
