"""Registry of models: those of this package, and those that installed packages register as ``autonerf_lab.models``.

A custom model is a :class:`~autonerf_lab.nerf.model.ModelSpec`: settings for each preset, and a function that combines
a field with a sampler. Existing parts need no copying::

    def build(settings, box, frames, classes, rng, device):
        field = MyField(settings, box, frames, classes, rng, device or "cpu")  # for example a TorchHashField
        return Model(settings, box, field, ProposalSampler(settings, box, rng), frames)

    SPEC = ModelSpec(MODELS["semantic-nerfacto"].settings, build, "my-nerf")

``examples/tiny_model.py`` is a complete model with a new field. Pass a model to :func:`~autonerf_lab.nerf.fit.fit`, or
register it::

    [project.entry-points."autonerf_lab.models"]
    my-nerf = "my_package:SPEC"
"""

from autonerf_lab.errors import UnknownNameError, WrongTypeError
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.models import instant_ngp, semantic_nerf, semantic_nerfacto, semantic_nerfacto_rgbd
from autonerf_lab.utils.plugins import load_plugins

MODELS: dict[str, ModelSpec] = {
    "semantic-nerf": semantic_nerf.SPEC,
    "semantic-nerfacto": semantic_nerfacto.SPEC,
    "instant-ngp": instant_ngp.SPEC,
    "semantic-nerfacto-rgbd": semantic_nerfacto_rgbd.SPEC,
    "instant-ngp-rgbd": instant_ngp.RGBD_SPEC,
}


def available() -> dict[str, ModelSpec]:
    """Return built-in models and those of installed packages; a broken one is left out with a warning."""
    return load_plugins("models", MODELS, ModelSpec)


def model_spec(model: str | ModelSpec) -> ModelSpec:
    """Return a model by its name; a :class:`ModelSpec` is returned unchanged.

    Raises:
        UnknownNameError: the name is not registered; the message lists the valid names.
        WrongTypeError: ``model`` is neither a name nor a :class:`ModelSpec`.

    Example:
        >>> model_spec("gauss")
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown model 'gauss'; valid names: instant-ngp, instant-ngp-rgbd, \
semantic-nerf, semantic-nerfacto, semantic-nerfacto-rgbd
    """
    if isinstance(model, ModelSpec):
        return model
    if not isinstance(model, str):
        kind = model.__name__ if isinstance(model, type) else f"a {type(model).__name__}"
        raise WrongTypeError(
            f"a model must be a name or a ModelSpec, not {kind}; create one with ModelSpec(settings, build)"
        )
    if model in MODELS:
        return MODELS[model].named(model)
    found = available()
    if model not in found:
        raise UnknownNameError("model", model, found)
    return found[model].named(model)


__all__ = ["MODELS", "ModelSpec", "available", "model_spec"]
