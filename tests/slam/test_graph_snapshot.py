"""Snapshots of graph SLAM: a restored kernel goes on bit for bit, and what is no good snapshot is refused by name."""

from __future__ import annotations

import hashlib

import msgpack
import numpy as np
import pytest
from graph_cases import driven, run

from common.errors import SnapshotRefused
from services.edge_worker.slam.graph.graph_slam import GraphSlam

SETTINGS = {"max_keyframes": 90, "local_keyframes": 20}
HOW = {"duration_s": 80.0}


@pytest.fixture(scope="module")
def undisturbed() -> GraphSlam:
    kernel = run(driven(**HOW), **SETTINGS)
    kernel.finish()
    return kernel


@pytest.fixture(scope="module")
def snapshot() -> bytes:
    return run(driven(**HOW)[:100], **SETTINGS).snapshot()


@pytest.mark.parametrize("cut", [0, 1, *np.random.default_rng(3).integers(2, 440, 4).tolist()])
def test_a_restored_kernel_goes_on_bit_for_bit(undisturbed: GraphSlam, cut: int) -> None:
    frames = driven(**HOW)
    first = run(frames[:cut], **SETTINGS)
    first.map()
    second = GraphSlam.create(SETTINGS, 0)
    second.restore(first.snapshot())
    for frame in frames[cut:]:
        second.process(frame)
    second.finish()
    assert second.map().digest() == undisturbed.map().digest()
    assert np.array_equal(second.trajectory(), undisturbed.trajectory())


def test_a_laser_alone_goes_on_bit_for_bit_too() -> None:
    frames = driven(imu=False, wheels=False)
    whole, first, second = run(frames), run(frames[:70]), GraphSlam.create({}, 0)
    second.restore(first.snapshot())
    for frame in frames[70:]:
        second.process(frame)
    assert np.array_equal(second.trajectory(), whole.trajectory())


def test_taking_a_snapshot_changes_nothing_and_gives_the_same_bytes() -> None:
    kernel = run(driven(**HOW)[:60], **SETTINGS)
    before = kernel.trajectory()
    assert kernel.snapshot() == kernel.snapshot()
    assert np.array_equal(kernel.trajectory(), before)


def test_the_map_of_a_kernel_that_takes_over_keeps_rising(snapshot: bytes) -> None:
    first = run(driven(**HOW)[:100], **SETTINGS)
    first.map()
    version = first.map().version
    other = run(driven(scene="two_rooms")[:30], **SETTINGS)
    grid = other.map()
    other.restore(first.snapshot())
    assert other.map() is grid
    assert grid.version > version
    assert grid.digest() == first.map().digest()


def sealed(header: dict, body: bytes) -> bytes:
    return msgpack.packb([{**header, "sha256": hashlib.sha256(body).hexdigest()}, body])


def test_what_is_no_good_snapshot_is_refused_by_name_and_changes_nothing(snapshot: bytes) -> None:
    header, body = msgpack.unpackb(snapshot)
    flipped = bytearray(snapshot)
    flipped[len(flipped) // 2] ^= 1
    bad = {
        "no snapshot": b"hello",
        "kernel 'gmapping'": sealed({**header, "kernel": "gmapping"}, body),
        "newer": sealed({**header, "version": header["version"] + 1}, body),
        "older": sealed({**header, "version": header["version"] - 1}, body),
        "other settings": sealed({**header, "settings": "0" * 64}, body),
        "corrupt": bytes(flipped),
        "does not hold": sealed(header, b"no zstd"),
    }
    kernel = run(driven(**HOW)[:10], **SETTINGS)
    before = kernel.snapshot()
    for reason, data in bad.items():
        with pytest.raises(SnapshotRefused, match=reason):
            kernel.restore(data)
    for cut in (0, 1, len(snapshot) // 3, len(snapshot) - 1):
        with pytest.raises(SnapshotRefused):
            kernel.restore(snapshot[:cut])
    assert kernel.snapshot() == before
