"""The models, by name: this package's, and what installed packages register as ``autonerf_lab.models``.

A model of your own is one file: a :class:`~autonerf_lab.nerf.model.ModelSpec` with settings for each preset and a
function that pairs a field with a sampler (``examples/tiny_model.py`` is one, with a field of its own). Pass it to
:func:`~autonerf_lab.nerf.fit.fit` as it is, or register it::

    [project.entry-points."autonerf_lab.models"]
    my-nerf = "my_package:SPEC"
"""

from autonerf_lab.errors import UnknownNameError, WrongTypeError
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.models import instant_ngp, semantic_nerf, semantic_nerfacto
from autonerf_lab.utils.plugins import installed

MODELS: dict[str, ModelSpec] = {
    "semantic-nerf": semantic_nerf.SPEC,
    "semantic-nerfacto": semantic_nerfacto.SPEC,
    "instant-ngp": instant_ngp.SPEC,
}


def available() -> dict[str, ModelSpec]:
    """Built-in models and those of installed packages; a broken one is warned about by name and left out."""
    return installed("models", MODELS, ModelSpec)


def model_spec(model: str | ModelSpec) -> ModelSpec:
    """A model by its name; a model of one's own is returned as it is.

    Raises:
        UnknownNameError: lists the valid names.
        WrongTypeError: it is neither a name nor a :class:`ModelSpec`.

    Example:
        >>> model_spec("gauss")
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown model 'gauss'; valid names: instant-ngp, semantic-nerf, \
semantic-nerfacto
    """
    if isinstance(model, ModelSpec):
        return model
    if not isinstance(model, str):
        kind = model.__name__ if isinstance(model, type) else f"a {type(model).__name__}"
        raise WrongTypeError(f"a model is a name or a ModelSpec, not {kind}; ModelSpec(settings, build) makes one")
    if model in MODELS:
        return MODELS[model].named(model)
    found = available()
    if model not in found:
        raise UnknownNameError("model", model, found)
    return found[model].named(model)


__all__ = ["MODELS", "ModelSpec", "available", "model_spec"]
