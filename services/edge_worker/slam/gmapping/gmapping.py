"""The `gmapping` kernel: a Rao-Blackwellised particle filter over trajectories.

After Grisetti, Stachniss and Burgard, "Improved techniques for grid mapping with Rao-Blackwellized particle filters"
(IEEE T-RO 2007), as GMapping carries it out: each particle matches a scan with its own map by hill climbing, is
weighed by the scan's likelihood there, and particles are resampled only when few of them still count. Beyond it, every
frame is tracked on the best particle's map, so that particles start from matched motion, not from odometry, and a
robot without odometry can be mapped too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import between, compose, wrap
from common.grid import Grid
from common.wire import Frame
from services.edge_worker.slam.corrections import Corrections
from services.edge_worker.slam.gmapping import patch_state, snapshot
from services.edge_worker.slam.gmapping.particle_chart import ParticleChart
from services.edge_worker.slam.gmapping.particle_matcher import ParticleMatcher, Uncertainty
from services.edge_worker.slam.gmapping.particle_track import ParticleTrack, way_of
from services.edge_worker.slam.gmapping.particle_tree import Generation, ParticleTree
from services.edge_worker.slam.gmapping.patch_map import PatchMap
from services.edge_worker.slam.gmapping.resampling import effective, normalised, systematic
from services.edge_worker.slam.gmapping.settings import GMappingSettings
from services.edge_worker.slam.kernel import Estimate
from services.edge_worker.slam.scan import NO_POINTS, Scan, ScanReader
from services.edge_worker.slam.settings import read_settings

MOVES = 20
"""scans that are drawn elsewhere when the map is asked for: each takes half a millisecond, and the robot waits"""


class GMapping:
    """One robot's particle filter."""

    def __init__(self, settings: GMappingSettings, seed: int) -> None:
        self.settings, self.seed = settings, seed
        n = settings.particles
        self.reader = ScanReader(settings.range_m, settings.clear_m)
        self.maps = PatchMap(n, settings.resolution_m)
        self.settled = PatchMap(1, settings.resolution_m)
        """the hits of the scans that the tree has settled, as all particles have them; only a snapshot needs it"""
        self.matcher = ParticleMatcher(settings, self.maps)
        self.tree = ParticleTree()
        self.tree.append(Generation(np.zeros((n, 3)), np.zeros(n, np.int64), NO_POINTS, NO_POINTS, np.zeros(2)))
        self.chart = ParticleChart(settings.resolution_m)
        self.track = ParticleTrack()
        self.log_weights = np.zeros(n)
        """(n,) since the last resampling"""
        self.evidence = np.zeros(n)
        """(n,) log-likelihood of each particle's whole ancestry: the greatest is the best particle's"""
        self.since = np.zeros(3)
        """(3,) tracked motion since the last registered scan, in its base"""
        self.way = 0.0
        """m travelled since then, turns included"""
        self.spread = np.zeros(3)
        """(3,) variance of the particles' scatter about `since`: m^2, m^2, rad^2"""

    @classmethod
    def create(cls, settings: Mapping[str, Any], seed: int) -> GMapping:
        """A new kernel. Raises ConfigError naming the field."""
        return cls(read_settings(GMappingSettings, settings), seed)

    @property
    def poses(self) -> NDArray[np.float64]:
        """(n, 3) of the particles at the last registered scan."""
        return self.tree.branches[-1].poses

    @property
    def best(self) -> int:
        """The particle whose ancestry explains all scans best."""
        return int(np.argmax(self.evidence))

    @property
    def corrections(self) -> Corrections:
        return self.chart.corrections

    def process(self, frame: Frame) -> Estimate:
        """Take the next frame. A frame without usable beams moves the pose by odometry only."""
        scan = self._as_told(self.reader.read(frame))
        usable = len(scan.points) >= self.settings.min_points
        scan, matched = self._advance(scan, usable)
        if usable and self._is_due():
            self._register(scan)
        self.track.append(scan.stamp, len(self.tree) - 1, self.since, self.way)
        return Estimate(compose(self.poses[self.best], self.since), matched)

    def finish(self) -> None:
        """Nothing is pending in a filter; the map is made the best particle's throughout."""
        self.chart.follow(self.tree, self.best)

    def prepare(self, seconds: float) -> bool:
        """Nothing is left to `map` that takes time: it moves few scans a call."""
        return True

    def map(self) -> Grid:
        """The best particle's map, ray traced; after another one became best, older scans follow in later calls."""
        self.chart.follow(self.tree, self.best, MOVES)
        return self.chart.grid

    def trajectory(self) -> NDArray[np.float64]:
        """(n, 4): stamp s, x m, y m, theta rad, one row for every frame taken, by the best particle's ancestry."""
        return self.track.poses(self.tree.lineage(self.best))

    def snapshot(self) -> bytes:
        """All state, so that `restore` continues bit for bit."""
        return snapshot.write(self)

    def restore(self, data: bytes) -> None:
        """Take over a snapshot of a kernel of the same settings. Raises SnapshotRefused, and then keeps its state."""
        snapshot.read(data, self)

    def _as_told(self, scan: Scan) -> Scan:
        """Where wheels are suspected of slip: the motion that they tell first, and what is left without slip second.

        A robot that starts suddenly, or whose stamps bunch, looks as if its wheels slipped. Matching says which it was.
        """
        length = float(np.hypot(scan.motion[0], scan.motion[1]))
        if not self.reader.reckoning.wheels.slipping or length == 0.0:
            return scan
        told = scan.motion.copy()
        told[:2] *= 1.0 + scan.surge / length
        return replace(scan, motion=told, alternatives=np.vstack([scan.motion, scan.alternatives]))

    def _advance(self, scan: Scan, usable: bool) -> tuple[Scan, bool]:
        """Move `since` by dead reckoning, corrected on the best particle's map.

        Returns the scan, compensated anew where matching told the velocity in the sweep, and whether it matched.
        """
        before, doubt = self.since, self._doubt(scan)
        self.since = compose(before, scan.motion)
        matched = False
        if usable and self.maps.held:
            matched = self._track(scan, before, doubt)
        slip = None
        if matched and scan.velocity is not None and not scan.turn_measured and scan.times.any():
            base = self.poses[self.best]
            scan, pose, slip = self.matcher.unslip(scan, compose(base, self.since), doubt, self.best)
            self.since = between(base, pose)
        motion = between(before, self.since)
        self.reader.reckoning.learn(motion, matched)
        if slip is not None:
            self.reader.reckoning.slipped(slip)
        self.way += way_of(motion)
        self.spread += self._drift(motion) if matched else np.square([doubt.metres, doubt.metres, doubt.radians])
        return scan, matched

    def _track(self, scan: Scan, before: NDArray[np.float64], doubt: Uncertainty) -> bool:
        """Correct `since` on the best particle's map, from the first of the motions offered that leads to a match."""
        base = self.poses[self.best]
        guesses = compose(base, compose(before, np.vstack([scan.motion, scan.alternatives])))
        self.maps.cover_scan(scan.points, guesses, self.settings.search_m)
        for guess in guesses:
            pose, matched = self.matcher.track(scan.points, guess, doubt, self.best)
            if matched:
                self.since = between(base, pose)
                return True
        return False

    def _doubt(self, scan: Scan) -> Uncertainty:
        """How far dead reckoning since the frame before may be off."""
        s, metres, turn = self.settings, float(np.hypot(*scan.motion[:2])), abs(float(scan.motion[2]))
        measured = Uncertainty(
            s.odometry_m_per_m * metres, s.odometry_rad_per_rad * turn + s.odometry_rad_per_m * metres
        )
        if scan.measured:
            return measured
        shift, swing = 0.5 * s.guess_mps2 * scan.dt**2, 0.5 * s.guess_radps2 * scan.dt**2
        return Uncertainty(min(shift, s.search_m), measured.radians if scan.turn_measured else min(swing, s.search_rad))

    def _drift(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        s, metres, turn = self.settings, float(np.hypot(motion[0], motion[1])), abs(float(motion[2]))
        across = s.drift_m_per_sqrt_m**2 * metres
        return np.array([across, across, s.drift_rad_per_sqrt_m**2 * metres + s.drift_rad_per_sqrt_rad**2 * turn])

    def _is_due(self) -> bool:
        if not self.maps.held:
            return True
        moved, turned = float(np.hypot(self.since[0], self.since[1])), abs(float(self.since[2]))
        return moved >= self.settings.register_m or turned >= self.settings.register_rad

    def _register(self, scan: Scan) -> None:
        """One step of the filter: propose, match, weigh, resample, map."""
        n = self.settings.particles
        noise = np.random.Generator(np.random.Philox(key=[self.seed & (2**64 - 1), len(self.tree)]))
        poses, parents = compose(self.poses, self.since), np.arange(n)
        if self.maps.held:
            poses = compose(poses, np.sqrt(self.spread) * noise.standard_normal((n, 3)))
            self.maps.cover_scan(scan.points, poses, self.settings.search_m)
            poses, likelihoods = self.matcher.climb(scan.points, poses)
            poses[:, 2] = wrap(poses[:, 2])
            parents = self._weigh(likelihoods, noise.random())
            poses = poses[parents]
        self.maps.cover_scan(scan.points, poses)
        self.maps.add(scan.points, poses)
        self.tree.append(Generation(poses, parents, scan.points, scan.silent, scan.laser))
        fixed = self.tree.settle()
        self.chart.settle(fixed)
        patch_state.settle(self.settled, fixed)
        self.track.close(self.since, self.way)
        self.since, self.way, self.spread = np.zeros(3), 0.0, np.zeros(3)

    def _weigh(self, likelihoods: NDArray[np.float64], draw: float) -> NDArray[np.int64]:
        """Count log-likelihoods (n,) into the weights; returns the parents (n,), resampled if few particles count."""
        s = self.settings
        self.log_weights += likelihoods
        self.evidence += likelihoods
        weights = normalised(self.log_weights, s.smoothing)
        if (
            len(self.tree.branches) > s.lag_scans
        ):  # only those that share the heaviest one's past live on, so that memory is bounded
            past = self.tree.ancestors(s.lag_scans // 2)
            weights = np.where(past == past[np.argmax(weights)], weights, 0.0)
        elif effective(weights) >= s.resample_share * s.particles:
            return np.arange(s.particles)
        parents = systematic(weights, draw)
        self.maps.resample(parents)
        self.log_weights[:] = 0.0
        self.evidence = self.evidence[parents]
        return parents
