"""Rotating view of a mesh, without a browser."""

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


def image(table):
    (ax,) = table.figure().axes
    return ax.get_title(), np.asarray(ax.images[0].get_array())


def test_it_rotates(table):
    before, (_, initial) = table.png, image(table)
    table.azimuth.value = 0  # along the long side the image is narrow and high
    title, rotated = image(table)
    assert table.png != before and title == "red, 12 triangles"
    assert rotated.shape[0] / rotated.shape[1] > 1.5 * initial.shape[0] / initial.shape[1]
    assert table.static_image().data == table.png


def test_it_is_coloured(table):
    _, red = image(table)
    table.color_scheme.value = "green"
    title, green = image(table)
    assert title.startswith("green") and (red[..., 0] > red[..., 1]).any() and not (red[..., 1] > red[..., 0]).any()
    np.testing.assert_array_equal(red[..., [1, 0, 2]], green)
