"""Figures of geometry: values computed by hand for a toy scene, labels and units."""

from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from toy_scene import empty_room, two_rooms

from autonerf_lab.viz.figures.evaluation import render_comparison
from autonerf_lab.viz.figures.geometry import CELL, CrossSection, cross_section, density_sections, depth_errors
from autonerf_lab.viz.figures.style import empty_figure


class HalfSpace:
    """Dense beyond x = 6, seen below z = 2 and only where x < 7."""

    def density(self, points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 0] > 6, 100.0, 0.0).astype(np.float32)

    def seen(self, points: np.ndarray) -> np.ndarray:
        return (points[:, 2] < 2) & (points[:, 0] < 7)


def length(section: CrossSection) -> float:
    return float(np.linalg.norm(section.outline[:, 1] - section.outline[:, 0], axis=1).sum())


def words(figure: Figure) -> str:
    figure.canvas.draw()
    return "\n".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))


def test_the_outline_of_the_scene_has_the_expected_length() -> None:
    # outer walls, the two parts of the wall between the rooms, the refrigerator; the bed and the table are lower
    plan = cross_section(HalfSpace(), two_rooms(), 2, 1.0)
    assert length(plan) == pytest.approx(2 * (8 + 3) + 2 * 2.2 + 4 * 0.58, abs=1e-3)
    # at y = 0.5: floor, ceiling and two ends; the wall between, from floor to ceiling; the refrigerator
    elevation = cross_section(HalfSpace(), two_rooms(), 1, 0.5)
    assert length(elevation) == pytest.approx(2 * (8 + 2.5) + 2 * (0.1 + 2.5) + 2 * (0.58 + 1.8), abs=1e-3)
    np.testing.assert_allclose(elevation.outline.reshape(-1, 2).max(axis=0), (8, 2.5), atol=1e-6)  # x and z


@pytest.mark.parametrize(("axis", "at"), [(2, 1.0), (1, 0.5), (0, 3.0)])
def test_density_is_drawn_at_its_position(axis: int, at: float) -> None:
    section = cross_section(HalfSpace(), two_rooms(), axis, at)
    left, right, bottom, top = section.extent
    rows, columns = section.sigma.shape
    assert (right - left) / columns == pytest.approx(CELL) and (top - bottom) / rows == pytest.approx(CELL)
    across = left + (np.arange(columns) + 0.5) * CELL
    up = bottom + (np.arange(rows) + 0.5) * CELL
    dense, known = (across > 6, across < 7) if axis != 0 else (np.full(columns, at > 6), np.full(columns, at < 7))
    low = up < 2 if axis != 2 else np.full(rows, at < 2)
    np.testing.assert_array_equal(section.sigma > 50, np.broadcast_to(dense, section.sigma.shape))
    np.testing.assert_array_equal(section.seen, low[:, None] & known)


def test_the_vertical_plane_contains_seen_objects() -> None:
    figure = density_sections(HalfSpace(), two_rooms())
    y = float(words(figure).split("vertical plane at y = ")[1].split(" m")[0])
    assert 2.4 < y < 2.6  # bed, vase and table: the only plane with three classes


def test_sections_have_equal_scales_and_labels() -> None:
    figure = density_sections(HalfSpace(), two_rooms())
    text = words(figure)
    for label in ("x (m)", "y (m)", "z (m)", "density σ (1/m), logarithmic scale", "horizontal plane at z = 1.00 m",
                  "true surfaces", "never seen by a training view"):  # fmt: skip
        assert label in text
    plan, elevation = figure.axes[:2]
    for ax in (plan, elevation):
        assert ax.get_aspect() == 1
        assert sum(isinstance(c, LineCollection) for c in ax.collections) == 1
        density, grey = ax.images
        assert density.norm.__class__.__name__ == "LogNorm" and density.get_extent() == grey.get_extent()
        stripes = grey.get_array()
        covered = stripes[..., 3] > 0
        assert covered.any() and not covered.all()
        assert len(np.unique(stripes[covered][:, :3], axis=0)) == 2  # two greys
    assert plan.get_xlim() == elevation.get_xlim()


def test_a_nan_field_and_a_room_without_objects_are_drawn() -> None:
    broken = SimpleNamespace(
        density=lambda points: np.full(len(points), np.nan, np.float32), seen=lambda points: np.zeros(len(points), bool)
    )
    for scene in (two_rooms(), empty_room()):
        assert "vertical plane" in words(density_sections(broken, scene))


def view(error: float) -> dict[str, np.ndarray]:
    depth = np.full((4, 4), 2.0, np.float32)
    depth[0] = 0  # no surface there
    image = {"true_depth": depth, "depth": np.float32(2.0 + error) * np.ones((4, 4), np.float32)}
    return image | {"true_rgb": np.zeros((4, 4, 3), np.uint8)}


def test_depth_errors_are_signed_centimetres_from_the_best_view_to_the_worst() -> None:
    figure = depth_errors({"images": [view(0.3), view(-0.02), view(-0.9)]})
    text = words(figure)
    places = [text.index(f"median |error| {cm} cm") for cm in (2, 30, 90)]
    assert places == sorted(places)
    errors = [ax.images[0] for ax in figure.axes if ax.images and ax.images[0].get_cmap().name == "RdBu"]
    for image, expected in zip(errors, (-2, 30, -90), strict=True):
        assert image.get_clim() == (-50, 50)
        shown = np.ma.masked_invalid(image.get_array())
        np.testing.assert_allclose(shown[1:], expected, atol=1e-3)
        assert shown.mask[0].all()  # where the truth has no depth there is no error
    shown_images = [image for ax in figure.axes for image in ax.images if image.get_array().ndim == 2]
    depths = [image.get_clim() for image in shown_images if image.get_cmap().name == "viridis"]
    assert len(depths) == 6 and set(depths) == {(0, 2)}  # one scale for truth and rendering
    for label in ("depth along the optical axis (m)", "depth error (cm): red too near, blue too far"):
        assert label in text


def test_views_without_any_surface_come_last_and_do_not_break_the_picture() -> None:
    empty = view(0.1) | {"true_depth": np.zeros((4, 4), np.float32)}
    text = words(depth_errors({"images": [empty, view(0.1)]}))
    assert text.index("median |error| 10 cm") < text.index("no surface in view")


@pytest.mark.parametrize("draw", [depth_errors, render_comparison])
def test_a_failed_task_gives_an_empty_figure(draw: object) -> None:
    assert words(draw({})) == words(empty_figure())
