"""Generator stage 5: materials of all surfaces."""

from collections.abc import Callable

import numpy as np

from autonerf_lab.scenes import objects
from autonerf_lab.scenes.layout import LIVING, Layout

Color = tuple[int, int, int]  # sRGB, 0 to 255

WOODS: list[Color] = [
    (176, 128, 80),
    (140, 92, 54),
    (205, 168, 120),
    (98, 62, 40),
    (188, 148, 104),
    (222, 196, 156),
]
FABRICS: list[Color] = [
    (72, 92, 120),
    (120, 118, 112),
    (150, 72, 58),
    (92, 112, 84),
    (176, 152, 118),
    (60, 66, 76),
    (186, 142, 60),
    (128, 84, 110),
    (58, 104, 108),
    (196, 182, 160),
]
PAINTS: list[Color] = [
    (226, 218, 202),
    (206, 214, 206),
    (198, 208, 218),
    (230, 208, 182),
    (214, 196, 186),
    (188, 200, 186),
    (232, 224, 206),
    (178, 192, 204),
    (220, 200, 160),
]
BRIGHT: list[Color] = [
    (178, 50, 44),
    (38, 84, 132),
    (212, 160, 52),
    (54, 112, 78),
    (236, 228, 210),
    (106, 62, 104),
    (206, 106, 52),
    (46, 50, 58),
    (90, 150, 160),
    (222, 190, 170),
]


