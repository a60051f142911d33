import json
import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import WireError
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.wire import Fields, NumberError, encode_line
from mrnav_server.core.wire_hand import (
    ClientFrame,
    HandMessage,
    Hello,
    Increment,
    Ping,
    ScaleChoice,
    error_line,
    parse_hello,
    parse_message,
    pong_line,
    welcome_line,
)

HELLO = {
    "type": "hello",
    "v": 1,
    "role": "operator",
    "token": "secret",
    "client": "HoloLens 2",
    "frame": "unity",
    "rate_hz": 60,
    "simulated": False,
}
HAND = {"type": "hand", "seq": 7, "t": 1.5, "p": [0.1, 0.2, 0.3], "clutch": True, "valid": True}
INCREMENT = {"type": "increment", "seq": 7, "t": 1.5, "d": [0.1, 0.2, 0.3], "clutch": False, "valid": True}

BAD_NUMBERS = [
    "NaN",
    "Infinity",
    "-Infinity",
    "1e999",
    "-1e999",
    "1e300",
    "9" * 400,
    "-" + "9" * 3000,
    "101",
]
JUNK = [
    b"",
    b"null",
    b"[]",
    b"3",
    b'"hand"',
    b"{",
    b"{}",
    b"[" * 4000,
    b'{"a":' * 800,
    b'{"type":"hand","seq":' + b"[" * 2000 + b"]" * 2000 + b"}",
    b"\xff\xfe{}",
    b"\xef\xbb\xbf{}",
    '{"type":"hand"}'.encode("utf-16"),
    b"{'type':'hand'}",
    b'{"type":"hand",}',
    b'{"type":"hand"} {}',
    b'{"type":"hand","type":"ping","t":1}',
    b'{"type":"steer"}',
    b'{"type":"hello","v":1}',
    b'{"type":1}',
    b'{"type":"\\ud800"}',
    b'{"type":"ping","t":true}',
    b'{"type":"ping","t":"1"}',
    b'{"type":"ping","t":null}',
    b'{"type":"ping","t":[1]}',
    b'{"type":"ping"}',
    b'{"type":"ping","t":1,"x":2}',
    b"\x00" * 100,
    b"x" * 5000,
]


def line(fields: dict[str, object], **changes: object) -> bytes:
    return json.dumps({**fields, **changes}).encode()


def hand_with(field: str, literal: str) -> bytes:
    """Return a hand message with one value written exactly so."""
    text = json.dumps({**HAND, field: "@"})
    return text.replace('"@"', literal).encode()


def test_hello_is_read_with_its_optional_fields() -> None:
    assert parse_hello(line(HELLO)) == Hello(
        "operator", "secret", "HoloLens 2", ClientFrame.UNITY, 60.0, False
    )
    simulated = parse_hello(line(HELLO, simulated=True, model="steering", seed=3))
    assert (simulated.simulated, simulated.model, simulated.seed) == (True, "steering", 3)


@pytest.mark.parametrize(
    ("changes", "code", "named"),
    [
        ({"v": 2, "new_field": 1}, "bad_version", "version 1"),
        ({"v": True}, "bad_message", "v must"),
        ({"role": "admin"}, "bad_message", "role"),
        ({"frame": "blender"}, "bad_message", "frame"),
        ({"rate_hz": 0}, "bad_number", "rate_hz"),
        ({"rate_hz": "60"}, "bad_message", "rate_hz"),
        ({"client": "x" * 65}, "bad_message", "client"),
        ({"client": "a\nb"}, "bad_message", "client"),
        ({"client": "\ud800"}, "bad_message", "client"),
        ({"token": 5}, "bad_message", "token"),
        ({"simulated": 0}, "bad_message", "simulated"),
        ({"extra": 0}, "bad_message", "extra"),
        ({"type": "hand"}, "hello_first", "hello"),
    ],
)
def test_a_wrong_hello_is_refused_by_name(changes: dict[str, object], code: str, named: str) -> None:
    with pytest.raises(WireError, match=named) as caught:
        parse_hello(line(HELLO, **changes))
    assert caught.value.code == code


@pytest.mark.parametrize("field", sorted(HELLO))
def test_every_field_of_a_hello_is_needed(field: str) -> None:
    with pytest.raises(WireError, match=f"{field} is missing"):
        parse_hello(line({name: value for name, value in HELLO.items() if name != field}))


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (ClientFrame.WEBXR, HandPoint(0.1, 0.2, 0.3)),
        (ClientFrame.UNITY, HandPoint(0.1, 0.2, -0.3)),
        (ClientFrame.STAGE, HandPoint(0.1, 0.3, 0.2)),
    ],
)
def test_positions_and_steps_are_converted_once(frame: ClientFrame, expected: HandPoint) -> None:
    hand = parse_message(line(HAND, pose=4), frame)
    assert hand == HandMessage(7, 1.5, expected, clutch=True, valid=True, pose=4)
    increment = parse_message(line(INCREMENT), frame)
    assert increment == Increment(7, 1.5, expected, clutch=False, valid=True)


def test_unity_axes_become_right_handed() -> None:
    x, y, z = (ClientFrame.UNITY.hand_point(axis) for axis in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)))
    # Left-handed x × y = z: the image must satisfy x × y = −z, and forward is away from the operator.
    assert (x.x_m, y.y_m, z.z_m) == (1.0, 1.0, -1.0)


def test_ping_is_read() -> None:
    assert parse_message(b'{"type":"ping","t":12.25}\n', ClientFrame.WEBXR) == Ping(12.25)


