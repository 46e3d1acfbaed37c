"""Distance grids of measured depth, and the bins that they place: a flat wall by hand, and a naive reference."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import distance_grid
from autonerf_lab.nerf.distance_grid import DistanceGrid, fuse_depth
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.fields.hash_field import HashField
from autonerf_lab.nerf.kernels.distance_grid import UNKNOWN, finish
from autonerf_lab.nerf.model import Model, Sampler
from autonerf_lab.nerf.pixel_sampler import PixelSampler
from autonerf_lab.nerf.ray_batch import Arrays, Rays
from autonerf_lab.nerf.samplers.occupancy import OccupancySampler
from autonerf_lab.nerf.samplers.surface import SurfaceSampler
from autonerf_lab.nerf.samplers.torch_occupancy import TorchOccupancySampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import OccupancySettings, Settings, SurfaceSettings

WALL = 2.0  # metres in front of the cameras, which look along -z
SETTINGS = SurfaceSettings(samples=12, evaluation_samples=16, near=0.05, far=6.0)


def wall_pixels(hole: bool = False) -> PixelSampler:
    """Return pixels of nine cameras that look at a wall at z = -2; with a hole, the left half of the depth is 0."""
    camera = Intrinsics.from_fov(192, 192)
    poses = np.tile(np.eye(4), (9, 1, 1))
    poses[:, :2, 3] = [(x, y) for x in (-0.3, 0, 0.3) for y in (-0.3, 0, 0.3)]
    depth = np.full((192, 192), WALL, np.float32)
    if hole:
        depth[:, :96] = 0
    grey = [np.full((192, 192, 3), 128, np.uint8)] * 9
    data = Dataset(poses, grey, [camera] * 9, None, [depth] * 9, [str(t) for t in range(9)], {}, True)
    return PixelSampler(data, FieldFrame())


@pytest.fixture(scope="module")
def wall() -> DistanceGrid:
    return fuse_depth(wall_pixels(), 0.03, 0.09, 10**6)


def test_distances_of_a_wall(wall: DistanceGrid) -> None:
    """On the axis of the middle camera the distance is 2 m minus the depth, up to half a voxel; then it saturates."""
    depths = np.array([1.92, 1.95, 2.0, 2.05])
    found = wall(np.stack([0 * depths, 0 * depths, -depths], axis=1))
    np.testing.assert_allclose(found, WALL - depths, atol=0.03)
    assert np.isnan(wall(np.array([[0, 0, -2.3]])))  # behind the wall nothing was measured
    assert np.isnan(wall(np.array([[50.0, 0, 0]])))  # outside the grid
    free = wall(np.array([[0, 0, -1.2]]))
    assert 0.09 <= free <= 0.8  # a lower bound of the distance to the wall


def test_free_distances_are_those_of_the_chessboard() -> None:
    rng = np.random.default_rng(0)
    value = np.where(rng.random((12, 9, 7)) < 0.02, 0.01, 0.09).astype(np.float32)
    count = (rng.random(value.shape) > 0.01).astype(np.float32)
    grid = np.empty(value.shape, np.int16)
    finish(value * count, count, np.float32(0.03), np.float32(0.09), grid)
    free = (count > 0) & (value > 0.05)
    # Outside of the grid counts as not free, hence the border; a neighbour of a voxel that is not free has 90 mm.
    steps = distance_transform_cdt(np.pad(free, 1), "chessboard")[1:-1, 1:-1, 1:-1]
    np.testing.assert_array_equal(grid[free], (60 + 30 * steps)[free])
    assert (grid[count == 0] == UNKNOWN).all() and (grid[(count > 0) & ~free] == 10).all()


def test_noisy_depth_is_replaced_by_the_fused_surface() -> None:
    """By hand: 2 m / cos of the angle to the wall; free space has no surface; exact depth stays as it is."""
    distances = (WALL * 1000 - 30 * np.arange(80) - 15).clip(-105, 500)  # millimetres along z, first voxel at z = 0
    distances[distances == -105] = UNKNOWN
    voxels = np.tile(distances.astype(np.int16), (70, 5, 1))
    wall = DistanceGrid(voxels, np.float32([-1.05, -0.075, 0]), 0.03, 0.09)
    slopes = np.linspace(-0.4, 0.4, 40)
    directions = np.stack([slopes, 0 * slopes, np.ones(40)], axis=1).astype(np.float32)
    lengths = np.linalg.norm(directions, axis=1)
    rays = Rays(np.zeros((40, 3), np.float32), directions / lengths[:, None])
    measured = (WALL * lengths + np.random.default_rng(0).normal(0, 0.02, 40)).astype(np.float32)
    measured[:4] = 0, 1.0, 2.6, 5.0
    assert wall.filter_depth(rays, measured) is measured  # without noise
    found = replace(wall, noise=0.01).filter_depth(rays, measured)
    np.testing.assert_allclose(found[4:], (WALL * lengths)[4:], atol=0.004)
    np.testing.assert_array_equal(found[:4], np.float32([0, 0, 2.6, 5.0]))  # nothing is known behind the wall

    noisy = wall_pixels()
    assert noisy.depth is not None
    noisy.depth += np.random.default_rng(0).normal(0, 0.02, noisy.depth.shape).astype(np.float32)
    sampler = SurfaceSampler(SETTINGS)
    rays = replace(rays, directions=rays.directions * np.float32([1, 1, -1]))
    assert sampler.filter_depth(rays, measured) is measured  # nothing is observed
    sampler.observe(noisy)
    np.testing.assert_allclose(sampler.filter_depth(rays, measured)[4:], (WALL * lengths)[4:], atol=0.008)
    sampler.observe(wall_pixels())
    assert sampler.filter_depth(rays, measured) is measured

    box = SceneBox(np.zeros(3), np.full(3, 3.0), 0.25)
    for weight, filtered in ((2.25, True), (0.0, False)):  # instant-ngp trains on depth only if this weight is set
        settings = OccupancySettings(depth_weight=weight, log2_entries=10)
        occupancy = OccupancySampler(settings, box, HashField(settings, box, 0, 2, np.random.default_rng(0)))
        occupancy.observe(noisy)
        assert (occupancy.filter_depth(rays, measured) is not measured) == filtered


def test_bins_of_a_training_ray_end_behind_its_measurement() -> None:
    sampler = SurfaceSampler(SETTINGS)
    sampler.observe(wall_pixels())
    toward = np.tile(np.float32([0, 0, -1]), (2, 1))
    rays = Rays(np.zeros((2, 3), np.float32), toward, depth=np.float32([WALL, 1.0]))
    samples = sampler.sample(rays, np.float32([0.5, 0.5]))
    assert samples.starts.shape == (2, 12) and (samples.ends > samples.starts).all()
    np.testing.assert_allclose(samples.starts[:, 0], 0.05)
    np.testing.assert_allclose(samples.ends[:, -1], [WALL + 0.04, 1.04], atol=1e-5)
    # The wall has 9 cm of the length with weight 1; 1.9 m of free space have weight 0.01 and what is near the wall 0.3.
    around = (np.abs(samples.midpoints[0] - WALL) < 0.05).sum()
    assert 9 <= around < 12


def test_rays_of_new_views_find_the_surface() -> None:
    sampler = SurfaceSampler(SETTINGS)
    sampler.observe(wall_pixels())
    rng = np.random.default_rng(0)
    directions = np.array([0, 0, -1]) + rng.uniform(-0.4, 0.4, (50, 3)) * [1, 1, 0]
    lengths = np.linalg.norm(directions, axis=1)
    rays = Rays(np.zeros((50, 3), np.float32), (directions / lengths[:, None]).astype(np.float32))
    samples = sampler.sample(rays, rng.random(50, dtype=np.float32))
    surface = WALL * lengths
    assert samples.starts.shape == (50, 16) and (samples.ends >= samples.starts).all()
    assert (samples.ends[:, -1] > surface).all() and (samples.ends[:, -1] < surface + 0.3).all()
    assert (np.abs(samples.midpoints - surface[:, None]) < 0.15).mean() > 0.7


def test_a_ray_that_nothing_measured_is_divided_over_its_length() -> None:
    sampler = SurfaceSampler(SETTINGS)
    rays = Rays(np.zeros((1, 3), np.float32), np.float32([[1, 0, 0]]))
    edges = sampler.sample(rays, np.float32([0.5]))
    assert np.isfinite(edges.starts).all() and (edges.ends > edges.starts).all()
    sampler.observe(wall_pixels(hole=True))
    samples = sampler.sample(Rays(np.zeros((1, 3), np.float32), np.float32([[-0.3, 0, -0.954]])), np.float32([0.5]))
    assert samples.ends[0, -1] > 2.2  # the hole may be behind the wall


def test_a_ray_through_unknown_space_reaches_its_end() -> None:
    """512 steps of 15 mm end at 7.73 m; the rest is one more step, in which a metre has a fifth of the bins."""
    sampler = SurfaceSampler(replace(SETTINGS, far=16.0))
    samples = sampler.sample(Rays(np.zeros((1, 3), np.float32), np.float32([[1, 0, 0]])), np.float32([0.5]))
    assert samples.ends[0, -1] == 16 and (samples.ends > samples.starts).all()
    share = 7.68 / (7.68 + 8.27 / 5)
    assert (samples.ends[0] < 7.73).sum() == int(16 * share) == 13
    np.testing.assert_allclose((samples.ends - samples.starts)[0, :13], 7.68 / share / 16, rtol=0.01)


def test_a_ray_that_leaves_a_thin_object_continues() -> None:
    """A plate of 6 cm at 1 m makes three layers of voxels negative; the wall 1 m behind it still gets bins."""
    sampler = SurfaceSampler(SETTINGS)
    distances = np.abs(np.arange(80) * 30 - 1000).clip(-90, 500) - 30  # millimetres along z, first voxel at z = 0
    distances = np.minimum(distances, 2000 - np.arange(80) * 30).clip(-90)
    sampler.observed["distances"] = np.tile(distances.astype(np.int16), (20, 20, 1))
    sampler.observed["distances_origin"] = np.float32([-0.3, -0.3, 0])
    samples = sampler.sample(Rays(np.zeros((1, 3), np.float32), np.float32([[0, 0, 1]])), np.float32([0.5]))
    near_plate, near_wall = (np.abs(samples.midpoints[0] - surface) < 0.12 for surface in (1.0, 2.0))
    assert near_plate.sum() >= 5 and near_wall.sum() >= 4 and samples.ends[0, -1] > 2.05


def test_depth_that_is_no_distance_counts_as_none_and_outliers_do_not_enlarge_the_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Infinite, NaN or negative depth is the "none" of other programs; one pixel of 65 m lies in front of a wall."""
    pixels, wrong = wall_pixels(), wall_pixels()
    assert pixels.depth is not None and wrong.depth is not None
    depth = pixels.depth.reshape(9, 192, 192).copy()
    depth[:, 0, 0:4] = np.inf, -np.inf, np.nan, -1.0
    data = Dataset(
        wrong.poses.astype(np.float64), list(wrong.rgb.reshape(9, 192, 192, 3)), [Intrinsics.from_fov(192, 192)] * 9,
        None, list(depth), wrong.names, {}, True,
    )  # fmt: skip
    cleaned = PixelSampler(data, FieldFrame())
    assert cleaned.depth is not None and (cleaned.depth.reshape(9, 192, 192)[:, 0, :4] == 0).all()
    assert (cleaned.depth.reshape(9, 192, 192)[:, 1:] == WALL).all()
    whole = fuse_depth(pixels, 0.03, 0.09, 10**6)
    pixels.depth[0] = pixels.depth[192 * 191] = 65.0
    monkeypatch.setattr(distance_grid, "MAX_CELLS", 4 * whole.distances.size)
    found = fuse_depth(pixels, 0.03, 0.09, 10**6)
    assert found.distances.size <= 4 * whole.distances.size
    depths = np.array([1.92, 1.95, 2.0, 2.05])
    np.testing.assert_allclose(found(np.stack([0 * depths, 0 * depths, -depths], axis=1)), WALL - depths, atol=0.035)
    monkeypatch.setattr(distance_grid, "MAX_CELLS", 8)
    with pytest.raises(DataError, match=r"too far apart for voxels of 0\.03 m"):
        fuse_depth(pixels, 0.03, 0.09, 10**6)


