"""The simulator: a robot with a camera in a scene."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import Intrinsics, camera_rays, planar_from_pose, planar_pose
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator.motion_noise import Motion, Noise, compose
from autonerf_lab.simulator.navigation import NavigationGrid, build_navigation
from autonerf_lab.simulator.rasterizer import chunk_bounds, rasterize, shade
from autonerf_lab.simulator.raycast import Hits, RayCaster
from autonerf_lab.simulator.specular import NONE, gloss_of
from autonerf_lab.types import Action, Observation

if TYPE_CHECKING:
    from autonerf_lab.config import Preset

_COLLISION = 0.8  # of a forward motion: getting less far is a collision (0.20 m of 0.25 m)
CAST_FROM = 250_000  # triangles; the cost of drawing grows with them, that of casting rays hardly does
_NO_NOISE = Noise(actuation=False, odometry=False)


@dataclass(frozen=True)
class Frame:
    """What a camera sees."""

    rgb: np.ndarray  # (H, W, 3) uint8, mean of the samples of each pixel; black where there is no surface
    depth: np.ndarray  # (H, W) float32, metres along the axis through the pixel centre, 0 = none
    semantics: np.ndarray  # (H, W) uint8, class at the pixel centre
    instances: np.ndarray  # (H, W) int32, object at the pixel centre, 0 = structure or none


class _Ground:
    """What simulators of one scene share: most of the time of making one goes into this."""

    def __init__(self, scene: Scene) -> None:
        self.navigation: NavigationGrid = build_navigation(scene)
        self.triangles = np.ascontiguousarray(scene.vertices[scene.faces], dtype=np.float32)
        self.chunks = chunk_bounds(self.triangles)
        # Face -1 is "no surface": it reads the last entry.
        self.classes = np.append(scene.face_class, 0).astype(np.uint8)
        self.instances = np.append(scene.face_instance, 0).astype(np.int32)

    @cached_property
    def caster(self) -> RayCaster:
        return RayCaster(self.triangles)  # hundreds of megabytes for a large mesh


_grounds: "WeakKeyDictionary[Scene, _Ground]" = WeakKeyDictionary()


class Simulator:
    """A robot (a disc of 0.18 m radius, a level camera at 0.88 m) in a scene.

    Args:
        scene: the apartment.
        intrinsics: the camera; 128x128 pixels and 90 degrees without.
        supersample: colours are the mean of ``supersample`` x ``supersample`` samples a pixel. Depth and labels are
            never averaged: they are those of the pixel centre.
        rgb: whether observations have colours (else black): policies that do not look at them train faster.
        noise: of motion and odometry; none without.
        gloss: whether polished surfaces show highlights, which move with the camera (generated scenes only).

    Raises:
        SceneError: no floor, or no place where the robot fits; or gloss for a scan.

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
        noise: Noise | None = None,
        gloss: bool = False,
    ) -> None:
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, not {supersample}")
        self.scene = scene
        self.intrinsics = intrinsics or Intrinsics.from_fov(128, 128)
        self.supersample = supersample
        self.rgb = rgb
        self.noise = noise or _NO_NOISE
        if scene not in _grounds:
            _grounds[scene] = _Ground(scene)
        self._ground = _grounds[scene]
        self.navigation = self._ground.navigation
        self._gloss = gloss_of(scene) if gloss else NONE
        width, height = self.intrinsics.width, self.intrinsics.height
        self._fine_intrinsics = self.intrinsics.resized(width * supersample, height * supersample)
        self._face = np.empty((height, width), np.int32)
        self._inverse_depth = np.empty((height, width), np.float32)
        self._fine_face = np.empty((height * supersample, width * supersample), np.int32)
        self._fine_inverse_depth = np.empty(self._fine_face.shape, np.float32)
        self._rng = np.random.default_rng(0)
        self._planar = (0.0, 0.0, 0.0)  # x, y, heading of the robot
        self._believed = self._planar  # the same by odometry
        self._collided = False
        self._step = 0

    @classmethod
    def of_preset(cls, scene: Scene, preset: "Preset") -> "Simulator":
        """With the camera of a preset: walks and test images are taken with the same one.

        Example:
            >>> from autonerf_lab.config import preset
            >>> from autonerf_lab.scenes import load_scene
            >>> Simulator.of_preset(load_scene("train-00"), preset("smoke")).intrinsics.width
            48
        """
        return cls(scene, Intrinsics.from_fov(preset.width, preset.height), supersample=preset.supersample)

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) float64 true camera-to-world pose; ``Observation.pose`` is the one by odometry."""
        return planar_pose(*self._planar)

    def render(self, c2w: np.ndarray, rgb: bool = True) -> Frame:
        """The image of the simulator's camera at any pose.

        Args:
            c2w: (4, 4) camera-to-world.
            rgb: False leaves the colours black, and the texture of the scene unmade.
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
                face, self._ground.triangles, self.scene.uv, texture, w2c, _camera(self._fine_intrinsics),
                g.strength, g.room, g.first, g.lamps, colors,
            )  # fmt: skip
        hit = self._inverse_depth > 0
        depth = np.divide(np.float32(1), self._inverse_depth, out=np.zeros(hit.shape, np.float32), where=hit)
        return Frame(colors, depth, self._ground.classes[self._face], self._ground.instances[self._face])

    def _draw(
        self, c2w: np.ndarray, w2c: np.ndarray, camera: Intrinsics, inverse_depth: np.ndarray, face: np.ndarray
    ) -> None:
        """Fill the inverse depth and the face of every pixel, by drawing or, in a large mesh, by casting."""
        if len(self._ground.triangles) < CAST_FROM:
            rasterize(self._ground.triangles, self._ground.chunks, w2c, _camera(camera), inverse_depth, face)
            return
        rays_o, rays_d = camera_rays(camera, c2w)
        hits = self.cast(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3))
        face[:] = hits.face.reshape(face.shape)
        inverse_depth[:] = 1 / hits.t.reshape(face.shape)

    def cast(self, rays_o: np.ndarray, rays_d: np.ndarray) -> Hits:
        """First hits of arbitrary rays, (N, 3) origins and directions of any length, world frame."""
        return self._ground.caster.cast(rays_o, rays_d)

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """(4, 4) camera-to-world pose, uniform over navigable ground and heading."""
        x, y = self.navigation.sample(rng)
        return planar_pose(x, y, rng.uniform(-np.pi, np.pi))

    def reset(self, seed: int | None = None, pose: np.ndarray | None = None) -> Observation:
        """Start an episode.

        Args:
            seed: of the start pose and of the noise.
            pose: (4, 4) start; drawn from ``seed`` without.

        Raises:
            SceneError: the robot does not fit at ``pose``.
        """
        self._rng = np.random.default_rng(seed)
        x, y, heading = planar_from_pose(self.sample_pose(self._rng) if pose is None else np.asarray(pose))
        if not self.navigation.is_navigable(x, y):
            raise SceneError(
                f"scene {self.scene.name!r}: the robot cannot stand at x = {x:.2f}, y = {y:.2f} m; start elsewhere,"
                " for example at sim.sample_pose(rng)"
            )
        self._planar = self._believed = (x, y, heading)
        self._collided = False
        self._step = 0
        return self.observe()

    def move(self, action: int) -> bool:
        """Act without looking; returns whether the robot bumped into something.

        Raises:
            ValueError: not one of the three actions.
        """
        action = Action(action)
        x, y, heading = self._planar
        forward, left, turn = self.noise.motion(action, self._rng)
        target_x, target_y, new_heading = compose(x, y, heading, (forward, left, turn))
        new_x, new_y = self.navigation.move(x, y, target_x - x, target_y - y)
        self._planar = (new_x, new_y, new_heading)
        c, s = np.cos(heading), np.sin(heading)
        moved: Motion = (
            c * (new_x - x) + s * (new_y - y),
            c * (new_y - y) - s * (new_x - x),
            turn,
        )
        error = self.noise.odometry_error(action, self._rng)
        self._believed = compose(*self._believed, (moved[0] + error[0], moved[1] + error[1], moved[2] + error[2]))
        self._collided = action == Action.FORWARD and bool(np.hypot(*moved[:2]) < _COLLISION * forward)
        self._step += 1
        return self._collided

    def observe(self) -> Observation:
        """What the robot sees now."""
        frame = self.render(self.pose, self.rgb)
        pose = planar_pose(*self._believed)
        return Observation(frame.rgb, frame.depth, frame.semantics, pose, self._collided, self._step)

    def step(self, action: int) -> Observation:
        """Act, then look."""
        self.move(action)
        return self.observe()


def _camera(intrinsics: Intrinsics) -> np.ndarray:
    return np.array([intrinsics.fl_x, intrinsics.fl_y, intrinsics.cx, intrinsics.cy])
