"""Finds out why a cluster does not work: router, round trip, versions, clocks, who is alive, who publishes what."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass

from common.bus import Bus, keys
from common.errors import PeerError
from common.wire import Message, Refusal, RobotStatus, Routes
from services.command import collect
from services.command.finding import Place
from services.command.report import machine, versions

LISTEN_S = 2.5
"""two statuses of every service, which sends one a second"""
OURS = f"doctor-{os.getpid()}"
"""name of a robot that only the round trip knows"""
CLOCK_S = 1.0
"""clocks that differ by more are worth the operator's attention"""

LATCHED = (
    keys.robot_profile(keys.ANY),
    keys.robot_status(keys.ANY),
    keys.robot_end(keys.ANY),
    keys.edge_status(keys.ANY),
    keys.edge_claims(keys.ANY),
    keys.edge_verdicts(keys.ANY),
    keys.edge_map(keys.ANY),
    keys.edge_ack(keys.ANY, keys.ANY),
    keys.edge_robot_map(keys.ANY, keys.ANY),
    keys.CLOUD_STATUS,
    keys.CLOUD_MAP,
    keys.CLOUD_TRANSFORMS,
    keys.CLOUD_VERDICTS,
    keys.SCHEDULER_STATUS,
    keys.SCHEDULER_ROUTES,
    keys.SCHEDULER_PLAN,
    keys.SCHEDULER_OVERLAP,
)


@dataclass(frozen=True)
class Finding:
    ok: bool
    what: str
    text: str


async def examine(place: Place) -> AsyncIterator[Finding]:
    """One finding after the other. Raises RouterUnreachable, naming the endpoint, when there is no router."""
    software = ", ".join(f"{name} {value}" for name, value in versions().items())
    yield Finding(True, "here", f"{software}; {', '.join(str(value) for value in machine().values())} cores")
    started = time.monotonic()
    async with await place.open() as bus:
        took = (time.monotonic() - started) * 1000
        yield Finding(True, "router", f"{place.endpoint} answers after {took:.0f} ms (found by {place.found})")
        yield await _round_trip(bus)
        alive, clocks = await asyncio.gather(_alive(bus), _clocks(bus))
        yield Finding(bool(alive), "alive", ", ".join(sorted(alive)) or "nobody: start services, or check bus.root")
        for tier in ("scheduler", "cloud"):
            if alive and tier not in alive:
                yield Finding(False, tier, f"is not there: `recslam {tier}` starts it")
        if clocks:
            yield _compared(clocks)
        async for finding in _published(bus):
            yield finding
        for problem in bus.problems:
            yield Finding(False, "refused", problem)


async def _round_trip(bus: Bus) -> Finding:
    """A message of our own there and back: what access control denies is silent to its client."""
    key = keys.robot_status(OURS)

    async def answer(asked: str, params: Mapping[str, str]) -> Message:
        return Refusal(reason="round trip")

    await bus.serve(key, answer)
    started = time.monotonic()
    try:
        answers = await bus.get(key, {"from": "doctor"}, timeout_s=2.0)
    except PeerError as error:
        return Finding(False, "round trip", str(error))
    took = (time.monotonic() - started) * 1000
    return Finding(bool(answers), "round trip", f"{took:.1f} ms" if answers else "no answer: is it denied to us?")


async def _alive(bus: Bus) -> set[str]:
    """`scheduler`, `cloud`, `edge/edge-1`, `robot/r1`: whose liveliness tokens there are."""
    found: set[str] = set()

    async def listen() -> None:
        async for token in bus.watch_alive("**/alive"):
            name = token.key.removesuffix("/alive")
            (found.add if token.alive else found.discard)(name)

    listening = asyncio.create_task(listen(), name="listen for tokens")
    await asyncio.sleep(LISTEN_S)
    listening.cancel()
    return found


async def _clocks(bus: Bus) -> dict[str, float]:
    """Seconds by which each sender's clock is behind ours, by the status that came here fastest."""
    behind: dict[str, float] = {}

    async def listen() -> None:
        async for received in bus.subscribe("**/status"):
            if received.sent_s:
                name = received.key.removesuffix("/status")
                behind[name] = min(time.time() - received.sent_s, behind.get(name, float("inf")))

    listening = asyncio.create_task(listen(), name="listen for statuses")
    await asyncio.sleep(LISTEN_S)
    listening.cancel()
    return behind


def _compared(behind: Mapping[str, float]) -> Finding:
    farthest = max(behind, key=lambda name: abs(behind[name]))
    seconds = behind[farthest]
    way = "behind" if seconds > 0 else "ahead of"
    text = f"{len(behind)} compared; farthest is {farthest}, {abs(seconds) * 1000:.0f} ms {way} ours, transfer included"
    return Finding(abs(seconds) < CLOCK_S, "clocks", text)


async def _published(bus: Bus) -> AsyncIterator[Finding]:
    robots = await collect.several(bus, keys.robot_status(keys.ANY), RobotStatus)
    routes = await collect.one(bus, keys.SCHEDULER_ROUTES, Routes)
    for robot in robots:
        if routes is not None and robot.robot not in routes.routes:
            yield Finding(False, f"robot/{robot.robot}", "has no route: no edge within reach is alive?")
        if robot.dropped:
            yield Finding(False, f"robot/{robot.robot}", f"lost {robot.dropped} frames to a full spool")
    for key in LATCHED:
        try:
            answers = await bus.get(key, timeout_s=2.0, everyone=True)
        except PeerError as error:
            yield Finding(False, key, str(error))
            continue
        for answer in sorted(answers, key=lambda answer: answer.key):
            if keys.robot_of(answer.key) == OURS:
                continue
            yield Finding(True, answer.key, f"{type(answer.message).__name__}, {answer.size} bytes")
