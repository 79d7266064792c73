"""What the state machine of an edge's SLAM asks its shell to do."""

from __future__ import annotations

from dataclasses import dataclass

from common.wire import Frame
from services.edge_worker.checkpoint import Checkpoint


@dataclass(frozen=True)
class Instruction:
    """Something to be done for a robot's instance, of this life."""

    robot: str
    life: int


@dataclass(frozen=True)
class Open(Instruction):
    """Make a kernel in this worker, from the newest checkpoint of the stream ("": of any) where there is one."""

    worker: int
    stream: str = ""
    afresh: bool = False
    """leave checkpoints alone"""


@dataclass(frozen=True)
class Feed(Instruction):
    """Hand a frame to the kernel."""

    frame: Frame


@dataclass(frozen=True)
class Fetch(Instruction):
    """Ask the robot's spool for frames from `start` on; stream "" is whatever it has."""

    stream: str
    start: int


@dataclass(frozen=True)
class Keep(Instruction):
    """Keep the kernel as it is once all that it was fed is taken."""

    checkpoint: Checkpoint


@dataclass(frozen=True)
class GiveUp(Instruction):
    """Tell that the robot is not waited for any longer: its stream ends at `seq`, until it comes back."""

    seq: int


@dataclass(frozen=True)
class Finish(Instruction):
    """Everything is taken: let the kernel refine once more, and its map be final."""

    refine: bool = True
    """False: the map is final as it is, for the refinement has killed its worker again and again"""


@dataclass(frozen=True)
class Acknowledge(Instruction):
    """Tell the robot how far its stream has been processed."""


@dataclass(frozen=True)
class Listen(Instruction):
    """Subscribe to the robot's frames."""


@dataclass(frozen=True)
class Release(Instruction):
    """Stop listening to the robot and forget its instance."""

    worker: int


@dataclass(frozen=True)
class Claim:
    """Publish which robots run here."""


Instructions = list[Instruction | Claim]