def choose_materials(layout: Layout, rng: np.random.Generator) -> None:
    """Fill ``layout.materials`` with one entry for every material that a part uses."""
    table = layout.materials

    def sample_color(options: list[Color], spread: float = 12) -> list[int]:
        base = np.array(options[int(rng.integers(len(options)))], dtype=float)
        return [int(v) for v in np.clip(base + rng.normal(0, spread / 3, 3) + rng.normal(0, spread / 2), 12, 245)]

    def add(
        name: str, kind: str, one: list[int], two: list[int] | None = None, scale: float = 1.0, glow: float = 0.0
    ) -> None:
        entry: dict = {"kind": kind, "color": one, "seed": int(rng.integers(1, 100000))}
        if two is not None:
            entry["color2"] = two
        if scale != 1.0:
            entry["scale"] = round(scale, 3)
        if glow:
            entry["glow"] = glow
        table[name] = entry

    def shade(c: list[int], f: float) -> list[int]:
        return [int(min(250, max(5, v * f))) for v in c]

    main_floor = sample_color(WOODS)
    for index, room in enumerate(layout.rooms):
        _add_floor(add, index, room.category, main_floor, rng, sample_color, shade)
        paint = sample_color(PAINTS)
        kind = (
            str(rng.choice(["plaster", "plaster", "stripes", "damask"]))
            if room.category in (*LIVING, "bedroom")
            else "plaster"
        )
        add(f"wall{index}", kind, paint, shade(paint, 0.8), float(rng.uniform(0.85, 1.3)))
        if room.category == "bath":
            tile = sample_color([(214, 222, 224), (150, 184, 188), (226, 214, 196), (120, 150, 170)])
            add(f"tiles{index}", "tile", tile, shade(tile, 0.72), float(rng.choice([0.15, 0.2, 0.1])))
    add("ceiling", "plaster", [234, 231, 224], [206, 201, 192], 1.4)
    white, dark = [228, 226, 220], shade(main_floor, 0.72)
    frame = white if rng.random() < 0.6 else shade(main_floor, 1.05)
    add("frame", "grain" if frame is not white else "paint", frame, shade(frame, 0.85))
    add("skirting", "paint", frame, shade(frame, 0.85))
    add("threshold", "grain", dark, shade(dark, 0.7))
    add("door", "grain", sample_color(WOODS), None)
    add("reveal", "plaster", [226, 224, 218], [208, 206, 200])
    add("sill", "stone", [206, 200, 190], [166, 160, 150], 0.5)
    add("window_frame", "paint", [238, 238, 234], [214, 214, 210])
    for number, opening in enumerate(layout.openings):
        if opening.kind == "window":
            add(f"outdoors{number}", "outdoors", [168, 200, 236], [92, 120, 80], 1.0, 1.0)
    for name in ("chair", "couch", "bed", "table", "low", "shelf", "desk"):
        wood = sample_color(WOODS)
        add(f"wood_{name}", "grain", wood, shade(wood, 0.66))
    for name in ("chair", "couch", "armchair", "bed", "office", "throw", "cushion0", "cushion1", "cushion2"):
        cloth = sample_color(FABRICS if "cushion" not in name else FABRICS + BRIGHT)
        kind = str(rng.choice(["fabric", "fabric", "plaid", "dots"])) if name not in ("couch", "office") else "fabric"
        add(f"fabric_{name}", kind, cloth, sample_color(FABRICS) if kind != "fabric" else shade(cloth, 0.72))
    cloth = sample_color(FABRICS + PAINTS)
    add("duvet", str(rng.choice(["plaid", "dots", "stripes", "fabric"])), cloth, shade(cloth, 0.74), 1.2)
    add("sheet", "fabric", [232, 228, 220], [206, 202, 196], 1.5)
    curtain = sample_color(FABRICS + PAINTS)
    add("curtain", str(rng.choice(["fabric", "stripes", "fabric"])), curtain, shade(curtain, 0.78))
    add("shower_curtain", "dots", [214, 226, 232], [120, 160, 190])
    for name in ("cupboard", "wardrobe", "kitchen"):
        body = sample_color([*WOODS, (224, 220, 212), (214, 214, 210)])
        add(name, "grain", body, shade(body, 0.75))
        front = body if rng.random() < 0.6 else sample_color([*PAINTS, *FABRICS])
        add(f"{name}_front", "grain" if front is body else "paint", front, shade(front, 0.8))
    bath = sample_color([*WOODS, (224, 222, 216)])
    add("bath_cupboard", "grain", bath, None)
    add("bath_cupboard_front", "paint", shade(bath, 1.06), shade(bath, 0.9))
    add("plinth", "paint", [58, 54, 50], [40, 38, 36])
    top = sample_color([(94, 90, 86), (196, 186, 172), (64, 64, 68), (160, 112, 72)])
    add("worktop", str(rng.choice(["stone", "grain"])), top, shade(top, 0.62), 0.6)
    add("plastic_chair", "paint", sample_color([*BRIGHT, (230, 228, 222)]), None)
    add("black", "paint", [36, 36, 38], [22, 22, 24])
    add("metal", "metal", [168, 168, 166], [122, 122, 122])
    add("chrome", "metal", [202, 204, 206], [140, 144, 150], 0.6)
    add("steel", "metal", [174, 176, 178], [142, 144, 146])
    add("steel_sink", "metal", [168, 172, 176], [118, 122, 126])
    fridge = sample_color([(226, 226, 224), (206, 60, 52), (120, 170, 172), (222, 214, 190)], 6)
    add("fridge", "paint", fridge, shade(fridge, 0.88))
    add("appliance", "paint", [226, 228, 228], [204, 206, 208])
    add("ceramic", "ceramic", [234, 234, 230], [212, 212, 210])
    lid = [232, 232, 228] if rng.random() < 0.7 else sample_color(WOODS)
    add("ceramic_lid", "paint", lid, shade(lid, 0.86))
    add("tub_side", "tile", sample_color([(214, 222, 224), (150, 184, 188), (226, 214, 196)]), [150, 150, 148], 0.14)
    add("oven_steel", "metal", [160, 162, 164], [128, 130, 132])
    add("oven_white", "paint", [228, 228, 226], [206, 206, 204])
    add("oven_black", "paint", [52, 52, 56], [34, 34, 38])
    add("oven_glass", "glass", [34, 30, 30], [96, 84, 70])
    add("oven_panel", "paint", [70, 70, 74], [48, 48, 52])
    add("hob", "stone", [40, 40, 42], [22, 22, 24], 0.4)
    add("plate", "metal", [66, 62, 60], [36, 34, 34])
    add("mirror", "glass", [150, 170, 180], [214, 222, 226])
    add("frame_dark", "grain", [62, 48, 38], [36, 28, 24])
    add("frame_light", "grain", [190, 160, 112], [150, 118, 76])
    add("clock", "clock", [238, 234, 222], [30, 30, 34])
    add("clock_square", "clock_square", [240, 236, 226], [40, 36, 34])
    add("screen", "screen", [24, 30, 46], [150, 130, 100], 1.0, 0.25)
    add("radiator", "paint", [228, 226, 222], [206, 204, 200])
    add("lampshade", "fabric", [240, 224, 188], [216, 192, 150], 1.0, 0.7)
    add("shade_pendant", "paint", sample_color(BRIGHT), None)
    add("bulb", "paint", [255, 246, 226], [250, 236, 206], 1.0, 3.0)
    add("basket", "plaid", sample_color(WOODS), None, 0.25)
    for k in range(3):
        add(f"coat{k}", "fabric", sample_color(FABRICS + BRIGHT), None)
        add(
            f"towel{k}",
            str(rng.choice(["stripes", "fabric"])),
            sample_color(BRIGHT + PAINTS),
            sample_color(PAINTS),
            0.5,
        )
    add("leaf", "leaf", sample_color([(62, 118, 52), (80, 132, 60), (48, 98, 62)]), [150, 176, 96])
    add("stem", "grain", [104, 84, 56], [72, 58, 40])
    add("flower", "leaf", sample_color([(214, 120, 130), (226, 186, 92), (190, 120, 170)]), [240, 220, 200])
    for k in range(3):
        pot = sample_color([(176, 96, 64), (220, 214, 204), (82, 92, 104), (60, 110, 112)])
        add(f"pot{k}", "ceramic", pot, shade(pot, 0.78))
        label = sample_color(BRIGHT)
        add(f"label{k}", "label", [234, 226, 206], label)
    for k in range(4):
        add(f"vase{k}", str(rng.choice(["bands", "ceramic"])), sample_color(BRIGHT), sample_color(BRIGHT), 0.4)
        add(
            f"cup{k}",
            str(rng.choice(["bands", "ceramic", "ceramic"])),
            sample_color(BRIGHT),
            sample_color([(236, 232, 222)]),
            0.3,
        )
        add(
            f"bottle{k}",
            "ceramic",
            sample_color([(38, 74, 48), (92, 58, 30), (60, 96, 130), (34, 36, 40), (150, 170, 160)]),
            None,
            0.5,
        )
    for k in range(objects.BOOK_COLORS):
        add(
            f"book{k}",
            "book",
            sample_color(BRIGHT + FABRICS),
            sample_color([(226, 206, 140), (236, 232, 222), (30, 30, 34)]),
        )
    for k in range(objects.PICTURES):
        add(f"picture{k}", "picture", sample_color(BRIGHT + PAINTS), sample_color(BRIGHT))
    for k in range(objects.RUGS):
        add(f"round_rug{k}", "rings", sample_color(FABRICS + BRIGHT[:4]), sample_color([*PAINTS, (232, 220, 196)]))
        add(f"rug{k}", "rug", sample_color(FABRICS + BRIGHT[:4]), sample_color([*PAINTS, (232, 220, 196)]))
    _per_room(layout, rng, sample_color)
    used = {part["m"] for item in layout.objects for part in item.parts}
    fixed = ("wall", "floor", "tiles", "outdoors")
    building = {
        "ceiling",
        "frame",
        "skirting",
        "threshold",
        "door",
        "reveal",
        "sill",
        "window_frame",
        "metal",
        "bulb",
        "black",
        "shade_pendant",
    }
    for name in list(table):
        if name not in used and name not in building and not name.startswith(fixed):
            del table[name]


