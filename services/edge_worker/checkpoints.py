"""Where the kernels of SLAM instances are kept: in memory, or in a folder that all edges of the fleet share.

A file is msgpack of [header, snapshot] and appears whole or not at all. Kernels are deterministic, so it does not
matter which edge has made a checkpoint: any instance of the stream may go on from it.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import re
import secrets
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import msgpack

from common.errors import BadFile, ConfigError
from services.edge_worker.checkpoint import Checkpoint

FORMAT = 2
COPIES = 2
"""of a stream: the one before is of use when the newest is damaged"""
MOST_BYTES = 1 << 30
NAME = re.compile(r"(?P<stream>[0-9a-f]{32})-(?P<seq>[0-9]+)\.checkpoint")


class Kept(NamedTuple):
    checkpoint: Checkpoint
    snapshot: bytes


class Checkpoints(Protocol):
    """Keeps the newest of each robot."""

    durable: bool
    """what is kept outlives this edge"""

    async def keep(self, robot: str, kept: Kept) -> None:
        """Returns once it is there. Raises OSError."""
        ...

    async def newest(self, robot: str, stream: str) -> tuple[list[Kept], list[str]]:
        """What there is of the stream ("": of any), newest first, and what is wrong with what cannot be read.

        Raises OSError when nobody can tell what there is.
        """
        ...


class InMemory:
    """Outlives SLAM workers, not the edge."""

    durable = False

    def __init__(self) -> None:
        self._kept: dict[str, Kept] = {}

    async def keep(self, robot: str, kept: Kept) -> None:
        self._kept[robot] = kept

    async def newest(self, robot: str, stream: str) -> tuple[list[Kept], list[str]]:
        kept = self._kept.get(robot)
        return ([kept] if kept is not None and stream in ("", kept.checkpoint.stream) else []), []


class OnDisk:
    """`<folder>/<robot>/<stream>-<seq>.checkpoint`; what is there outlives everything but the disk.

    Raises ConfigError when the folder cannot be made.
    """

    durable = True

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"edge.checkpoints: {error}; name a folder that can be written") from error

    async def keep(self, robot: str, kept: Kept) -> None:
        await asyncio.to_thread(self._write, robot, kept)

    async def newest(self, robot: str, stream: str) -> tuple[list[Kept], list[str]]:
        return await asyncio.to_thread(self._read, robot, stream)

    def _write(self, robot: str, kept: Kept) -> None:
        folder, told = self._folder / robot, kept.checkpoint
        if len(kept.snapshot) > MOST_BYTES:
            raise OSError(errno.EFBIG, f"a snapshot of {len(kept.snapshot)} bytes is over the limit of {MOST_BYTES}")
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{told.stream}-{told.seq}.checkpoint"
        part = path.with_suffix(f".part-{secrets.token_hex(8)}")  # process ids of two edges may be the same
        try:
            with part.open("wb") as file:
                file.write(_packed(kept))
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        _sync(folder)
        for old in self._files(robot, told.stream)[COPIES:]:
            if old != path:  # those of more frames may be of another kernel, and refused
                old.unlink(missing_ok=True)

    def _read(self, robot: str, stream: str) -> tuple[list[Kept], list[str]]:
        found, wrong = [], []
        for path in self._files(robot, stream):
            try:
                found.append(_unpacked(path))
            except FileNotFoundError:
                continue  # a newer one has taken its place meanwhile
            except (OSError, BadFile) as error:
                wrong.append(str(error))
        return found, wrong

    def _files(self, robot: str, stream: str) -> list[Path]:
        """Of the stream, that with most frames first; without one, of the stream that was written to last."""
        folder = self._folder / robot
        try:
            names = os.listdir(folder)
        except (FileNotFoundError, NotADirectoryError):
            names = []
        named = [(folder / name, match) for name in names if (match := NAME.fullmatch(name))]
        if not stream:
            stream = max(((_written(path), match["stream"]) for path, match in named), default=(0.0, ""))[1]
        of_stream = [(int(match["seq"]), path) for path, match in named if match["stream"] == stream]
        return [path for _, path in sorted(of_stream, reverse=True)]


def _packed(kept: Kept) -> bytes:
    told = asdict(kept.checkpoint)
    checksum = _checksum(told, kept.snapshot)
    return bytes(msgpack.packb([{"format": FORMAT, "sha256": checksum, **told}, kept.snapshot]))


def _unpacked(path: Path) -> Kept:
    """Raises BadFile when it is no checkpoint of this program, or damaged."""
    try:
        header, snapshot = msgpack.unpackb(path.read_bytes(), max_bin_len=MOST_BYTES)
        if header["format"] != FORMAT:
            raise BadFile(f"{path}: format {header['format']!r}, this program reads {FORMAT}; upgrade the older side")
        told = {field.name: header[field.name] for field in fields(Checkpoint)}
        if _checksum(told, snapshot) != header["sha256"]:
            raise BadFile(f"{path}: damaged; the robot's map is made from an older one, or from its spool")
        return Kept(Checkpoint(**told), snapshot)
    except (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException) as error:
        raise BadFile(f"{path}: no checkpoint ({error!r}); the robot's map is made without it") from error


def _checksum(told: dict[str, Any], snapshot: bytes) -> str:
    """Over all that an instance goes on from: how far it had come as well as its kernel."""
    sha = hashlib.sha256(msgpack.packb(told))
    sha.update(snapshot)
    return sha.hexdigest()


def _written(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # reading it tells what is wrong, if it is still there
        return 0.0


def _sync(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
