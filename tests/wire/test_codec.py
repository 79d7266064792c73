from __future__ import annotations

import resource
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from message_samples import SAMPLES, STREAM
from message_strategies import messages
from pydantic import BaseModel, ValidationError

from common.errors import BadMessage
from common.wire import Frame, FramePage, Message, Refusal, Verdicts, decode, encode
from common.wire.arrays import EXT_ARRAY, pack_array, unpack_array
from common.wire.codec import KINDS, plain
from common.wire.limits import MAX_BEAMS, MAX_ITEMS, MAX_MESSAGE_BYTES, MAX_SAMPLES, MAX_TEXT_BYTES, VERSION

relaxed = settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow])


def same(a: Any, b: Any) -> bool:
    """Equal, also where numpy arrays are inside and where numbers are NaN."""
    if isinstance(a, BaseModel):
        return type(a) is type(b) and same(a.__dict__, b.__dict__)
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and bool(a == b)


def packed(kind: str, fields: Any, version: Any = VERSION) -> bytes:
    return bytes(msgpack.packb([version, kind, fields]))


@relaxed
@given(messages())
def test_what_is_decoded_is_what_was_encoded(message: Message) -> None:
    assert same(decode(encode(message)), message)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_has_a_sample_that_survives_the_wire(kind: str) -> None:
    assert same(decode(encode(SAMPLES[kind])), SAMPLES[kind])


@relaxed
@given(st.binary(max_size=400))
def test_any_bytes_are_a_message_or_a_bad_message(data: bytes) -> None:
    check_contained(data)


@relaxed
@given(st.sampled_from(sorted(SAMPLES)), st.data())
def test_a_damaged_message_is_a_message_or_a_bad_message(kind: str, draw: st.DataObject) -> None:
    data = bytearray(encode(SAMPLES[kind]))
    for _ in range(draw.draw(st.integers(1, 4))):
        bit = draw.draw(st.integers(0, 8 * len(data) - 1))
        data[bit // 8] ^= 1 << bit % 8
    cut = draw.draw(st.integers(0, len(data)))
    check_contained(bytes(data))
    check_contained(bytes(data[:cut]))


json_like = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=8) | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=10,
)


@relaxed
@given(st.sampled_from(sorted(KINDS)), st.data())
def test_a_field_of_any_other_type_is_a_bad_message(kind: str, draw: st.DataObject) -> None:
    fields = {name: plain(field) for name, field in SAMPLES[kind].__dict__.items()}
    fields[draw.draw(st.sampled_from(sorted(fields)))] = draw.draw(json_like)
    check_contained(bytes(msgpack.packb([VERSION, kind, fields], default=pack_array)))


def check_contained(data: bytes) -> None:
    """Either a message that can be sent on, or a BadMessage that names the sender."""
    try:
        message = decode(data, "robot/bad")
    except BadMessage as error:
        named = error.sender == "robot/bad" and str(error).startswith("robot/bad: ")
        if not named:
            raise AssertionError(f"the sender is not named in {error}") from error
    else:
        encode(message)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "not msgpack"),
        (packed("Refusal", {"reason": "x"}) + b"\x00", "extra data"),
        (packed("Refusal", {"reason": "x"}, 2), "wire version 2"),
        (packed("Refusal", {"reason": "x"}, "1"), "wire version '1'"),
        (packed("Refusal", {"reason": "x"}, True), "wire version True"),
        (packed("Hello", {}), "unknown kind 'Hello'"),
        (packed("Message", {}), "unknown kind"),
        (packed("K" * 60_000, {}), "unknown kind 'KKKKKKKKKKKK...KKKKKKKKKKKKK'"),
        (packed("Refusal", {}, "1" * 60_000), "wire version '111111111111...1111111111111'"),
        (msgpack.packb([VERSION, ["x"], {}]), "unknown kind"),
        (msgpack.packb([VERSION, "Refusal"]), "triple"),
        (msgpack.packb({"version": 1}), "triple"),
        (packed("Refusal", {}), "reason: Field required"),
        (packed("Refusal", {"reason": "x", "more": 1}), "more: Extra inputs"),
        (packed("Refusal", {"reason": 3}), "reason: Input should be a valid string"),
        (packed("Refusal", ["x"]), "Refusal"),
        (packed("EndOfStream", {"robot": "a/b", "stream": STREAM, "last_seq": 1}), "robot: "),
        (packed("EndOfStream", {"robot": "r1\n", "stream": STREAM, "last_seq": 1}), "robot: "),
        (packed("EndOfStream", {"robot": "r1", "stream": "x", "last_seq": 1}), "stream: "),
        (packed("Refusal", {1: "x"}), "not msgpack"),
        (msgpack.packb([VERSION, "Refusal", {"reason": msgpack.ExtType(9, b"x")}]), "unknown extension"),
        (msgpack.packb([VERSION, "Refusal", {"reason": msgpack.ExtType(EXT_ARRAY, b"x")}]), "array header"),
        (msgpack.packb([VERSION, "Refusal", {"reason": msgpack.Timestamp(1)}]), "Refusal"),
    ],
)
def test_a_bad_message_says_what_is_wrong_with_it(data: bytes, word: str) -> None:
    with pytest.raises(BadMessage, match="robot/bad: ") as caught:
        decode(data, "robot/bad")
    assert word in str(caught.value)
    assert "pydantic" not in str(caught.value)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), "one", None, [1.0]])
def test_numbers_are_finite_numbers(bad: Any) -> None:
    fields = {"robot": "r1", "edge": "e1", "seq": 1, "stamp": bad, "pose": [0.0, 0.0, 0.0]}
    with pytest.raises(BadMessage, match="stamp"):
        decode(packed("PoseUpdate", fields))


