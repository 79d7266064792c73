"""One TOML file configures a fleet; `RECSLAM_SECTION__FIELD` overrides a field, the command line overrides both.

Every field has a default and its unit in its name. Loading fails with a ConfigError that names the field.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict, SettingsError

from common.errors import ConfigError
from common.wire.base import Name, PoseTuple
from common.wire.codec import explain

ENV_PREFIX = "RECSLAM_"
ENV_ELSEWHERE = {"RECSLAM_DATA", "RECSLAM_SCORER", "RECSLAM_PARENT_FD", "RECSLAM_ENDPOINT", "RECSLAM_HEARTBEAT"}
"""environment names of ours that are no configuration fields"""


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BusConfig(Section):
    endpoint: str = "tcp/127.0.0.1:7447"
    """router that the services connect to"""
    root: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")] = "recslam/v1"
    """first chunks of every key"""
    timeout_s: Annotated[float, Field(gt=0)] = 5.0
    """how long a command waits for the router"""
    grace_s: Annotated[float, Field(ge=0)] = 3.0
    """after a router loss, how long nobody is declared gone"""


class RobotConfig(Section):
    spool_mb: Annotated[float, Field(gt=0)] = 512.0
    record: bool = False
    """keep frames in the spool when they are durable elsewhere, too, so that it is a whole recording"""
    lossless: bool = False
    """send ranges as float32 instead of whole counts of 1, 2 or 5 mm"""
    realtime: bool = False
    """pace recorded and simulated frames by their stamps; otherwise as fast as the edge takes them"""
    linger_s: Annotated[float, Field(ge=0)] = 2.0
    """how long a robot whose stream has ended stays to serve backfill after the edge has all of it"""


class SlamConfig(Section):
    kernel: str = "graph"
    settings: dict[str, Any] = {}
    """of the kernel; validated by it at the edge's start"""


class EdgeConfig(Section):
    workers: Annotated[int, Field(ge=0, le=256)] = 0
    """SLAM worker processes; 0: one a core"""
    window: Annotated[int, Field(ge=1, le=4096)] = 64
    """frames a robot may be ahead of what is processed"""
    map_every_s: Annotated[float, Field(gt=0)] = 2.0
    """how often changed robot maps are published and fused"""
    scan_limit_s: Annotated[float, Field(gt=0)] = 20.0
    """a SLAM worker that spends longer on one scan is taken for stuck and replaced; waiting for a processor is free"""
    probe_every_s: Annotated[float, Field(ge=0)] = 30.0
    """how often an idle link to a robot in reach is measured, with 64 KB; 0: never"""
    lease_s: Annotated[float, Field(gt=0)] = 60.0
    """a robot that has been gone for longer is not waited for: its map is final as it is, until it comes back"""
    checkpoints: Path | None = None
    """folder on a disk that all edges share: edges keep SLAM instances there and robots forget the frames that are in
    them; None: kept in the edge's memory, and robots keep all frames that their spools hold"""
    checkpoint_s: Annotated[float, Field(gt=0)] = 60.0
    """an instance is kept every so many seconds"""
    checkpoint_frames: Annotated[int, Field(ge=1)] = 1000
    """or frames, whichever comes first"""


class FusionConfig(Section):
    settings: dict[str, Any] = {}
    """of the matcher; validated by it at start"""


class CloudConfig(Section):
    out: Path | None = None
    """folder into which the cloud exports each final map"""
    merge_every_s: Annotated[float, Field(gt=0)] = 2.0
    joint: bool = True
    """correct the trajectories of all robots together for the final map, where their maps are bent"""


class SchedulerConfig(Section):
    policy: str = "recslam"
    interval_s: Annotated[float, Field(gt=0)] = 3.0
    budget_s: Annotated[float, Field(gt=0)] = 0.5
    """time that a search may take"""
    hysteresis: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """a plan must promise to be better by this share"""
    kappa: Annotated[int, Field(ge=1)] = 100
    """iterations of Algorithm 2"""
    tau: Annotated[int, Field(ge=1)] = 10
    """length of its tabu list"""
    horizon_s: Annotated[float, Field(gt=0)] = 60.0
    """time over which the price of moving a robot's SLAM instance must pay off"""
    profile: Path | None = None
    """what `recslam profile` has measured; without it, built-in guesses that measurements soon replace"""


class SimSource(Section):
    kind: Literal["sim"] = "sim"
    scene: str
    route: str = ""
    """a route of the scene by name; empty: the one named like the robot, or a seeded random walk"""
    lidar: Literal["lds01", "rplidar_a1", "sick", "urg04lx", "utm30lx"] = "rplidar_a1"
    duration_s: Annotated[float, Field(gt=0)] | None = None
    """simulated seconds; None: until the route ends"""
    speed_mps: Annotated[float, Field(gt=0)] = 0.5
    turn_radps: Annotated[float, Field(gt=0)] = 0.8
    imu: bool = True
    wheels: bool = True
    noise: Literal["none", "good", "worn", "slippery", "hostile"] = "good"
    """how wrong wheels and gyro are"""


