"""Online pose estimation: calibrated odometry, scan matching with keyframes, and a pose graph with loop closures."""

from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.odometry import OdometryModel
from autonerf_lab.localization.pose_graph import PoseGraph
from autonerf_lab.localization.scan import Scan, make_scan
from autonerf_lab.localization.scan_matching import WIDTHS, ScanFactor, compare, match
from autonerf_lab.localization.se2 import between, compose, moved_covariance, to_matrices, to_planar
from autonerf_lab.types import Action, Observation

if TYPE_CHECKING:
    from autonerf_lab.localization.learned import LearnedOdometry

KEYFRAME_DISTANCE, KEYFRAME_ANGLE = 0.4, float(np.radians(20))  # nearest keyframe, beyond which a new one is made
_REACH, _ANGLE = 3.0, float(np.radians(75))  # metres and radians, farthest keyframe that is compared
_CANDIDATES = 10  # nearest keyframes, of the recent and of the older ones, whose overlap is computed
_RECENT = 75  # steps; older keyframes are matched one by one, because drift separates them from the recent ones
_REFERENCES = 2  # recent keyframes, and as many older ones
_OVERLAP = 0.25  # smallest share of the points of a scan that a reference must see
_INLIERS = 0.5  # smallest share of these points that must lie on its surfaces
_POINTS = 150  # smallest number of points of a scan that can be matched
_OPTIMIZE_EVERY = 25  # steps
_DRIFT = np.diag(np.square([0.04, 0.04, 0.012]))  # metres and radians, least one between recent and older keyframes
_GATE = 16.0  # largest squared Mahalanobis distance of a match from its prior
_CLOSED = (0.08, 0.025)  # metres and radians, correction by a loop closure after which the graph is optimised soon
_SOON = 5  # steps
_FINAL_ITERATIONS = 5
_LEAST = np.diag(np.square([1e-3, 1e-3, 1e-3]))  # least covariance of a prior
_LOST = np.diag(np.square([0.5, 0.5, 0.5]))  # metres and radians, added when a scan contradicts the odometry


