"""Alias table: names of objects in other datasets, and the class of this package that each stands for.

The names are those of the category lists of Matterport3D (mpcat40), HM3D, Gibson, ScanNet, HSSD, ReplicaCAD and
AI2-THOR, which have hundreds of spellings. A name is looked up after numbers, capitals, hyphens and underscores are
removed; if it is not in the table, without its first words, one after another: the last word of an English compound
says what a thing is. So "office_chair_03" is a chair, and a "tv stand" is no television. Exceptions, such as "dog bed",
are names of the class ``background``.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.utils.storage import read_json

_NAMES = {
    "chair": "chairs, armchair, arm chair, recliner, highchair, high chair, beanbag, bean bag, swivelchair",
    "couch": "sofa, sofas, loveseat, love seat, settee, futon, chaise longue, chaise lounge, sofa set, sectional",
    "potted plant": "plant, plants, pottedplant, houseplant, house plant, indoor plant, bonsai, flowerpot, flower pot",
    "bed": "beds, bunkbed, bunk bed, crib, mattress",
    "toilet": "toilets, wc, urinal",
    "tv": "television, television set, tv monitor, tvmonitor, tv screen, monitor, flat screen, computer screen",
    "dining table": "diningtable, dinner table, kitchen table, table",
    "oven": "ovens, stove, oven and stove, stove and oven, range cooker, kitchen range",
    "sink": "sinks, sinkbasin, washbasin, wash basin, basin, washbowl",
    "refrigerator": "refridgerator, fridge, freezer, fridge freezer, minifridge",
    "book": "books, notebook, cookbook, stack of books, stack of book",
    "clock": "clocks, alarmclock, wall clock",
    "vase": "vases",
    "cup": "cups, mug, mugs, drinkware, wine glass, wineglass, drinking glass, tumbler, goblet",
    "bottle": "bottles, winebottle, soapbottle, bottle of water, bottle of wine, bottle of soap",
    "background": "coffee table, side table, end table, bedside table, night table, bed table, changing table, "
    "dressing table, vanity table, pool table, ping pong table, foosball table, massage table, massage bed, dog bed, "
    "cat bed, flower bed, egg cup",
}  # fmt: skip

ALIASES: Mapping[str, str] = MappingProxyType(
    {name: name for name in CLASS_NAMES}
    | {name.strip(): class_name for class_name, names in _NAMES.items() for name in names.split(",")}
)


def read_aliases(aliases: Mapping[str, str] | str | Path | None) -> Mapping[str, str]:
    """Return the alias table, with names of the user added.

    Args:
        aliases: Class by name, such as ``{"wing chair": "chair", "table": "background"}``, or the path of a JSON file
            with such an object; None for the built-in table.

    Raises:
        SceneError: The file is damaged, or a class does not exist; the message names the entry.

    Example:
        >>> class_of("lazy boy 3", read_aliases({"lazy boy": "chair"}))
        1
    """
    if aliases is None:
        return ALIASES
    where = "aliases"
    if not isinstance(aliases, Mapping):
        where = str(aliases)
        try:
            aliases = read_json(aliases, dict[str, str])
        except DataError as error:
            raise SceneError(str(error)) from error
    for name, class_name in aliases.items():
        if class_name not in CLASS_NAMES:
            raise SceneError(
                f"{where}: {name[:60]!r} stands for {str(class_name)[:60]!r}, which is no class; classes: "
                f"{', '.join(CLASS_NAMES)}"
            )
    return {**ALIASES, **{plain_name(name): class_name for name, class_name in aliases.items()}}


def plain_name(name: str) -> str:
    """Return a name in small letters, without numbers at its end, hyphens and underscores.

    Example:
        >>> plain_name("Office-Chair.003"), plain_name("DiningTable_2"), plain_name("TVStand")
        ('office chair', 'dining table', 'tv stand')
        >>> plain_name("tile_" + "12" * 90 + "_mesh")[-5:]  # in no time
        ' mesh'
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name.strip()[:200])
    return re.sub(r"[\s\d]+$", "", re.sub(r"[\s_.\-/]+", " ", words.lower())).strip()


def class_of(name: str, aliases: Mapping[str, str] = ALIASES) -> int:
    """Return the class that the name of an object or node stands for; 0 if none.

    Example:
        >>> [class_of(name) for name in ("potted plant_12", "Sofa.003", "frl_chair_01", "tv stand", "dog bed")]
        [3, 2, 1, 0, 0]
    """
    words = plain_name(name).split(" ")
    for first in range(len(words)):
        found = aliases.get(" ".join(words[first:]))
        if found is not None:
            return CLASS_NAMES.index(found)
    return 0