class CarmenSource(Section):
    kind: Literal["carmen"] = "carmen"
    path: Path
    part: Annotated[int, Field(ge=0)] = 0
    parts: Annotated[int, Field(ge=1)] = 1
    """the log is cut into this many equal stretches of time, and this robot drives the `part`-th"""
    hide_start: bool = True
    """move the odometry of a cut log into a random start frame of the robot's own"""


class RecordingSource(Section):
    kind: Literal["recording"] = "recording"
    path: Path
    """a spool file of an earlier run"""


Source = Annotated[SimSource | CarmenSource | RecordingSource, Field(discriminator="kind")]


class RobotEntry(Section):
    id: Name
    source: Source
    start: PoseTuple | None = None
    """pose in the world at the first frame, if it is to be told to the system"""
    edges: tuple[Name, ...] | None = None
    """edges within reach; absent: all"""
    join_after_s: Annotated[float, Field(ge=0)] = 0.0
    """wall seconds after the fleet's start"""


class EdgeEntry(Section):
    id: Name
    speed: Annotated[float, Field(gt=0)] = 1.0
    """computing power relative to the other edges, until measured"""
    bandwidth_mbps: Annotated[float, Field(gt=0)] = 1000.0
    """link to the cloud in Mbit/s, until measured"""


class Fleet(BaseSettings):
    """Everything a cluster is told."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX,
        env_nested_delimiter="__",
        extra="forbid",
        frozen=True,
        nested_model_default_partial_update=True,
    )

    name: str = "fleet"
    seed: int = 0
    topology: Literal["recslam", "cloud", "single-edge", "edge-only", "local"] = "recslam"
    bus: BusConfig = BusConfig()
    robot: RobotConfig = RobotConfig()
    slam: SlamConfig = SlamConfig()
    edge: EdgeConfig = EdgeConfig()
    fusion: FusionConfig = FusionConfig()
    cloud: CloudConfig = CloudConfig()
    scheduler: SchedulerConfig = SchedulerConfig()
    robots: tuple[RobotEntry, ...] = ()
    default_robot: SimSource | None = None
    """source of robots that no entry names (`--scale robot=6`)"""
    edges: tuple[EdgeEntry, ...] = ()
    batch: bool = False
    """the run ends when all robots named here have ended; nothing is final before they have all come"""

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return env_settings, init_settings

    @model_validator(mode="after")
    def names_are_unique(self) -> Fleet:
        for what, entries in (("robots", self.robots), ("edges", self.edges)):
            names = [entry.id for entry in entries]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{what}: {', '.join(twice)} named twice")
        return self

    def robot_entry(self, robot: str) -> RobotEntry:
        """The entry of this robot. Raises ConfigError when there is none and no default."""
        for entry in self.robots:
            if entry.id == robot:
                return entry
        if self.default_robot is None:
            known = ", ".join(entry.id for entry in self.robots) or "none"
            raise ConfigError(f"robots: no entry for {robot!r} (there are: {known}) and no default_robot")
        return RobotEntry(id=robot, source=self.default_robot)

    def expected_robots(self) -> tuple[str, ...]:
        """Robots without which a batch run is not complete."""
        return tuple(entry.id for entry in self.robots) if self.batch else ()

    def edge_ids(self) -> tuple[str, ...]:
        return tuple(entry.id for entry in self.edges)


def load(path: Path | None, **overrides: Any) -> Fleet:
    """The fleet described by a TOML file and the environment. Raises ConfigError naming file and field."""
    data: dict[str, Any] = {}
    if path is not None:
        try:
            data = tomllib.loads(path.read_text())
        except FileNotFoundError:
            raise ConfigError(f"{path}: no such file") from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ConfigError(f"{path}: {error}") from error
    check_environment()
    try:
        return Fleet(**{**data, **overrides})
    except ValidationError as error:
        found = explain(error).removeprefix("message: Value error, ")  # of the whole fleet: our own words
        raise ConfigError(f"{path or 'configuration'}: {found}") from error
    except SettingsError as error:  # a section or list as a whole, and no JSON
        raise ConfigError(f"environment: {error}; name a field, as {ENV_PREFIX}SLAM__KERNEL=gmapping") from error


def check_environment() -> None:
    """Raises ConfigError for a RECSLAM_* name that is no field: a typing error must not pass in silence."""
    fields = {name.upper() for name in Fleet.model_fields}
    for name in os.environ:
        if name.startswith(ENV_PREFIX) and name not in ENV_ELSEWHERE:
            section = name.removeprefix(ENV_PREFIX).split("__")[0].upper()
            if section not in fields:
                raise ConfigError(f"environment variable {name}: there is no section {section.lower()!r}")


def dump(fleet: Fleet) -> dict[str, Any]:
    """The effective configuration as plain data, to be kept beside results."""
    return fleet.model_dump(mode="json")
