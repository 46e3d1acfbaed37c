"""Semantic segmentation of images: labels as a robot can have them, by name.

* ``true``: the simulator's labels.
* ``noisy``: the simulator's labels with seeded errors (:class:`~autonerf_lab.segmentation.NoisyLabels`).
* ``compact``, also ``predicted``: a small network trained on generated apartments
  (:mod:`autonerf_lab.segmentation.compact`).
* ``mask-rcnn:FILE``: Mask R-CNN with a file of weights (:mod:`autonerf_lab.segmentation.mask_rcnn`).

A package registers its own segmenter, a class or function that is called without arguments, in its
``pyproject.toml``::

    [project.entry-points."autonerf_lab.segmenters"]
    my-segmenter = "my_package:MySegmenter"

``examples/segmenter_plugin`` is such a package.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.segmentation.base import Segmentation, Segmenter
from autonerf_lab.segmentation.conformance import check_members, check_segmenter
from autonerf_lab.segmentation.simulated import NoisyLabels, TrueLabels
from autonerf_lab.utils.plugins import load_plugins, with_members

TRUE = "true"
PREDICTED = "compact"  # segmenter behind the word ``predicted``
WEIGHTS = Path(__file__).parent / "weights" / "compact.safetensors"
_MASK_RCNN = "mask-rcnn"


def _compact() -> Segmenter:
    from autonerf_lab.segmentation.compact import Compact  # imports torch

    return Compact()


def _mask_rcnn() -> Segmenter:
    from autonerf_lab.segmentation.mask_rcnn import MaskRcnn

    return MaskRcnn()


SEGMENTERS: dict[str, Callable[[], Segmenter]] = {
    TRUE: TrueLabels,
    "noisy": NoisyLabels,
    "compact": _compact,
    _MASK_RCNN: _mask_rcnn,
}


def available() -> dict[str, Callable[[], Segmenter]]:
    """Return the built-in segmenters and those of installed packages, as in :data:`SEGMENTERS`.

    A segmenter that cannot be imported, does not pass :func:`~autonerf_lab.segmentation.conformance.check_segmenter` or
    uses a built-in name is left out with a :class:`~autonerf_lab.utils.plugins.PluginWarning`.
    """
    return load_plugins("segmenters", SEGMENTERS, object, check_segmenter)


def make_segmenter(segmenter: str | Segmenter) -> Segmenter:
    """Make a segmenter.

    Args:
        segmenter: a name in :func:`available`; ``predicted`` for the default network; the path of ``.safetensors``
            weights of ``autonerf-lab train-segmentation``; ``mask-rcnn:FILE`` with a file of weights; or a segmenter,
            which is returned as it is.

    Raises:
        UnknownNameError: unknown name; lists the valid names.
        DataError: the weights are missing or damaged.
        MissingPackageError: Mask R-CNN without torchvision.
        WrongTypeError: the object has not the members of a :class:`Segmenter`.

    Example:
        >>> type(make_segmenter("noisy")).__name__
        'NoisyLabels'
    """
    if not isinstance(segmenter, str):
        return with_members(segmenter, type(segmenter).__name__, "segmenter", check_members)
    name, _, file = segmenter.partition(":")
    if name == _MASK_RCNN and file:
        from autonerf_lab.segmentation.mask_rcnn import MaskRcnn

        return MaskRcnn(file)
    if segmenter.endswith(".safetensors"):
        from autonerf_lab.segmentation.compact import Compact

        return Compact(segmenter)
    name = PREDICTED if segmenter == "predicted" else segmenter
    if name in SEGMENTERS:
        return SEGMENTERS[name]()
    found = available()
    if name not in found:
        raise UnknownNameError("segmenter", segmenter, [*found, "predicted"])
    return found[name]()


def segmenter_name(segmenter: str | Segmenter) -> str:
    """Return the name of a segmenter, as results store it: the class of an object.

    Example:
        >>> segmenter_name("predicted"), segmenter_name(NoisyLabels(0.2))
        ('predicted', 'NoisyLabels')
    """
    return segmenter if isinstance(segmenter, str) else type(segmenter).__name__


def segmenter_source(name: str | None) -> str | None:
    """Return the name of a segmenter with an absolute path, which does not depend on the working directory.

    None stands for the labels of the simulator.

    Example:
        >>> segmenter_source("predicted"), segmenter_source("true"), segmenter_source("mask-rcnn:/a/../b.safetensors")
        ('predicted', None, 'mask-rcnn:/b.safetensors')
    """
    if name is None or name == TRUE:
        return None
    kind, colon, file = name.rpartition(":") if name.startswith(f"{_MASK_RCNN}:") else ("", "", name)
    return kind + colon + str(Path(file).resolve()) if file.endswith(".safetensors") else name


def segmenter_sha256(name: str) -> str | None:
    """Return the SHA-256 of the weights of a segmenter, in hexadecimal; None for a segmenter without weights.

    Example:
        >>> segmenter_sha256("noisy") is None
        True
    """
    path = WEIGHTS if name in ("predicted", PREDICTED) else Path(name.removeprefix(f"{_MASK_RCNN}:"))
    is_file = path.suffix == ".safetensors" and path.is_file()
    return hashlib.sha256(path.read_bytes()).hexdigest() if is_file else None


__all__ = [
    "SEGMENTERS",
    "TRUE",
    "NoisyLabels",
    "Segmentation",
    "Segmenter",
    "TrueLabels",
    "available",
    "check_segmenter",
    "make_segmenter",
    "segmenter_name",
    "segmenter_sha256",
    "segmenter_source",
]
