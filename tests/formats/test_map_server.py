"""map_server maps: what is written reads back, and what others wrote reads as Nav2 reads it."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from common.errors import BadFile, UsageError
from common.formats.map_server import pixels_of, read_map, write_map

DATA = os.environ.get("RECSLAM_DATA")
META = "image: m.pgm\nresolution: 0.1\norigin: [1.0, 2.0, 0.5]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
finite = st.floats(-1e6, 1e6)


def saved(folder: Path, pixels, meta: str = META, name: str = "m.pgm") -> Path:
    image = np.asarray(pixels, np.uint8)
    (folder / name).write_bytes(cv2.imencode(Path(name).suffix, image)[1].tobytes())
    (folder / "m.yaml").write_text(meta.replace("m.pgm", name))
    return folder / "m.yaml"


@given(
    arrays(np.int8, array_shapes(min_dims=2, max_dims=2, max_side=20), elements=st.sampled_from([-1, 0, 100])),
    st.floats(1e-3, 10),
    st.tuples(finite, finite, finite),
)
def test_a_map_comes_back_as_it_was_written(tmp_path_factory, cells, resolution, origin):
    path = write_map(tmp_path_factory.mktemp("maps") / "new" / "a.b", cells, resolution, origin)
    read = read_map(path)
    np.testing.assert_array_equal(read.occupancy, cells)
    assert read.resolution == resolution
    assert read.origin == origin


def test_the_image_is_what_nav2_writes(tmp_path):
    cells = np.array([[-1, 0, 100], [25, 26, 65]], np.int8)
    assert pixels_of(cells).tolist() == [[254, 205, 0], [205, 254, 0]]
    write_map(tmp_path / "a.yaml", cells, 0.05)
    assert (tmp_path / "a.pgm").read_bytes() == b"P5\n3 2\n255\n" + bytes([254, 205, 0, 205, 254, 0])
    assert cv2.imread(str(tmp_path / "a.pgm"), cv2.IMREAD_UNCHANGED).tolist() == [[254, 205, 0], [205, 254, 0]]
    assert "free_thresh: 0.196" in (tmp_path / "a.yaml").read_text()


def test_row_zero_is_the_lowest_y(tmp_path):
    read = read_map(saved(tmp_path, [[0, 0], [254, 205]]))
    assert read.occupancy.tolist() == [[0, -1], [100, 100]]
    assert read.origin == (1.0, 2.0, 0.5)


def test_trinary_thresholds_are_taken_inclusively(tmp_path):
    meta = META.replace("0.65", "0.6").replace("0.196", "0.2")
    read = read_map(saved(tmp_path, [[102, 103, 204, 203]], meta))
    assert read.occupancy.tolist() == [[100, -1, 0, -1]]


def test_negate_turns_brightness_round(tmp_path):
    read = read_map(saved(tmp_path, [[255, 0]], META.replace("negate: 0", "negate: true")))
    assert read.occupancy.tolist() == [[100, 0]]


def test_scale_grades_between_the_thresholds_and_transparent_is_unknown(tmp_path):
    meta = META.replace("0.65", "0.9").replace("0.196", "0.1") + "mode: scale\n"
    assert read_map(saved(tmp_path, [[0, 255, 128, 77]], meta)).occupancy.tolist() == [[100, 0, 50, 75]]
    clear = [[[0, 0, 0, 255], [0, 0, 0, 254], [255, 255, 255, 0]]]
    assert read_map(saved(tmp_path, clear, meta, "m.png")).occupancy.tolist() == [[100, -1, -1]]


def test_raw_is_taken_as_it_is(tmp_path):
    meta = META.replace("negate: 0", "negate: 1") + "mode: raw\n"
    assert read_map(saved(tmp_path, [[0, 7, 100, 101, 255]], meta)).occupancy.tolist() == [[0, 7, 100, -1, -1]]


def test_colours_are_averaged(tmp_path):
    assert read_map(saved(tmp_path, [[[0, 0, 90], [255, 255, 240]]], name="m.png")).occupancy.tolist() == [[100, 0]]


def test_comments_deep_pixels_and_gzip_are_understood(tmp_path):
    image = b"P5 # made\n# by hand\n2# wide\n1\n65535\n" + bytes([0xFF, 0xFF, 0, 0])
    (tmp_path / "m.pgm.gz").write_bytes(gzip.compress(image))
    meta = '# a map\nimage: "m.pgm" # gzipped since\nresolution: 5e-2\norigin:\n- -1\n- 2.5\n- 0\n'
    (tmp_path / "m.yaml").write_text(meta + "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\nmap_type: 2\n")
    read = read_map(tmp_path / "m.yaml")
    assert read.occupancy.tolist() == [[0, 100]]
    assert (read.resolution, read.origin) == (0.05, (-1.0, 2.5, 0.0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("resolution: 0.1\n", ""), "lacks resolution"),
        (("0.1", "fine"), "resolution is 'fine'"),
        (("0.1", "-0.1"), "must be positive"),
        (("[1.0, 2.0, 0.5]", "[1.0, 2.0]"), "takes 3 finite numbers"),
        (("0.65", "0.1"), "must be below"),
        (("negate: 0", "negate: maybe"), "write 0 or 1"),
        (("negate: 0", "negate: 0\nmode: cubic"), "none of trinary, scale, raw"),
        (("negate: 0", "negate 0"), r"m\.yaml:4"),
        (("m.pgm", "gone.pgm"), r"gone\.pgm"),
    ],
)
def test_what_is_wrong_with_a_map_is_said(tmp_path, change, says):
    path = saved(tmp_path, [[0]])
    path.write_text(META.replace(*change))
    with pytest.raises(BadFile, match=says):
        read_map(path)


@pytest.mark.parametrize(("name", "reason"), [("m" * 5000, "is no file name"), ("m\0.pgm", "cannot be read")])
def test_a_name_that_no_image_can_have_is_refused(tmp_path, name, reason):
    (tmp_path / "m.yaml").write_text(META.replace("m.pgm", name))
    with pytest.raises(BadFile, match=reason):
        read_map(tmp_path / "m.yaml")


@pytest.mark.parametrize("image", [b"", b"P5 4 4 255 abc", b"P5 x", b"P5 1 1 0 a", b"P5 999999 999999 255 a", b"GIF?"])
def test_a_broken_image_is_refused_by_name(tmp_path, image):
    path = saved(tmp_path, [[0]])
    (tmp_path / "m.pgm").write_bytes(image)
    with pytest.raises(BadFile, match=r"m\.pgm"):
        read_map(path)


def test_what_is_no_map_is_not_written(tmp_path):
    with pytest.raises(UsageError, match="height and a width"):
        write_map(tmp_path / "a", np.zeros((0, 3), np.int8), 0.05)
    with pytest.raises(UsageError, match="finite"):
        write_map(tmp_path / "a", np.zeros((1, 3), np.int8), 0.05, (0, float("nan"), 0))


@pytest.mark.skipif(not DATA, reason="RECSLAM_DATA does not name a folder of real maps")
def test_a_real_map_and_its_part_agree_where_they_overlap():
    whole, part = (read_map(Path(DATA) / "maps" / "utexas_gdc" / f"{name}.yaml") for name in ("1", "1n"))
    assert whole.occupancy.shape == (1255, 1857)
    assert whole.resolution == part.resolution == 0.05
    # The part is the whole from its row 680 and column 2 of the image on.
    theirs, ours = part.occupancy[::-1][:, :-2], whole.occupancy[::-1][680 : 680 + len(part.occupancy), 2:]

    known = (theirs >= 0) & (ours >= 0)
    assert (theirs[known] == ours[known]).mean() > 0.9999
