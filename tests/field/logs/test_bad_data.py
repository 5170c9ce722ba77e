"""What a log cannot be used with is told with its place, and nothing is sorted, mended or left out."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cells import cell, recorded, said, write_csv
from log_formats import parquet

from safety_harness.base.exceptions import InputError, LogError
from safety_harness.extensions.field.logs.judging import recorded as judged_log

Lines = list[str]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    rng = np.random.default_rng(2)
    write_csv(recorded(cell(rng), rng, seconds=1.0), tmp_path)
    file = tmp_path / "LOG.yaml"
    file.write_text(said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
    return file


def _refusal(log: Path) -> InputError:
    with pytest.raises(InputError) as refused:
        judged_log(log)
    return refused.value


def _edited(log: Path, table: str, edit: Callable[[Lines], Lines]) -> InputError:
    file = log.with_name(table)
    file.write_text("\n".join(edit(file.read_text().splitlines())) + "\n")
    return _refusal(log)


def _cell(line: str, column: int, text: str) -> str:
    cells = line.split(",")
    cells[column] = text
    return ",".join(cells)


@pytest.mark.parametrize("table", ["joints.csv", "hands.csv"])
def test_unsorted_rows_are_told_with_their_line(log: Path, table: str) -> None:
    error = _edited(log, table, lambda rows: [*rows[:10], rows[11], rows[10], *rows[12:]])
    assert (error.place.file, error.place.line) == (log.with_name(table), 12)
    assert "1 us after the previous sample" in error.expected
    assert "sort it by time, in a copy" in error.hint


def test_a_repeated_row_is_told_with_its_line(log: Path) -> None:
    error = _edited(log, "hands.csv", lambda rows: [*rows[:9], rows[8], *rows[9:]])
    assert error.place.line == 10
    assert "the same sample twice" in error.hint


def test_two_rows_of_one_time_that_differ_are_told(log: Path) -> None:
    other = [lambda row: _cell(row, 1, "0.7")]
    error = _edited(log, "hands.csv", lambda rows: [*rows[:9], other[0](rows[8]), *rows[9:]])
    assert "two samples of one time that are not the same" in error.hint


def test_a_jump_of_a_hand_is_told_with_its_speed(log: Path) -> None:
    error = _edited(log, "hands.csv", lambda rows: [*rows[:12], _cell(rows[12], 1, "0.2"), *rows[13:]])
    assert error.place.line == 13
    assert "possible at 1 m/s" in error.expected
    assert "m/s" in error.got


def _with_bounds(log: Path, *changes: tuple[str, str]) -> LogError:
    text = log.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    log.write_text(text)
    with pytest.raises(LogError) as caught:
        judged_log(log)
    return caught.value


def test_a_bound_of_a_hands_speed_that_only_distant_samples_contradict_is_refused(log: Path) -> None:
    """Neighbours differ by less than twice 30 mm, whatever the hand does between them."""
    error = _with_bounds(
        log, ("moves at most: 1.0 m/s", "moves at most: 0.05 m/s"), ("known to: 8 mm", "known to: 30 mm")
    )
    assert re.search(r"a way from the sample \d+ before that is possible at 0\.05 m/s", error.expected)


def test_a_bound_of_a_joints_speed_that_only_distant_samples_contradict_is_refused(log: Path) -> None:
    error = _with_bounds(
        log, ("joints: {known to: 0.2 mrad", "joints: {move at most: 0.1 deg/s, known to: 5 mrad")
    )
    assert "0.1 deg/s at most" in error.expected


def test_a_jump_of_a_joint_is_told_with_its_name(log: Path) -> None:
    error = _edited(log, "joints.csv", lambda rows: [*rows[:30], _cell(rows[30], 2, "1.5"), *rows[31:]])
    assert error.place.line == 31
    assert "shoulder_lift_joint" in error.expected
    assert "a jump of" in error.got


def test_millimetres_among_metres_are_told(log: Path) -> None:
    in_mm = [lambda row: ",".join([row.split(",")[0], *(str(float(c) * 1e3) for c in row.split(",")[1:])])]
    error = _edited(log, "hands.csv", lambda rows: [*rows[:12], *map(in_mm[0], rows[12:])])
    assert error.place.line == 13
    assert "within 10 m of the base" in error.expected
    assert "unit" in error.hint


@pytest.mark.parametrize("text", ["inf", "12,5", "n/a", "1_0"])
def test_a_cell_that_is_no_number_is_told_with_its_column(log: Path, text: str) -> None:
    error = _edited(log, "hands.csv", lambda rows: [*rows[:12], _cell(rows[12], 2, text), *rows[13:]])
    assert error.place.line == 13
    assert error.place.field == "hand_y_m" or "cells" in error.expected  # a comma makes one cell more


@pytest.mark.parametrize("text", ["", "nan", "NaN"])
def test_a_sample_without_a_number_was_not_measured(log: Path, text: str) -> None:
    before = judged_log(log).trace.known.column("hand_position_in_base_m")
    rows = log.with_name("hands.csv").read_text().splitlines()
    rows[12:20] = [_cell(row, 2, text) for row in rows[12:20]]
    log.with_name("hands.csv").write_text("\n".join(rows) + "\n")
    after = judged_log(log).trace.known.column("hand_position_in_base_m")
    assert before.gaps == ()
    assert len(after.gaps) == 1


def test_a_row_cut_off_is_told_with_its_line(log: Path) -> None:
    error = _edited(log, "joints.csv", lambda rows: [*rows[:40], rows[40][:60]])
    assert error.place.line == 41
    assert error.expected == "7 cells, as in the first line"


def test_a_column_without_a_unit_wants_one(log: Path) -> None:
    error = _edited(log, "hands.csv", lambda rows: [rows[0].replace("_m", ""), *rows[1:]])
    assert "a unit" in error.expected


def test_a_column_that_is_misspelt_is_told_with_what_is_near(log: Path) -> None:
    error = _edited(
        log, "joints.csv", lambda rows: [rows[0].replace("elbow_joint", "elbow_joimt"), *rows[1:]]
    )
    assert error.place.line == 1
    assert "elbow_joimt_rad" in error.hint


def test_a_parquet_file_cut_off_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    text = parquet(recorded(cell(rng), rng, seconds=1.0), tmp_path)
    (tmp_path / "LOG.yaml").write_text(text)
    data = tmp_path / "hands.parquet"
    data.write_bytes(data.read_bytes()[:-40])
    assert _refusal(tmp_path / "LOG.yaml").expected == "a Parquet file, whole"


@pytest.mark.parametrize("text", ["1e400", "1e300000", "-9e30", "1700000000000000000000"])
def test_a_time_for_which_nanoseconds_have_no_room_is_told_with_its_line(log: Path, text: str) -> None:
    error = _edited(log, "joints.csv", lambda rows: [*rows[:9], _cell(rows[9], 0, text), *rows[10:]])
    assert (error.place.line, error.place.field) == (10, "time_ns")
    assert "a time within 3e+09 s" in error.expected
    assert "unit" in error.hint


@pytest.mark.parametrize(
    ("of", "instead"),
    [
        ("log: {", "log: {from: 1e300 s, "),
        ("log: {", "log: {to: 1e300 s, "),
        ("ahead by: 137 ms", "ahead by: -1e300 s"),
        ("known to: 5 ms", "known to: 1e300 s"),
        ("longest gap: 200 ms", "longest gap: 1e300 s"),
        ("known to: 0.2 mrad", "known to: 0.2 mrad, longest gap: 1e300 s"),
    ],
)
def test_a_time_that_no_clock_shows_is_refused_where_it_is_said(log: Path, of: str, instead: str) -> None:
    log.write_text(log.read_text().replace(of, instead))
    assert "at most 3e+09 s" in _refusal(log).expected


def test_a_column_for_two_joints_is_refused(log: Path) -> None:
    names = "joints: {names: {wrist_2_joint: wrist_1_joint}, known"
    log.write_text(log.read_text().replace("joints: {known", names))
    error = _refusal(log)
    assert error.got == '"wrist_1_joint" for wrist_1_joint and wrist_2_joint'


@pytest.mark.parametrize("again", ["hands.csv#hand", "copy.csv#hand"])
def test_a_stream_for_two_hands_is_refused(log: Path, again: str) -> None:
    log.with_name("copy.csv").write_bytes(log.with_name("hands.csv").read_bytes())
    text = log.read_text().replace('"hands.csv#hand"', f'{{right: "hands.csv#hand", left: "{again}"}}')
    log.write_text(text.replace('forearm: "hands.csv#elbow"', "forearm: none"))
    assert "a stream of its own" in _refusal(log).expected


def test_joints_that_speed_up_harder_than_is_said_are_told(log: Path) -> None:
    file = log.with_name("joints.csv")
    judged_log(log)  # noise of as much as is said, at 4 rad/s2
    rows = file.read_text().splitlines()
    rows[30] = _cell(rows[30], 1, str(float(rows[30].split(",")[1]) + 0.003))
    file.write_text("\n".join(rows) + "\n")
    error = _refusal(log)
    assert "shoulder_pan_joint to speed up or brake at 4 rad/s2 at most" in error.expected
    assert error.place.line in (30, 31, 32)


@pytest.fixture
def of_parquet(tmp_path: Path) -> Path:
    rng = np.random.default_rng(2)
    (tmp_path / "LOG.yaml").write_text(parquet(recorded(cell(rng), rng, seconds=1.0), tmp_path))
    return tmp_path / "LOG.yaml"


@pytest.mark.parametrize(
    ("column", "kind"),
    [("time_ns", pa.timestamp("ns")), ("time_ns", pa.duration("ns")), ("joint", pa.bool_())],
)
def test_a_parquet_column_that_has_no_numbers_is_refused_with_its_type(
    of_parquet: Path, column: str, kind: pa.DataType
) -> None:
    file = of_parquet.with_name("joints.parquet")
    table = pq.read_table(file)
    at = next(k for k, name in enumerate(table.column_names) if column in name)
    pq.write_table(
        table.set_column(at, table.column_names[at], table.column(at).cast(kind, safe=False)), file
    )
    error = _refusal(of_parquet)
    assert (error.expected, error.got.split("[")[0]) == ("a column of numbers", str(kind).split("[")[0])
    assert table.column_names[at] in str(error.place)
    assert ('cast("int64")' in error.hint) == (column == "time_ns")


@pytest.mark.parametrize("name", [b"shoulder_pan_joint_rad", b"time_ns"])
def test_a_damaged_word_of_a_parquet_footer_is_told_with_its_file(of_parquet: Path, name: bytes) -> None:
    file = of_parquet.with_name("joints.parquet")
    data = file.read_bytes()
    for byte in (b"\x96", b"\xff"):
        file.write_bytes(data.replace(name, name[:2] + byte + name[3:]))
        assert _refusal(of_parquet).place.file == file


@pytest.mark.parametrize(
    ("line", "instead", "expected"),
    [
        ("clock:", "", "clock"),
        ("  longest gap: 200 ms", "", "longest gap"),
        ("  moves at most: 1.0 m/s", "", "moves at most"),
        ("  known to: 8 mm", "", "known to"),
        ("  frame: base", "", "frame"),
        ('  forearm: "hands.csv#elbow"', "", "forearm"),
        ("  known to: 8 mm", "  known to: 8", "unit"),
        ("clock:", "clock: {hands are ahead by: 137 ms}", "known to"),
    ],
)
def test_what_has_to_be_said_is_asked_for(log: Path, line: str, instead: str, expected: str) -> None:
    rows = log.read_text().splitlines()
    at = next(k for k, row in enumerate(rows) if row.startswith(line))
    log.write_text("\n".join([*rows[:at], *[instead][: bool(instead)], *rows[at + 1 :]]) + "\n")
    error = _refusal(log)
    assert error.place.file == log
    assert expected in str(error)


def test_without_the_extra_a_line_says_what_to_install(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    log.with_name("run.mcap").write_bytes(b"\x89MCAP0\r\n")
    log.write_text(said("run.mcap#/joint_states", "hands.csv#hand", "none"))
    with pytest.raises(Exception, match=r"safety-harness\[logs\]"):
        judged_log(log)
