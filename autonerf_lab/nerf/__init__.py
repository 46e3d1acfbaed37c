"""Neural fields: fit one to a walk, load it, ask it."""

from autonerf_lab.nerf.checkpoint import load_nerf
from autonerf_lab.nerf.field import NeRF, Rendering
from autonerf_lab.nerf.fit import MODELS, fit
from autonerf_lab.nerf.settings import NerfactoSettings

__all__ = ["MODELS", "NeRF", "NerfactoSettings", "Rendering", "fit", "load_nerf"]