class Fog:
    """A field of the same density everywhere."""

    def __init__(self) -> None:
        self.parameters: Arrays = {}

    def density(self, points: np.ndarray) -> np.ndarray:
        return np.full(len(points), 40, np.float32)


def test_space_measured_to_be_empty_has_no_density(wall: DistanceGrid) -> None:
    """No ray has samples there, so the field may have any density: that of the model counts, for maps and meshes."""
    box = SceneBox(np.zeros(3, np.float32), np.full(3, 3, np.float32), 0.25)
    occupancy = OccupancySettings(depth_weight=2.25, log2_entries=10)
    depths = np.array([1.0, 1.6, 1.95, 2.0, 2.3])  # in front of the wall, at the wall, and behind it
    points = np.stack([0 * depths, 0 * depths, -depths], axis=1)
    samplers: list[tuple[Settings, Sampler]] = [
        (occupancy, OccupancySampler(occupancy, box, Fog())),
        (occupancy, TorchOccupancySampler(occupancy, box, Fog(), "cpu")),
        (SETTINGS, SurfaceSampler(SETTINGS)),
    ]
    for settings, sampler in samplers:
        model = Model(settings, box, Fog(), sampler, 9)
        np.testing.assert_array_equal(model.density(points), 40)
        sampler.observe(wall_pixels())
        np.testing.assert_array_equal(model.density(points), [0, 0, 40, 40, 40])
        assert model.density(points[:0]).shape == (0,)
    anywhere = np.random.default_rng(0).uniform([-2, -1, -3], [2, 1, 1], (2000, 3))
    with np.errstate(invalid="ignore"):
        expected = np.where(wall(anywhere) > 0.081, 0, 40)  # 0.9 times the truncation
    np.testing.assert_array_equal(model.density(anywhere), expected)
    assert 0 < (expected == 0).mean() < 1
