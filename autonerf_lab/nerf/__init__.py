"""Neural fields: fit one to a walk or to photographs, load it, ask it."""

from autonerf_lab.nerf.checkpoint import load_nerf
from autonerf_lab.nerf.field import NeRF, Rendering
from autonerf_lab.nerf.fit import fit
from autonerf_lab.nerf.models import MODELS, available, model_spec

__all__ = ["MODELS", "NeRF", "Rendering", "available", "fit", "load_nerf", "model_spec"]