class PoseEstimator:
    """Estimator of the pose of a robot with noisy odometry and a depth camera.

    Args:
        intrinsics: camera model of the depth images.
        model: calibration of the odometry.
        scans: match depth images with keyframes; without, the estimate is the sum of the motions.
        loops: correct earlier poses in a pose graph; without, keyframes stay where they were added.
        learned: correction of each motion by a network; None: calibrated odometry.

    Attributes:
        pose: (3,) estimated x, y, heading.
        covariance: (3, 3) of ``pose``, world frame.
        revision: number of corrections of earlier poses so far.
    """

    def __init__(
        self,
        intrinsics: Intrinsics,
        model: OdometryModel,
        scans: bool = True,
        loops: bool = True,
        learned: "LearnedOdometry | None" = None,
    ) -> None:
        self.intrinsics, self.model, self.scans, self.loops, self.learned = intrinsics, model, scans, loops, learned

    def start(self, observation: Observation) -> None:
        """Begin an episode at the known pose of the first observation."""
        self.pose, self.covariance, self.revision = to_planar(observation.pose), np.zeros((3, 3)), 0
        self._measured, self._height = self.pose, float(observation.pose[2, 3])  # pose by odometry; of the camera
        self._graph = PoseGraph(self.pose)
        self._base, self._local = np.zeros((3, 3)), np.zeros((3, 3))  # covariances of the last optimised pose; since
        self._frames: list[int] = []  # of the keyframes
        self._scans: list[Scan] = []
        self._optimized = 0
        self._last = self._scan(observation)
        if self._last is not None and self._last.count >= _POINTS:
            self._frames, self._scans = [0], [self._last]

    @property
    def c2w(self) -> np.ndarray:
        """Estimated camera-to-world pose, (4, 4)."""
        return to_matrices(self.pose[None], self._height)[0]

    @property
    def standard_deviations(self) -> list[float]:
        """Standard deviations of x, y (metres) and heading (radians)."""
        return [round(float(value), 6) for value in np.sqrt(np.diag(self.covariance).clip(0))]

    @property
    def trajectory(self) -> np.ndarray:
        """(T, 4, 4) camera-to-world poses of all steps, as estimated now."""
        return to_matrices(self._graph.poses, self._height)

    def update(self, observation: Observation, action: int) -> None:
        """Add the observation after an action; its pose is that of odometry."""
        measured = to_planar(observation.pose)
        motion = self.model.corrected(between(self._measured, measured), action)
        noise, before, scan = self.model.covariances[Action(action)], self.pose, self._scan(observation)
        if self.learned is not None and scan is not None and self._last is not None:
            motion, noise = self.learned.correct(scan, self._last, motion, noise)
            if _contradict(scan, self._last, motion):
                noise = noise + _LOST
        self._measured = measured
        self._base = moved_covariance(before, self._base, motion, np.zeros((3, 3)))
        self._local = moved_covariance(before, self._local, motion, noise)
        self.pose = compose(before, motion)
        node = self._graph.add_pose(self.pose)
        if self.scans and scan is not None and not self._localize(scan, node):
            # Lost. What was mapped before says nothing about the place now: the map begins again, with this scan.
            noise, self._base, self._local = noise + _LOST, self._base + self._local + _LOST, np.zeros((3, 3))
            self._frames, self._scans = [node], [scan]
        self._last = scan
        self._graph.add_edge(node - 1, node, motion, np.linalg.inv(noise))
        if self.scans and self.loops and node - self._optimized >= _OPTIMIZE_EVERY:
            self.optimize()
        self.covariance = self._base + self._local

    def optimize(self, iterations: int = 1) -> None:
        """Correct all poses by the pose graph."""
        self._base, self._local = self._graph.optimize(iterations), np.zeros((3, 3))
        self._optimized = len(self._graph.poses) - 1
        self.pose = self._graph.poses[-1].copy()
        self.covariance = self._base
        self.revision += 1

    def finish(self) -> None:
        """Correct all poses at the end of an episode."""
        if self.scans and self.loops:
            self.optimize(_FINAL_ITERATIONS)

    def _scan(self, observation: Observation) -> Scan | None:
        needed = self.scans or self.learned is not None
        return make_scan(observation.depth, self.intrinsics) if needed else None

    def _localize(self, scan: Scan, node: int) -> bool:
        """Match a scan with the keyframes and move the pose; return False if the scan contradicts the odometry."""
        if scan.count < _POINTS:
            return True
        recent, older = self._references(scan, node)
        fits = self._track(scan, node, [(self._frames[k], self._scans[k]) for k in recent])
        if not fits and self._last is not None and self._last.count >= _POINTS:
            fits = self._track(scan, node, [(node - 1, self._last)])
        if fits is None and self._last is not None:
            fits = not _contradict(scan, self._last, between(self._graph.poses[node - 1], self.pose))
        if fits is False:
            return False
        self._graph.poses[node] = self.pose
        if self.loops:
            for k in older:
                self._close(scan, node, self._frames[k], self._scans[k])
        if not self._near_keyframe():
            if not self.loops:  # the pose of a keyframe is final: its error adds to those of later poses
                self._base, self._local = self._base + self._local, np.zeros((3, 3))
            self._frames.append(node)
            self._scans.append(scan)
        return True

    def _track(self, scan: Scan, node: int, references: list[tuple[int, Scan]]) -> bool | None:
        """Match a scan with recent scans, given with their nodes, and move the pose if it fits.

        Returns:
            True if it fits, False if it contradicts them, None if they see too little of it to say.
        """
        prior = self._local + _LEAST
        found = match(scan, self.pose, prior, [(self._graph.poses[i], other) for i, other in references])
        fitting = [(i, f) for (i, _), f in zip(references, found.factors, strict=True) if _fits(f, scan)]
        if not fitting or not _plausible(found.pose, self.pose, prior):
            return False if any(f.overlap > _OVERLAP * scan.count for f in found.factors) else None
        for i, factor in fitting:
            self._graph.add_edge(i, node, factor.motion, factor.information, factor.gradient)
        self.pose = found.pose
        self._local = np.linalg.inv(np.linalg.inv(prior) + found.information)
        return True

    def _close(self, scan: Scan, node: int, older: int, other: Scan) -> None:
        """Match a scan with an older one, and add a loop closure to the graph if it fits."""
        prior = self._base + self._local + _DRIFT
        found = match(scan, self.pose, prior, [(self._graph.poses[older], other)])
        factor = found.factors[0]
        if not _fits(factor, scan) or not _plausible(found.pose, self.pose, prior):
            return
        self._graph.add_edge(older, node, factor.motion, factor.information, factor.gradient)
        apart = np.abs(between(self.pose, found.pose))
        if np.hypot(*apart[:2]) > _CLOSED[0] or apart[2] > _CLOSED[1]:
            self._optimized = min(self._optimized, node - _OPTIMIZE_EVERY + _SOON)

    def _references(self, scan: Scan, node: int) -> tuple[list[int], list[int]]:
        """Return the recent and the older keyframes that see most of the scan."""
        if not self._frames:
            return [], []
        frames = np.array(self._frames)
        apart = between(self._graph.poses[frames], self.pose)
        distance, angle = np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])
        score = distance / _REACH + angle / _ANGLE
        usable = np.flatnonzero((distance < _REACH) & (angle < _ANGLE))
        chosen = []
        for group in (frames >= node - _RECENT, frames < node - _RECENT):
            near = usable[group[usable]]
            near = near[np.argsort(score[near])][:_CANDIDATES]
            seen = [compare(scan, self._scans[k], apart[k], WIDTHS[0], 4).overlap for k in near]
            best = np.argsort(seen)[::-1][:_REFERENCES]
            chosen.append([int(near[k]) for k in best if seen[k] > _OVERLAP * scan.count])
        return chosen[0], chosen[1]

    def _near_keyframe(self) -> bool:
        if not self._frames:
            return False
        apart = np.abs(between(self._graph.poses[self._frames], self.pose))
        return bool(((np.hypot(apart[:, 0], apart[:, 1]) < KEYFRAME_DISTANCE) & (apart[:, 2] < KEYFRAME_ANGLE)).any())


def _fits(factor: ScanFactor, scan: Scan) -> bool:
    return factor.overlap > _OVERLAP / 2 * scan.count and factor.inliers > _INLIERS * factor.overlap


def _contradict(scan: Scan, previous: Scan, motion: np.ndarray) -> bool:
    """Return True if two successive scans show different surfaces at the motion between them.

    Points behind the surfaces of the other scan are no contradiction, because they may be hidden: so each scan is
    compared with the other one.
    """
    for new, old, moved in ((scan, previous, motion), (previous, scan, between(motion, np.zeros(3)))):
        factor = compare(new, old, moved, WIDTHS[-1])
        if new.count >= _POINTS and factor.overlap > _OVERLAP * new.count and not _fits(factor, new):
            return True
    return False


def _plausible(pose: np.ndarray, guess: np.ndarray, prior: np.ndarray) -> bool:
    """Return True if a pose lies within the gate around a guess with covariance ``prior``."""
    offset = pose - guess
    return bool(offset @ np.linalg.solve(prior, offset) < _GATE)