ROOM_SLOTS = (  # prefixes of materials that each room samples separately
    "duvet",
    "curtain",
    "fabric_throw",
    "fabric_bed",
    "fabric_armchair",
    "fabric_cushion",
    "wood_bed",
    "wood_shelf",
    "wood_desk",
    "wardrobe",
    "cupboard",
    "rug",
)


def _per_room(layout: Layout, rng: np.random.Generator, sample_color: Callable[[list[Color]], list[int]]) -> None:
    """Give each room its own colours of the materials in ``ROOM_SLOTS``."""
    for item in layout.objects:
        for part in item.parts:
            name = part["m"]
            if not name.startswith(ROOM_SLOTS):
                continue
            own = f"{name}@{item.room}"
            if own not in layout.materials:
                entry = dict(layout.materials[name], seed=int(rng.integers(1, 100000)))
                woody = entry["kind"] == "grain" or name.startswith(("wood", "wardrobe", "cupboard"))
                entry["color"] = sample_color([*WOODS, (224, 220, 212)] if woody else FABRICS + PAINTS)
                if entry["kind"] in ("grain", "paint", "fabric"):
                    darker = 0.9 if entry["kind"] == "paint" else 0.72
                    entry["color2"] = [int(v * darker) for v in entry["color"]]
                if name.startswith(("duvet", "curtain")):
                    entry["kind"] = str(rng.choice(["plaid", "dots", "stripes", "fabric"]))
                layout.materials[own] = entry
            part["m"] = own


def _add_floor(add, index, category, main, rng, sample_color, shade) -> None:  # type: ignore[no-untyped-def]
    if category in ("kitchen", "bath", "utility"):
        stone = sample_color([(168, 156, 140), (120, 122, 126), (196, 182, 160), (146, 110, 88), (206, 204, 198)])
        add(
            f"floor{index}",
            str(rng.choice(["tile", "checker"])),
            stone,
            shade(stone, 0.66),
            float(rng.choice([0.2, 0.3, 0.4])),
        )
    elif category in ("bedroom", "study") and rng.random() < 0.4:
        carpet = sample_color(FABRICS)
        add(f"floor{index}", "carpet", carpet, shade(carpet, 0.74))
    else:
        add(
            f"floor{index}",
            str(rng.choice(["wood", "wood", "herringbone"])),
            main,
            shade(main, 0.7),
            float(rng.choice([0.8, 1.0, 1.3])),
        )
