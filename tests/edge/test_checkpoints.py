"""Checkpoints appear whole or not at all, and what cannot be read is told and passed."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import msgpack
import pytest
from edge_samples import OTHER, STREAM

from common.errors import ConfigError
from services.edge_worker.checkpoint import Checkpoint
from services.edge_worker.checkpoints import Checkpoints, InMemory, Kept, OnDisk


def kept(seq: int, stream: str = STREAM) -> Kept:
    return Kept(Checkpoint(stream, seq, gaps=seq % 3, skipped=1), b"kernel behind %d" % seq)


@pytest.fixture(params=["memory", "disk"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Checkpoints:
    return InMemory() if request.param == "memory" else OnDisk(tmp_path)


async def test_the_newest_of_a_stream_comes_first(store: Checkpoints) -> None:
    for seq in (9, 20, 101):
        await store.keep("r1", kept(seq))
    found, wrong = await store.newest("r1", STREAM)
    assert (found[0], wrong) == (kept(101), [])


async def test_of_another_stream_or_robot_there_is_none(store: Checkpoints) -> None:
    await store.keep("r1", kept(9))
    assert await store.newest("r1", OTHER) == ([], [])
    assert await store.newest("r2", "") == ([], [])


async def test_where_no_stream_is_known_the_one_kept_last_is_found(store: Checkpoints) -> None:
    await store.keep("r1", kept(900))
    await asyncio.sleep(0.02)  # file times are coarse
    await store.keep("r1", kept(9, OTHER))
    assert (await store.newest("r1", ""))[0][0] == kept(9, OTHER)


async def test_the_one_before_the_newest_stays_and_older_ones_go(tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    for seq in (9, 100, 20, 101):
        await store.keep("r1", kept(seq))
    assert (await store.newest("r1", STREAM))[0] == [kept(101), kept(100)]
    assert len(list((tmp_path / "r1").iterdir())) == 2


@pytest.mark.parametrize("damage", [b"", b"\x92\x80\xc4\x00", b"\xc1" * 40])
async def test_a_damaged_checkpoint_is_told_and_the_one_before_is_taken(damage: bytes, tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    for seq in (1, 2):
        await store.keep("r1", kept(seq))
    newest = tmp_path / "r1" / f"{STREAM}-2.checkpoint"
    newest.write_bytes(damage or newest.read_bytes()[:-1] + b"x")
    found, (problem,) = await store.newest("r1", STREAM)
    assert found == [kept(1)]
    assert str(newest) in problem


async def test_what_has_just_been_kept_stays_when_those_of_more_frames_are_of_another_kernel(tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    for seq in (1000, 2000, 700, 1400):  # the first two are refused by the kernel that makes the others
        await store.keep("r1", kept(seq))
        assert kept(seq) in (await store.newest("r1", STREAM))[0]


@pytest.mark.parametrize("field", ["seq", "gaps", "skipped", "stream"])
async def test_a_checkpoint_that_lies_about_how_far_it_had_come_is_damaged(field: str, tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    await store.keep("r1", kept(2))
    path = tmp_path / "r1" / f"{STREAM}-2.checkpoint"
    header, snapshot = msgpack.unpackb(path.read_bytes())
    path.write_bytes(msgpack.packb([header | {field: {}}, snapshot]))
    found, (problem,) = await store.newest("r1", STREAM)
    assert found == []
    assert "damaged" in problem


async def test_a_checkpoint_that_cannot_be_opened_is_told_and_others_are_taken(tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    await store.keep("r1", kept(1))
    loop = tmp_path / "r1" / f"{OTHER}-9.checkpoint"
    loop.symlink_to(loop)
    assert await store.newest("r1", "") == ([kept(1)], [])
    found, (problem,) = await store.newest("r1", OTHER)
    assert found == []
    assert str(loop) in problem


async def test_two_edges_that_keep_the_same_frame_at_once_are_not_in_each_others_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other, sync = OnDisk(tmp_path), OnDisk(tmp_path), os.fsync

    def meanwhile(file: int) -> None:
        monkeypatch.setattr(os, "fsync", sync)
        other._write("r1", kept(1))
        sync(file)

    monkeypatch.setattr(os, "fsync", meanwhile)
    await one.keep("r1", kept(1))
    assert await one.newest("r1", STREAM) == ([kept(1)], [])
    assert len(list((tmp_path / "r1").iterdir())) == 1


async def test_what_could_not_be_read_again_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.edge_worker.checkpoints.MOST_BYTES", 5)
    with pytest.raises(OSError, match="over the limit of 5"):
        await OnDisk(tmp_path).keep("r1", kept(1))


async def test_what_a_dead_edge_had_half_written_is_no_checkpoint(tmp_path: Path) -> None:
    store = OnDisk(tmp_path)
    await store.keep("r1", kept(1))
    (tmp_path / "r1" / f"{STREAM}-7.part-12").write_bytes(b"half")
    assert await store.newest("r1", "") == ([kept(1)], [])


async def test_a_disk_that_takes_nothing_is_an_error_and_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "r1").write_text("a file where the folder should be")
    with pytest.raises(OSError, match="r1"):
        await OnDisk(tmp_path).keep("r1", kept(1))
    assert await OnDisk(tmp_path).newest("r1", STREAM) == ([], [])


def test_a_folder_that_cannot_be_made_is_refused_by_the_name_of_its_field(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"edge\.checkpoints: .*file"):
        OnDisk(tmp_path / "file" / "checkpoints")