def test_what_is_over_a_limit_is_refused() -> None:
    with pytest.raises(BadMessage, match="over the limit"):
        decode(bytes(MAX_MESSAGE_BYTES + 1))
    with pytest.raises(BadMessage, match="send it in pages"):
        encode(FramePage(robot="r1", stream=STREAM, frames=(bytes(MAX_MESSAGE_BYTES),), oldest=0))
    with pytest.raises(BadMessage, match="exceeds"):
        decode(packed("Refusal", {"reason": "x" * (MAX_TEXT_BYTES + 1)}))
    with pytest.raises(BadMessage, match="exceeds"):
        decode(packed("Verdicts", {"owner": "x", "pairs": [1] * (MAX_ITEMS + 1)}))


@pytest.mark.parametrize(
    ("field", "array"), [("ranges", np.zeros(MAX_BEAMS + 1, np.uint16)), ("imu", np.zeros((MAX_SAMPLES + 1, 4)))]
)
def test_frames_keep_their_limits(field: str, array: np.ndarray) -> None:
    fields = plain(SAMPLES["Frame"])
    (fields["scan"] if field == "ranges" else fields)[field] = array
    with pytest.raises(BadMessage, match="more than the limit"):
        decode(bytes(msgpack.packb([VERSION, "Frame", fields], default=pack_array)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stamp", 1.7e18),
        ("angle_min", -180.0),
        ("angle_increment", 1e300),
        ("range_max", 1e9),
        ("time_increment", 1e3),
        ("mount", [250.0, 0.0, 0.0]),
        ("mount", [0.0, 0.0, 180.0]),
    ],
)
def test_numbers_in_a_wrong_unit_or_of_no_laser_are_refused_by_the_name_of_the_field(field: str, value: Any) -> None:
    fields = plain(SAMPLES["Frame"])
    (fields if field == "stamp" else fields["scan"])[field] = value
    with pytest.raises(BadMessage, match=rf"robot/r1/frames: .*{field}"):
        decode(bytes(msgpack.packb([VERSION, "Frame", fields], default=pack_array)), "robot/r1/frames")


@pytest.mark.parametrize(
    "data",
    [
        b"\xdd\x00\x01\x00\x00" * 2000,
        b"\xdf\x00\x01\x00\x00" * 2000,
        b"\x91" * 100_000,
        b"\xdd\xff\xff\xff\xff",
        b"\xdc\xff\xff" * 1000 + b"\xc0" * 66_000,
        b"\xc9\xff\xff\xff\xff\x01",
        b"\xc6\xff\xff\xff\xff",
        msgpack.packb(msgpack.ExtType(EXT_ARRAY, b"f8\x01\xff\xff\xff\xff")),
        msgpack.packb(msgpack.ExtType(EXT_ARRAY, b"f8\x03" + b"\xff\xff\xff\xff" * 3)),
    ],
)
def test_a_few_bytes_cannot_claim_much_memory(data: bytes) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadMessage):
        decode(data)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024  # KiB really touched


def test_a_message_full_of_faults_costs_no_more_than_one_that_is_sound() -> None:
    names = ["!"] * 60_000
    component = {"id": "x", "robots": names, "transforms": dict.fromkeys(map(str, range(60_000)))}
    fields = {**plain(SAMPLES["EdgeMapNotice"]), "components": [component] * 10, "x" * 60_000: 1}
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadMessage, match=r"^robot/bad: EdgeMapNotice: components\.0\.robots\.0: ") as caught:
        decode(packed("EdgeMapNotice", fields), "robot/bad")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 128 * 1024  # KiB
    assert len(str(caught.value)) < 1000


def test_of_many_faults_the_first_are_told_and_the_others_counted() -> None:
    fields = {**plain(SAMPLES["Refusal"]), **dict.fromkeys(map(str, range(60_000)))}
    with pytest.raises(BadMessage, match=r"; and 59992 more$") as caught:
        decode(packed("Refusal", fields))
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    "message",
    [
        Refusal.model_construct(reason=2**70),
        Refusal.model_construct(reason="\ud800"),
        Refusal.model_construct(reason=object()),
        Refusal.model_construct(reason=np.zeros(2, np.complex128)),
        SAMPLES["Claims"].model_copy(update={"claims": {"r1": (1, 2**64)}}),
    ],
)
def test_what_cannot_travel_is_a_bad_message_at_its_sender(message: Message) -> None:
    with pytest.raises(BadMessage, match=type(message).__name__):
        encode(message)


def test_only_kinds_of_the_union_travel() -> None:
    class Homemade(Message):
        pass

    with pytest.raises(BadMessage, match="Homemade is not a message that travels"):
        encode(Homemade())


def test_messages_are_frozen_and_their_arrays_read_only() -> None:
    frame = decode(encode(SAMPLES["Frame"]))
    assert isinstance(frame, Frame)
    assert frame.odometry is not None
    with pytest.raises(ValidationError):
        frame.seq = 1
    with pytest.raises(ValueError, match="read-only"):
        frame.odometry[0, 0] = 1.0


@pytest.mark.parametrize("array", [np.zeros((0, 4)), np.arange(6, dtype=np.int32).reshape(1, 2, 3), np.array([1.5])])
def test_arrays_keep_dtype_and_shape(array: np.ndarray) -> None:
    back = unpack_array(pack_array(array).data)
    assert same(back, array)
    strided = np.arange(10.0)[::2]
    assert same(unpack_array(pack_array(strided).data), np.ascontiguousarray(strided))


def test_numpy_scalars_travel_as_numbers() -> None:
    message = Verdicts.model_construct(owner=np.str_("x"), pairs=())
    assert decode(encode(message)) == Verdicts(owner="x", pairs=())
