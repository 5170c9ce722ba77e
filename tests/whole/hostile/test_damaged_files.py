"""Every kind of file cut, flipped, filled with rubbish: an error with its place, or what it still says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.base.exceptions import InputError, ModelError
from safety_harness.cell.avoidance.onnx_names import HAND
from tests.whole.hostile.formats import FORMATS, Format, onnx_bytes, onnx_read

quick = hypothesis_settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
thorough = hypothesis_settings(quick, max_examples=100)
each = pytest.mark.parametrize("kind", FORMATS, ids=lambda kind: kind.name)
hashed = pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind.hashed], ids=lambda k: k.name)


def outcome(kind: Format, folder: Path, data: bytes) -> InputError | None:
    """None for what can be read; the error, which has to be a good one; anything else is a defect."""
    path = kind.put(folder, data)
    try:
        kind.read(path)
    except InputError as error:
        refusal = error
    else:
        return None
    assert refusal.expected
    assert refusal.got
    assert str(folder) in str(refusal.place)
    assert len(str(refusal)) < 5_000
    assert str(refusal).isprintable()
    return refusal


def boundaries(kind: Format, data: bytes) -> list[int]:
    """Where a cut is likeliest to be overlooked: at lines and parts, near both ends, and in between."""
    if kind.text:
        ends = [at + 1 for at, byte in enumerate(data) if byte == ord("\n")]
        return [0, *ends[:: max(1, len(ends) // 30)], len(data) - 2]
    parts = [at for at in range(len(data)) if data[at : at + 2] == b"PK"]
    spread = [len(data) * k // 25 for k in range(25)]
    return sorted({*range(0, 12), *parts, *spread, len(data) - 22, len(data) - 4, len(data) - 1})


@each
def test_a_whole_file_is_read(kind: Format, tmp_path: Path) -> None:
    assert outcome(kind, tmp_path, kind.whole()) is None


@each
def test_a_file_that_ends_early_is_refused_or_complete(kind: Format, tmp_path: Path) -> None:
    data = kind.whole()
    errors = [outcome(kind, tmp_path, data[:at]) for at in boundaries(kind, data)]
    assert errors[0] is not None
    if kind.sealed:
        assert None not in errors


def flipped(kind: Format, choose: st.DataObject) -> bytes:
    data = bytearray(kind.whole())
    at = choose.draw(st.integers(0, 8 * len(data) - 1))
    data[at // 8] ^= 1 << at % 8
    return bytes(data)


@each
@quick
@given(choose=st.data())
def test_a_flipped_bit_is_refused_or_harmless(kind: Format, tmp_path: Path, choose: st.DataObject) -> None:
    outcome(kind, tmp_path, flipped(kind, choose))


def with_other_parts(kind: Format, choose: st.DataObject) -> bytes:
    data = kind.whole()
    for _ in range(choose.draw(st.integers(1, 3))):
        begin, end = sorted(choose.draw(st.tuples(*[st.integers(0, len(data))] * 2)))
        new = choose.draw(st.binary(max_size=20) | st.sampled_from([b"", data[begin:end] * 2, b"\0" * 1_000]))
        data = data[:begin] + new + data[end:]
    return data


@each
@quick
@given(choose=st.data())
def test_parts_that_are_missing_doubled_or_foreign_are_refused_or_harmless(
    kind: Format, tmp_path: Path, choose: st.DataObject
) -> None:
    outcome(kind, tmp_path, with_other_parts(kind, choose))


@pytest.mark.long
@each
@pytest.mark.parametrize("damaged", [flipped, with_other_parts])
@thorough
@given(choose=st.data())
def test_a_hundred_flips_and_other_parts_are_refused_or_harmless(
    kind: Format, damaged: Callable[[Format, st.DataObject], bytes], tmp_path: Path, choose: st.DataObject
) -> None:
    outcome(kind, tmp_path, damaged(kind, choose))


def test_a_name_in_an_onnx_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(onnx_bytes().replace(HAND.encode(), b"\xee" + HAND.encode()[1:]))
    with pytest.raises(ModelError, match=r"model\.onnx"):
        onnx_read(path)


@hashed
def test_no_change_of_what_is_hashed_is_taken(kind: Format, tmp_path: Path) -> None:
    data = kind.whole()
    refused = 0
    for k in range(40):
        at = (2 * k + 1) * len(data) // 80
        refused += outcome(kind, tmp_path, data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]) is not None
    assert refused > 30  # the others hit a byte that means nothing: a date, a space


RUBBISH = {
    "nothing": b"",
    "zeros": b"\0" * 10_000,
    "ones": b"\xff" * 10_000,
    "a deep list": b"[" * 100_000,
    "a deep list that ends": b"[" * 50_000 + b"]" * 50_000,
    "a deep mapping": b'{"a":' * 50_000,
    "a deep indentation": b"".join(b" " * k + b"a:\n" for k in range(600)),
    "a deep list of lines": b"- " * 50_000,
    "an anchor bomb": b"a: &a [x, x]\n" + b"".join(b"b%d: &b%d [*a, *a]\n" % (k, k) for k in range(40)),
    "an alias of itself": b"&a [*a]\n",
    "a tag": b"scenario: !!python/object/apply:os.system ['true']\n",
    "UTF-16": "scenario: x\n".encode("utf-16"),
    "a surrogate": b"scenario: \xed\xa0\x80\n",
    "a long line": b"scenario: " + b"x" * 200_000,
    "a long key": b"x" * 200_000 + b": 1\n",
    "many keys": b"".join(b"k%d: 1\n" % k for k in range(10_000)),
    "many documents": b"--- a\n" * 1_000,
    "a long number": b"scenario: x\nduration: " + b"9" * 100_000 + b" s\n",
    "control characters": b"scenario: \x1b[31m\x07\n",
    "no numbers": b"NaN",
    "a large exponent": b"1e999999999",
}


@each
@pytest.mark.parametrize("data", RUBBISH.values(), ids=RUBBISH.keys())
def test_rubbish_is_refused(kind: Format, data: bytes, tmp_path: Path) -> None:
    assert outcome(kind, tmp_path, data) is not None


@each
def test_what_is_no_file_is_refused(kind: Format, tmp_path: Path) -> None:
    path = kind.put(tmp_path, b"")
    path.unlink()
    for make in (lambda: None, path.mkdir):
        make()
        with pytest.raises(InputError):
            kind.read(path)
    path.rmdir()
    path.symlink_to(path)
    with pytest.raises(InputError):
        kind.read(path)


@pytest.mark.parametrize(
    "kind", [kind for kind in FORMATS if kind.name in ("scenario", "space")], ids=lambda k: k.name
)
@pytest.mark.parametrize(
    "speed", ["nan", "inf", "-inf", "1e308", "-1", "0", "0x10", "1_0", "1e400", "9" * 400, "١"]
)
def test_no_hand_has_such_a_speed(kind: Format, speed: str, tmp_path: Path) -> None:
    refusal = outcome(kind, tmp_path, kind.whole().replace(b"1 m/s", f"{speed} m/s".encode()))
    assert refusal is not None
    assert refusal.place.line is not None


@pytest.mark.parametrize("cell", ["inf", "-inf", "1e308", "1e400", "0x10", "1_0", "9" * 400, "one", "\x00"])
def test_no_recording_has_such_a_coordinate(cell: str, tmp_path: Path) -> None:
    kind = next(kind for kind in FORMATS if kind.name == "recording")
    refusal = outcome(kind, tmp_path, kind.whole().replace(b"1.0500", cell.encode()))
    assert refusal is not None
    assert refusal.place.line == 7


NO_NUMBERS = [b"NaN", b"-Infinity", b"1e999", b"1" + b"0" * 400]
JSON = [kind for kind in FORMATS if kind.file.endswith(".json")]


OTHERS = [*NO_NUMBERS, b"-1", b"null", b"true", b'"x"', b"[]", b"{}"]


@pytest.mark.parametrize("value", OTHERS, ids=ascii)
@pytest.mark.parametrize("kind", JSON, ids=lambda kind: kind.name)
def test_values_of_another_kind_are_refused_or_harmless(kind: Format, value: bytes, tmp_path: Path) -> None:
    data = kind.whole()
    values = list(re.finditer(rb'(?<=[:\[,] )(-?[0-9][-+.0-9e]*|true|false|null|"[^"]*")(?=[,\n}\]])', data))
    assert values
    every = max(1, len(values) // 20)
    for found in values[OTHERS.index(value) % every :: every]:  # each value at places of its own
        refusal = outcome(kind, tmp_path, data[: found.start()] + value + data[found.end() :])
        if kind.name == "evidence" and value in NO_NUMBERS[:3] and found[1][:1].isdigit():
            assert refusal is not None
