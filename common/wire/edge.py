"""What edge workers send."""

from __future__ import annotations

from typing import Literal

from common.wire.base import Cover, Covers, Epoch, Message, Name, Part, PoseTuple, StreamId
from common.wire.link import LinkStatus


class Ack(Message):
    """How far an edge has come with a robot's stream; the robot may send up to `processed + window`."""

    robot: Name
    edge: Name
    stream: StreamId
    epoch: Epoch
    processed: int
    """last frame processed, -1 for none"""
    durable: int
    """last frame that no crash can lose; the robot may forget up to here"""
    window: int


class PoseUpdate(Message):
    robot: Name
    edge: Name
    seq: int
    stamp: float
    pose: PoseTuple
    """robot base in its own map frame"""


class MapNotice(Message):
    """A new version of a robot map stands ready at `edge/<eid>/robot/<rid>/map`."""

    robot: Name
    edge: Name
    epoch: Epoch
    version: int
    resolution: float
    cover: Cover
    final: bool
    """the stream has ended and all of it is in this version"""
    slam_s: float = 0.0
    """time spent in SLAM for this robot so far"""
    transfer_s: float = 0.0
    """mean time of a frame from the robot's hands to this edge's"""


VerdictKind = Literal["merged", "ambiguous", "no_overlap", "conflict", "insufficient"]


class PairVerdict(Part):
    """What was decided about two robot maps, with the evidence (see common.fusion.verdict)."""

    a: Name
    b: Name
    kind: VerdictKind
    versions: tuple[int, int]
    """robot map versions that were compared"""
    transform: PoseTuple | None = None
    """pose of b's map frame in a's"""
    information: tuple[float, ...] | None = None
    """inverse covariance of the transform (3 x 3, row by row; m and rad)"""
    final: bool = False
    """about the final maps of both"""
    searched: bool = False
    """one map was looked for everywhere in the other, so that, when final, the verdict rests on nothing but these two
    maps; otherwise the pair was judged where other pairs put it, or passed over as unlike"""
    overlap: float = 0.0
    """|A∩B| / (|A|+|B|) over known cells, 0 to 0.5 (the paper's overlapping degree)"""
    agreement: float = 0.0
    """share of wall cells in the overlap that find a wall"""
    conflict: float = 0.0
    """share of wall cells in the overlap that lie in the other's free space"""
    runner_up: float = 0.0
    """score of the best distinct other hypothesis over that of the best"""
    reason: str = ""


class Verdicts(Message):
    """All pairs that one owner has decided."""

    owner: str
    pairs: tuple[PairVerdict, ...]


class Component(Part):
    """Robots whose relative transforms are known."""

    id: str
    """name of its first robot in sorted order"""
    robots: tuple[Name, ...]
    transforms: dict[Name, PoseTuple]
    """robot map frame in the component's frame"""


class EdgeMapNotice(Message):
    """A new version of an edge map stands ready at `edge/<eid>/map`."""

    edge: Name
    version: int
    world_epoch: int
    """0: rendered on the edge's own lattice, otherwise the epoch of the world transforms used"""
    resolution: float
    components: tuple[Component, ...]
    covers: Covers
    final: bool
    fuse_s: float = 0.0
    """time of the last preparative fusion"""
    transfer_s: float = 0.0
    """time to fetch the robot maps for it"""
    area_m2: float = 0.0
    """known cells"""


class Claims(Message):
    """Which robots this edge runs, and the epoch that gave it each."""

    edge: Name
    claims: dict[Name, Epoch]
    epoch: Epoch = (0, 0)
    """of the latest routing table that it has taken"""


VANISHED = "vanished"
"""state of an instance whose robot is gone: its map is final as it is"""


class InstanceStatus(Part):
    robot: Name
    state: str
    """opening, running, finishing, final or vanished"""
    processed: int
    pending: int
    worker: int
    scan_ms: float
    """mean time of one scan lately"""
    gaps: int
    skipped: int
    """frames of unknown kinds, or set aside as harmful"""


class EdgeStatus(Message):
    edge: Name
    cores: int
    cpu_s: float
    rss_mb: float
    instances: tuple[InstanceStatus, ...]
    fusing: tuple[Name, ...]
    stages: dict[str, float]
    """seconds of the last run of each stage"""
    counters: dict[str, int]
    """drops, refusals, restarts; all since start"""
    bytes_in: int = 0
    bytes_out: int = 0
    links: tuple[LinkStatus, ...] = ()
    """ways from robots, and from edges that run SLAM for maps fused here"""
    problems: tuple[str, ...] = ()
    """last refusals, each with its sender"""
