"""A scene is a world with the routes that robots take through it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.sim.motion import Pace, Style, drive
from common.sim.track import Track
from common.sim.world import Point, World

BUILT_IN = ("apartment", "symmetric", "asymmetric", "prototype", "two_rooms", "factory", "office")
"""modules in `common.sim.scenes`, each with a function `build() -> Scene`; `office:7` is the office of seed 7"""
SPARE_M = 2.0
"""m that a random walk is longer than needed, so that its end shows in no pose asked for"""
WALK_S = 180.0
"""s that a random walk takes when nobody says how long"""


@dataclass(frozen=True)
class Scene:
    name: str
    world: World
    start: Point
    """a place in the free space, from which random walks find theirs"""
    routes: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """waypoints (n, 2) in metres by route name"""
    style: Style = "turn_then_go"

    def waypoints(self, route: str) -> NDArray[np.float64]:
        """Waypoints (n, 2) in metres. Raises ConfigError naming the routes there are."""
        if route not in self.routes:
            raise ConfigError(f"scene {self.name}: no route {route!r}; there are: {', '.join(self.routes) or 'none'}")
        return self.routes[route]

    def track(self, robot: str, seed: int, pace: Pace, route: str = "", duration_s: float | None = None) -> Track:
        """The true motion of a robot, a function of (scene, seed, robot) and of how it is told to drive.

        It takes the route named, or else the one named like the robot, or else a random walk of its own. Another
        `duration_s` never changes where the robot is at a time: it only says how long a random walk must last.
        """
        if route or robot in self.routes:
            return drive(self.waypoints(route or robot), pace, self.style)
        from common.sim.wander import wander

        rng = generator(self.name, seed, robot, "walk")
        length = pace.speed_mps * (WALK_S if duration_s is None else duration_s) + SPARE_M
        return drive(wander(self.world, self.start, length, rng), pace, self.style)


def generator(*names: object) -> np.random.Generator:
    """A random generator that depends on these names alone, alike in every process."""
    return np.random.default_rng(list("\0".join(str(name) for name in names).encode()))


def load_scene(name: str) -> Scene:
    """A built-in scene by name (`office:7` with a seed), or a world from a map_server yaml file.

    Raises ConfigError for unknown names, BadFile for files that are no map.
    """
    base, _, seed = name.partition(":")
    if base in BUILT_IN and (not seed or (base == "office" and seed.isdecimal())):
        build = import_module(f"common.sim.scenes.{base}").build
        scene: Scene = build(int(seed)) if seed else build()
        return scene
    if name.endswith((".yaml", ".yml")):
        from common.sim.bitmap import load_map

        world, start = load_map(Path(name))
        return Scene(Path(name).stem, world, start)
    raise ConfigError(f"scene {name!r} is neither a map_server .yaml nor one of: {', '.join(BUILT_IN)}")
