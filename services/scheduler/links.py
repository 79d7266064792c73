"""Measured links, from each robot to each edge and from the edges to the cloud.

What has not been measured is taken to be as good as what has been, never better: a robot would be sent round all edges
by the hope that the next one is as quick as its data sheet says.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import median

from common.wire import LinkStatus

RECENT = 5
"""reports whose median counts"""
ALIKE_S = 0.1
"""delays that differ from the fleet's median by less are taken to be as that: on a busy host they all wander"""
PAGES = 3
"""pages from which on a measured link counts"""
LINK = 12.5e6
"""bytes/s of a link between robot and edge that has not been measured: 100 Mbit/s"""
GIGABIT = 1e9 / 8


class Links:
    def __init__(self, stated: Mapping[str, float]) -> None:
        """`stated`: edge → bytes/s to the cloud by the fleet file."""
        self._stated = stated
        self._speeds: dict[str, dict[str, float]] = defaultdict(dict)
        self._delays: dict[str, dict[str, deque[float]]] = defaultdict(dict)
        self._uplinks: dict[str, float] = {}
        self._usual: float | None = None

    def frames_delayed(self, robot: str, edge: str, seconds: float) -> None:
        """Frames have taken this long from the robot's hands to the edge's."""
        if seconds > 0:
            self._delays[robot].setdefault(edge, deque(maxlen=RECENT)).append(seconds)
            self._usual = None

    def measured(self, edge: str, link: LinkStatus) -> None:
        """What an edge says of the way from a robot."""
        tier, _, robot = link.peer.partition("/")
        if tier == "robot" and link.pages >= PAGES and link.bytes_per_s > 0:
            self._speeds[robot][edge] = link.bytes_per_s

    def uplink_measured(self, link: LinkStatus) -> None:
        """What the cloud says of the way from an edge; its delay is the same for a map of any size."""
        if link.pages >= PAGES and link.bytes_per_s > 0:
            edge = link.peer.removeprefix("edge/")
            self._uplinks[edge] = link.bytes_per_s

    def transfers(self, robot: str, edges: Sequence[str], size: float) -> list[float]:
        """Bytes/s at which `size` bytes of a round come from the robot to each edge, the delay of a frame included."""
        speeds, delays = self._speeds.get(robot, {}), self._delays.get(robot, {})
        speed = median(speeds.values()) if speeds else LINK
        delay = self._like_others(median(map(median, delays.values()))) if delays else 0.0
        usual = size / (delay + size / speed)
        known = {
            edge: size / (self._delay(delays.get(edge), delay) + size / speeds.get(edge, speed))
            for edge in speeds.keys() | delays.keys()
        }
        return [known.get(edge, usual) for edge in edges]

    def _delay(self, seen: Iterable[float] | None, usual: float) -> float:
        return self._like_others(median(seen)) if seen is not None else usual

    def _like_others(self, delay: float) -> float:
        if self._usual is None:
            self._usual = median(median(seen) for delays in self._delays.values() for seen in delays.values())
        return delay if abs(delay - self._usual) >= ALIKE_S else self._usual

    def uplink(self, edge: str) -> float:
        """Bytes/s from the edge to the cloud."""
        return self._uplinks.get(edge) or as_stated(self._uplinks, self._stated, edge, GIGABIT)

    def figures(self) -> Iterator[tuple[str, float]]:
        for robot, speeds in sorted(self._speeds.items()):
            yield from ((f"link {robot} {edge} bytes/s", speed) for edge, speed in sorted(speeds.items()))
        for robot, delays in sorted(self._delays.items()):
            yield from ((f"delay {robot} {edge} s", median(seen)) for edge, seen in sorted(delays.items()))


def as_stated(measured: Mapping[str, float], stated: Mapping[str, float], edge: str, default: float) -> float:
    """The stated value of an edge that has not been measured, corrected by how those that have been turned out."""
    off = [value / stated.get(other, default) for other, value in measured.items()]
    return stated.get(edge, default) * (median(off) if off else 1.0)
