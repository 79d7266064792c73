"""A `gmapping` kernel goes on from its snapshot as if nothing had been, and takes no other."""

from __future__ import annotations

import numpy as np
import pytest
from gmapping_cases import FEW, drive, run

from common.errors import SnapshotRefused
from services.edge_worker.slam.gmapping.gmapping import GMapping
from services.edge_worker.slam.gmapping.snapshot import FORMAT, HEAD_BYTES, MAGIC


@pytest.mark.parametrize("lag_scans", [12, 3000])
def test_a_restored_kernel_continues_bit_for_bit(lag_scans: int) -> None:
    frames = drive(90)
    straight = run(frames[:45], lag_scans=lag_scans)
    straight.map()
    kernel = GMapping.create({**FEW, "lag_scans": lag_scans}, 77)
    grid = kernel.map()
    kernel.restore(straight.snapshot())
    assert kernel.snapshot() == straight.snapshot()
    for frame in frames[45:]:
        a, b = straight.process(frame), kernel.process(frame)
        assert np.array_equal(a.pose, b.pose)
    assert kernel.map() is grid
    assert straight.map().digest() == kernel.map().digest()
    assert straight.map().changed == kernel.map().changed
    assert np.array_equal(straight.trajectory(), kernel.trajectory())
    assert kernel.snapshot() == straight.snapshot()


def test_a_restored_map_shows_what_was_shown_also_where_scans_were_not_published_yet() -> None:
    frames = drive(60)
    straight = run(frames[:45])
    straight.map()
    for frame in frames[45:]:
        straight.process(frame)
    kernel = GMapping.create(FEW, 1)
    kernel.restore(straight.snapshot())
    assert kernel.chart.grid.digest() == straight.chart.grid.digest()
    assert kernel.map().digest() == straight.map().digest()


def test_restored_at_twenty_points_the_final_map_is_the_same_bit_for_bit() -> None:
    frames = drive(100)
    straight = GMapping.create(FEW, 1)
    points = np.sort(np.random.default_rng(5).choice(100, 20, replace=False))
    kept = {}
    for k, frame in enumerate(frames):
        if k in points:
            kept[k] = straight.snapshot()
        straight.process(frame)
    digest, rows = straight.map().digest(), straight.trajectory()
    for k, data in kept.items():
        kernel = GMapping.create(FEW, 0)
        kernel.restore(data)
        for frame in frames[k:]:
            kernel.process(frame)
        assert kernel.map().digest() == digest
        assert np.array_equal(kernel.trajectory(), rows)


def test_a_snapshot_grows_by_the_trajectories_of_particles_not_by_their_maps() -> None:
    frames = drive(60)
    few, many = run(frames, particles=6), run(frames, particles=24)
    assert many.maps.held > 3 * few.maps.held
    assert len(many.snapshot()) < 1.3 * len(few.snapshot())


def test_what_the_tree_has_settled_is_in_the_settled_map_and_nothing_else() -> None:
    kernel = run(drive(90), lag_scans=12)
    fixed = len(kernel.tree.settled)
    points = sum(len(generation.points) for generation in kernel.tree.branches)
    assert fixed > 12
    assert len(kernel.snapshot()) < len(run(drive(90)).snapshot())
    # a cell takes no more hits once its centroid stands
    per_particle = kernel.maps.pool.hits[kernel.maps.table].sum(axis=(1, 2, 3), dtype=int)
    assert (per_particle - kernel.settled.pool.hits[kernel.settled.table].sum(dtype=int) <= points).all()


def test_a_foreign_corrupt_older_newer_or_otherwise_set_snapshot_is_refused_by_name() -> None:
    kernel = run(drive(10))
    data, digest = kernel.snapshot(), kernel.map().digest()
    newer = MAGIC + (FORMAT + 1).to_bytes(2, "little") + data[len(MAGIC) + 2 :]
    older = MAGIC + (FORMAT - 1).to_bytes(2, "little") + data[len(MAGIC) + 2 :]
    flipped = bytearray(data)
    flipped[HEAD_BYTES + 50] ^= 1
    for bad, what in (
        (b"graph" + data, "no snapshot"),
        (newer, "newer"),
        (older, f"format {FORMAT - 1} is older than {FORMAT}"),
        (bytes(flipped), "corrupt"),
        (data[:-1], "corrupt"),
    ):
        with pytest.raises(SnapshotRefused, match=f"gmapping.*{what}"):
            kernel.restore(bad)
    with pytest.raises(SnapshotRefused, match="particles"):
        GMapping.create({"particles": 7}, 1).restore(data)
    assert kernel.map().digest() == digest
