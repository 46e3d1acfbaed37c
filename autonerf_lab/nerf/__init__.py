"""Neural fields: fit one to a walk or to photographs, load it, ask it."""

from autonerf_lab.nerf.checkpoint import load_nerf
from autonerf_lab.nerf.fit import fit
from autonerf_lab.nerf.models import MODELS, available, model_spec
from autonerf_lab.nerf.radiance_field import NeRF, Rendering

__all__ = ["MODELS", "NeRF", "Rendering", "available", "fit", "load_nerf", "model_spec"]
