"""The turntable of a mesh is driven without a browser."""

import numpy as np
import pytest
import trimesh

from autonerf_lab.course.widgets.mesh import Turntable

RED, GREEN = (np.tile(np.array([color], np.uint8), (8, 1)) for color in ((200, 0, 0), (0, 200, 0)))


@pytest.fixture
def table():
    room = trimesh.creation.box((4, 2, 1))
    room.invert()
    return Turntable(room, {"red": RED, "green": GREEN}, width=80)


def picture(table):
    (ax,) = table.figure().axes
    return ax.get_title(), np.asarray(ax.images[0].get_array())


def test_it_turns(table):
    before, (_, seen) = table.picture, picture(table)
    table.side.value = 0  # along the long side: the room is narrow and high
    title, turned = picture(table)
    assert table.picture != before and title == "red, 12 triangles"
    assert turned.shape[0] / turned.shape[1] > 1.5 * seen.shape[0] / seen.shape[1]
    assert table.still().data == table.picture


def test_it_is_coloured(table):
    _, red = picture(table)
    table.choice.value = "green"
    title, green = picture(table)
    assert title.startswith("green") and (red[..., 0] > red[..., 1]).any() and not (red[..., 1] > red[..., 0]).any()
    np.testing.assert_array_equal(red[..., [1, 0, 2]], green)
