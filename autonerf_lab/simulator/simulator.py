"""Simulator of a disc-shaped robot with a camera in a scene."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from autonerf_lab.errors import SceneError, SegmenterError
from autonerf_lab.geometry import Intrinsics, camera_rays, planar_from_pose, planar_pose
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.segmentation import TRUE, Segmenter, make_segmenter, segmenter_name
from autonerf_lab.simulator.depth_noise import depth_noise as depth_noise_model
from autonerf_lab.simulator.motion_noise import Motion, MotionNoise, compose, motion_noise
from autonerf_lab.simulator.navigation import NavigationGrid, build_navigation
from autonerf_lab.simulator.rasterizer import chunk_bounds, rasterize, shade
from autonerf_lab.simulator.raycast import Hits, RayCaster
from autonerf_lab.simulator.specular import NO_GLOSS, scene_gloss
from autonerf_lab.types import Action, Observation
from autonerf_lab.utils.arguments import refuse_name
from autonerf_lab.utils.plugins import named_errors

if TYPE_CHECKING:
    from autonerf_lab.presets import Preset

_COLLISION = 0.8  # share of a forward motion below which it counts as a collision (0.20 m of 0.25 m)
CAST_FROM = 250_000  # triangles from which ray casting replaces rasterisation, whose cost grows with their number
_NO_NOISE = MotionNoise(actuation=False, odometry=False)


@dataclass(frozen=True)
class Frame:
    """Image, depth and ground-truth labels at one camera pose."""

    rgb: np.ndarray  # (H, W, 3) uint8 sRGB, mean of the samples of each pixel; black = no surface
    depth: np.ndarray  # (H, W) float32 along the optical axis at the pixel centre, metres, 0 = no surface
    semantics: np.ndarray  # (H, W) uint8, class index at the pixel centre
    instances: np.ndarray  # (H, W) int32, object id at the pixel centre, 0 = building or no surface


class _SceneGeometry:
    """Preprocessed geometry that all simulators of one scene share."""

    def __init__(self, scene: Scene) -> None:
        self.navigation: NavigationGrid = build_navigation(scene)
        self.triangles = np.ascontiguousarray(scene.vertices[scene.faces], dtype=np.float32)
        # Face -1 (no surface) reads the last entry.
        self.classes = np.append(scene.face_class, 0).astype(np.uint8)
        self.instances = np.append(scene.face_instance, 0).astype(np.int32)

    @cached_property
    def raster_mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices, faces and bounds for :func:`rasterize`; a large mesh is cast instead, and needs none."""
        points, index = np.unique(self.triangles.reshape(-1, 3), axis=0, return_inverse=True)
        faces = index.reshape(-1, 3).astype(np.int32)
        return np.ascontiguousarray(points.T), faces, chunk_bounds(self.triangles)

    @cached_property
    def caster(self) -> RayCaster:
        """Ray caster, built on first access: it needs hundreds of megabytes for a large mesh."""
        return RayCaster(self.triangles)


_geometries: "WeakKeyDictionary[Scene, _SceneGeometry]" = WeakKeyDictionary()