@pytest.mark.parametrize("field", ["seq", "t", "p", "clutch", "valid"])
def test_every_field_of_a_hand_message_is_needed(field: str) -> None:
    with pytest.raises(WireError, match=f"{field} is missing"):
        parse_message(line({name: value for name, value in HAND.items() if name != field}), ClientFrame.WEBXR)


@pytest.mark.parametrize("literal", BAD_NUMBERS)
def test_a_number_that_measures_nothing_is_told_from_broken_protocol(literal: str) -> None:
    with pytest.raises(NumberError):
        parse_message(hand_with("p", f"[0, {literal}, 0]"), ClientFrame.WEBXR)


@pytest.mark.parametrize("field", ["seq", "clutch", "unknown"])
def test_nan_counts_as_a_bad_number_wherever_it_stands(field: str) -> None:
    with pytest.raises(NumberError):
        parse_message(hand_with(field, "NaN"), ClientFrame.WEBXR)


@pytest.mark.parametrize("literal", ["NaN", "1e999", "9" * 400])
@pytest.mark.parametrize("field", ["t", "p"])
def test_the_offending_field_is_named(field: str, literal: str) -> None:
    with pytest.raises(NumberError) as caught:
        parse_message(hand_with(field, literal if field == "t" else f"[0,0,{literal}]"), ClientFrame.WEBXR)
    assert literal == "NaN" or field in str(caught.value)


@pytest.mark.parametrize(
    ("field", "literal"),
    [
        ("seq", "1.5"),
        ("seq", "true"),
        ("seq", '"7"'),
        ("t", "false"),
        ("p", "[0, true, 0]"),
        ("p", "[0, 0]"),
        ("p", "[0, 0, 0, 0]"),
        ("p", "[[0, 0, 0]]"),
        ("p", '{"x": 0}'),
        ("p", '["0", 0, 0]'),
        ("clutch", "1"),
        ("valid", "null"),
        ("pose", "2.0"),
    ],
)
def test_a_wrong_type_breaks_the_protocol_and_is_named(field: str, literal: str) -> None:
    with pytest.raises(WireError, match=field) as caught:
        parse_message(hand_with(field, literal), ClientFrame.WEBXR)
    assert caught.value.code == "bad_message"


@pytest.mark.parametrize("junk", JUNK)
def test_junk_is_a_wire_error(junk: bytes) -> None:
    with pytest.raises(WireError) as caught:
        parse_message(junk, ClientFrame.WEBXR)
    assert len(str(caught.value)) < 300
    with pytest.raises(WireError):
        parse_hello(junk)


_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
_names = st.sampled_from(["type", "seq", "t", "p", "d", "clutch", "valid", "pose", "v", "role", "token"])
_messages = st.dictionaries(_names, _values | st.sampled_from(["hand", "increment", "ping", "hello"]))


@settings(max_examples=800, deadline=None)
@given(st.binary(max_size=200) | _messages.map(lambda fields: json.dumps(fields).encode()))
@example(b"[" * 4096)
@example(line({**HAND, "p": [math.nan, 0, 0]}))
def test_any_bytes_give_a_checked_record_or_a_wire_error(junk: bytes) -> None:
    try:
        message = parse_message(junk, ClientFrame.UNITY)
    except WireError:
        return
    if isinstance(message, ScaleChoice):
        return
    assert math.isfinite(message.t_s)
    if isinstance(message, HandMessage):
        point = message.point
        assert all(type(value) is float and abs(value) <= 100 for value in (point.x_m, point.y_m, point.z_m))


@settings(max_examples=500, deadline=None)
@given(
    st.fixed_dictionaries(
        {"type": st.just("hand")},
        optional=dict.fromkeys(("seq", "t", "p", "clutch", "valid", "pose", "x"), _values),
    )
)
def test_what_passes_is_what_was_sent(fields: dict[str, object]) -> None:
    try:
        message = parse_message(json.dumps(fields).encode(), ClientFrame.WEBXR)
    except WireError:
        return
    assert isinstance(message, HandMessage)
    assert type(fields["seq"]) is int
    assert message.seq == fields["seq"]
    assert message.clutch is fields["clutch"]
    assert [message.point.x_m, message.point.y_m, message.point.z_m] == fields["p"]


def test_a_line_may_have_4096_bytes_and_no_more() -> None:
    padded = line(HAND).ljust(4096)
    assert isinstance(parse_message(padded, ClientFrame.WEBXR), HandMessage)
    with pytest.raises(WireError) as caught:
        parse_message(padded + b" ", ClientFrame.WEBXR)
    assert caught.value.code == "line_too_long"


def test_answers_are_single_lines_of_json() -> None:
    welcome = welcome_line("abc", True, {"speed_um_per_s": 3000.0}, {"gain": 0.04})
    assert json.loads(welcome) == {
        "type": "welcome",
        "v": 1,
        "session": "abc",
        "lease": True,
        "limits": {"speed_um_per_s": 3000.0},
        "transform": {"gain": 0.04},
    }
    assert json.loads(error_line("bad_token", "no\nnewline")) == {
        "type": "error",
        "code": "bad_token",
        "message": "no\nnewline",
    }
    assert json.loads(pong_line(1.0, 2.0)) == {"type": "pong", "t": 1.0, "t_server": 2.0}
    assert all(text.count(b"\n") == 1 for text in (welcome, error_line("a", "b\n"), pong_line(0.0, 0.0)))


def test_what_is_not_finite_is_never_sent() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode_line({"x": math.nan})


def test_a_field_is_taken_once() -> None:
    fields = Fields(b'{"a":1}')
    assert fields.has("a")
    assert fields.whole("a") == 1
    fields.finish()