class Simulator:
    """Simulator of a robot in a scene: a disc of 0.18 m radius with a level camera at 0.88 m.

    **Frames.** The world frame is that of the scene: metres, right-handed, z up, floor at z = 0. Poses are (4, 4)
    float64 camera-to-world matrices with OpenGL axes: x right, y up, the camera looks along -z.

    **Actions** (:class:`~autonerf_lab.types.Action`). 0: 0.25 m forward; 1: rotate 30 degrees left; 2: rotate 30
    degrees right. The robot slides along obstacles. A forward motion shorter than 80 % of the commanded one is a
    collision.

    **Observations** (:class:`~autonerf_lab.types.Observation`). Colour, depth along the optical axis in metres,
    classes, pose by odometry, collision flag and number of steps. Without noise, odometry is exact.

    **Start.** :meth:`reset` samples a navigable start pose unless one is given. The simulator has no time limit.

    Args:
        scene: Scene to simulate.
        intrinsics: Camera intrinsics; default: 128 x 128 pixels, 90 degrees horizontal field of view.
        supersample: Samples per pixel along each axis; colours are their mean. Depth and labels are those of the pixel
            centre.
        rgb: Render colours; False leaves them black, which is faster.
        noise: Noise of motion and odometry, or the name of its model, such as ``"ans"``; default: none.
        depth_noise: Noise of the depth in observations, ``"redwood"``; default: none. :meth:`render` stays exact.
        semantics: Source of the classes in observations: ``"true"``, ``"predicted"``, ``"noisy"``, or another
            segmenter, see :func:`~autonerf_lab.segmentation.make_segmenter`. :meth:`render` stays exact. A segmenter
            needs colours, so that ``rgb`` has no effect.
        gloss: Render view-dependent highlights on glossy surfaces (generated scenes only).

    Raises:
        SceneError: The scene has no floor, the robot fits nowhere, or ``gloss`` is True for an imported mesh.
        UnknownNameError: There is no noise, or no segmenter, of that name.
        DataError: The weights of the segmenter are missing or damaged.
        WrongTypeError: ``scene`` is a name.
        ValueError: ``supersample`` is below 1, or the camera has lens distortion.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> observation = sim.reset(seed=0)
        >>> observation = sim.step(Action.TURN_LEFT)
        >>> observation.depth.shape, observation.step, observation.collided
        ((32, 32), 1, False)
    """

    def __init__(
        self,
        scene: Scene,
        intrinsics: Intrinsics | None = None,
        supersample: int = 2,
        rgb: bool = True,
        noise: MotionNoise | str | None = None,
        gloss: bool = False,
        depth_noise: str | None = None,
        semantics: str | Segmenter = TRUE,
    ) -> None:
        refuse_name(scene, "the scene of a simulator", "lab.load_scene({})")
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, not {supersample}")
        self.scene = scene
        self.intrinsics = intrinsics or Intrinsics.from_fov(128, 128)
        if any(self.intrinsics.lens):
            raise ValueError("the camera of the simulator has no lens distortion; set k1 to k3, p1 and p2 to 0")
        self.supersample = supersample
        self.semantics = segmenter_name(semantics)
        self._segmenter = None if self.semantics == TRUE else make_segmenter(semantics)
        self.rgb = rgb or self._segmenter is not None
        self.noise = (motion_noise(noise) if isinstance(noise, str) else noise) or _NO_NOISE
        self.depth_noise = depth_noise
        self._measure = depth_noise_model(depth_noise)
        if scene not in _geometries:
            _geometries[scene] = _SceneGeometry(scene)
        self._geometry = _geometries[scene]
        self.navigation = self._geometry.navigation
        self._gloss = scene_gloss(scene) if gloss else NO_GLOSS
        width, height = self.intrinsics.width, self.intrinsics.height
        self._fine_intrinsics = self.intrinsics.resized(width * supersample, height * supersample)
        self._face = np.empty((height, width), np.int32)
        self._inverse_depth = np.empty((height, width), np.float32)
        self._fine_face = np.empty((height * supersample, width * supersample), np.int32)
        self._fine_inverse_depth = np.empty(self._fine_face.shape, np.float32)
        self._rng = np.random.default_rng(0)
        self._depth_rng, self._segmenter_rng = self._rng.spawn(2)  # apart, so that they change no motion
        self._true_pose = (0.0, 0.0, 0.0)  # true x, y (metres), heading (radians)
        self._odometry = self._true_pose  # x, y, heading by odometry
        self._collided = False
        self._step = 0

    @classmethod
    def from_preset(
        cls,
        scene: Scene,
        preset: "Preset",
        noise: MotionNoise | str | None = None,
        depth_noise: str | None = None,
        semantics: str | Segmenter = TRUE,
    ) -> "Simulator":
        """Create a simulator with the camera intrinsics and supersampling of a preset.

        Example:
            >>> from autonerf_lab.presets import preset
            >>> from autonerf_lab.scenes import load_scene
            >>> Simulator.from_preset(load_scene("train-00"), preset("smoke")).intrinsics.width
            48
        """
        intrinsics = Intrinsics.from_fov(preset.width, preset.height, preset.hfov_deg)
        return cls(scene, intrinsics, preset.supersample, noise=noise, depth_noise=depth_noise, semantics=semantics)

    @property
    def pose(self) -> np.ndarray:
        """True camera-to-world pose, (4, 4) float64; ``Observation.pose`` is the pose by odometry."""
        return planar_pose(*self._true_pose)

    def render(self, c2w: np.ndarray, rgb: bool = True) -> Frame:
        """Render image, depth and labels at any pose, without moving the robot.

        Args:
            c2w: (4, 4) camera-to-world pose; need not be level.
            rgb: Render colours; False leaves them black and does not compute the texture of the scene.
        """
        c2w = np.asarray(c2w, dtype=np.float64)
        w2c = np.linalg.inv(c2w)
        self._draw(c2w, w2c, self.intrinsics, self._inverse_depth, self._face)
        colors = np.zeros((*self._face.shape, 3), np.uint8)
        if rgb:
            face = self._face
            if self._fine_face.shape != face.shape:
                face = self._fine_face
                self._draw(c2w, w2c, self._fine_intrinsics, self._fine_inverse_depth, face)
            g = self._gloss
            texture = self.scene.texture
            shade(
                face, self._geometry.triangles, self.scene.uv, texture, w2c, _camera(self._fine_intrinsics),
                g.strength, g.room, g.first, g.lamps, colors,
            )  # fmt: skip
        hit = self._inverse_depth > 0
        depth = np.divide(np.float32(1), self._inverse_depth, out=np.zeros(hit.shape, np.float32), where=hit)
        return Frame(colors, depth, self._geometry.classes[self._face], self._geometry.instances[self._face])

    def _draw(
        self, c2w: np.ndarray, w2c: np.ndarray, camera: Intrinsics, inverse_depth: np.ndarray, face: np.ndarray
    ) -> None:
        """Write inverse depth and face of every pixel, by rasterisation or, for a large mesh, by ray casting."""
        if len(self._geometry.triangles) < CAST_FROM:
            rasterize(*self._geometry.raster_mesh, w2c, _camera(camera), inverse_depth, face)
            return
        rays_o, rays_d = camera_rays(camera, c2w)
        hits = self.cast(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3))
        face[:] = hits.face.reshape(face.shape)
        inverse_depth[:] = 1 / hits.t.reshape(face.shape)

    def cast(self, rays_o: np.ndarray, rays_d: np.ndarray) -> Hits:
        """Return the first hits of rays with (N, 3) origins (metres) and directions of any length, world frame."""
        return self._geometry.caster.cast(rays_o, rays_d)

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """Sample a (4, 4) camera-to-world pose, uniform over navigable floor and heading."""
        x, y = self.navigation.sample(rng)
        return planar_pose(x, y, rng.uniform(-np.pi, np.pi))

    def reset(self, seed: int | None = None, pose: np.ndarray | None = None) -> Observation:
        """Start an episode and return its first observation.

        Args:
            seed: Random seed of start pose and noise; None uses entropy of the operating system.
            pose: (4, 4) camera-to-world start pose; only position and heading are used. Default: sampled.

        Raises:
            SceneError: The robot does not fit at ``pose``.
        """
        self._rng = np.random.default_rng(seed)
        self._depth_rng, self._segmenter_rng = self._rng.spawn(2)
        if self._segmenter is not None:
            with named_errors(f"segmenter {self.semantics!r}", "in reset", SegmenterError):
                self._segmenter.reset(self._segmenter_rng)
        x, y, heading = planar_from_pose(self.sample_pose(self._rng) if pose is None else np.asarray(pose))
        if not self.navigation.is_navigable(x, y):
            raise SceneError(
                f"scene {self.scene.name!r}: the robot cannot stand at x = {x:.2f}, y = {y:.2f} m; pass another pose,"
                " or pose=None to sample a navigable one"
            )
        self._true_pose = self._odometry = (x, y, heading)
        self._collided = False
        self._step = 0
        return self.observe()

    def move(self, action: int) -> bool:
        """Execute an action without rendering.

        Args:
            action: 0 forward, 1 left, 2 right, see :class:`~autonerf_lab.types.Action`.

        Returns:
            True if the action was a forward motion that ended in a collision.

        Raises:
            ValueError: ``action`` is not one of the three actions.
        """
        action = Action(action)
        x, y, heading = self._true_pose
        forward, left, turn = self.noise.motion(action, self._rng)
        target_x, target_y, new_heading = compose(x, y, heading, (forward, left, turn))
        new_x, new_y = self.navigation.move(x, y, target_x - x, target_y - y)
        self._true_pose = (new_x, new_y, new_heading)
        c, s = np.cos(heading), np.sin(heading)
        moved: Motion = (
            c * (new_x - x) + s * (new_y - y),
            c * (new_y - y) - s * (new_x - x),
            turn,
        )
        error = self.noise.odometry_error(action, self._rng)
        self._odometry = compose(*self._odometry, (moved[0] + error[0], moved[1] + error[1], moved[2] + error[2]))
        self._collided = action == Action.FORWARD and bool(np.hypot(*moved[:2]) < _COLLISION * forward)
        self._step += 1
        return self._collided

    def observe(self) -> Observation:
        """Return the observation at the current pose."""
        frame = self.render(self.pose, self.rgb)
        pose = planar_pose(*self._odometry)
        depth = frame.depth if self._measure is None else self._measure(frame.depth, self._depth_rng)
        labels, confidence = frame.semantics, None
        if self._segmenter is not None:
            with named_errors(f"segmenter {self.semantics!r}", f"at step {self._step}", SegmenterError):
                found = self._segmenter(frame.rgb, depth, frame.semantics)
                labels, confidence = found.labels, found.confidence
        return Observation(frame.rgb, depth, labels, pose, self._collided, self._step, confidence)

    def step(self, action: int) -> Observation:
        """Execute an action and return the next observation; arguments and errors are those of :meth:`move`."""
        self.move(action)
        return self.observe()


def _camera(intrinsics: Intrinsics) -> np.ndarray:
    """Return fl_x, fl_y, cx, cy as an array for the kernels."""
    return np.array([intrinsics.fl_x, intrinsics.fl_y, intrinsics.cx, intrinsics.cy])
