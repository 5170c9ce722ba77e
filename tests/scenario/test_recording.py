from __future__ import annotations

import hashlib
from math import hypot, nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenario_strategies import RECORDING, csv_of

from safety_harness.base.exceptions import Place, RecordingError
from safety_harness.scenario import recording
from safety_harness.scenario.model import NOT_LOADED, RecordedHand, RecordedMotion
from safety_harness.scenario.recording import load_recording, parse_recording

FILE = Path("walk.csv")
FOLDER = Path(__file__).parents[2] / "scenarios/recordings"
TIME = np.arange(101) / 100  # one second at 100 Hz
VELOCITY = np.array([0.4, -0.3, 0.2])
STRAIGHT = np.outer(TIME, VELOCITY) + np.array([5.0, 6.0, 7.0])
FOREARM = np.array([0.2, 0.1, 0.05])
SWAP = np.array([0.05, 0.05, 0.0])  # to another marker of the same hand
JUMP = f"{np.linalg.norm(SWAP / 0.01 + VELOCITY):.3g} m/s"
START = (1.2, -0.7, 0.1)


def motion_of(data: bytes, **changes: Any) -> RecordedMotion:
    usage: dict[str, Any] = {
        "track": "right_hand",
        "elbow_track": None,
        "elbow_towards_in_base_m": (50.0, 0.0, 0.0),
        "starts_at_in_base_m": START,
        "turn_rad": 0.0,
        "speed_factor": 1.0,
        "from_s": None,
        "to_s": None,
        "longest_gap_s": 0.2,
        "fastest_jump_mps": 5.0,
    }
    hand = RecordedHand(name="right", recording=FILE, motion=NOT_LOADED, **(usage | changes))
    return load_recording(parse_recording(data, FILE), hand, forearm_length_m=0.3)


def refusal(data: bytes, **changes: Any) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        motion_of(data, **changes)
    assert caught.value.place.file == FILE
    return caught.value


def walk(
    positions: np.ndarray = STRAIGHT, *, empty: set[int] | None = None, time_s: np.ndarray = TIME
) -> bytes:
    return csv_of(time_s, {"right_hand": positions}, empty={"right_hand": empty or set()})


def swapped(*samples: int) -> np.ndarray:
    positions = STRAIGHT.copy()
    positions[list(samples)] += SWAP
    return positions


def assert_is_the_straight_motion(motion: RecordedMotion) -> None:
    expected = np.outer(motion.time_s, VELOCITY) + START
    np.testing.assert_allclose(motion.hand_position_in_base_m, expected, rtol=0, atol=1e-12)


class TestPlacing:
    def test_the_first_used_sample_comes_to_the_start_at_time_zero(self) -> None:
        for changes in ({}, {"from_s": 0.305}, {"turn_rad": 1.0}, {"speed_factor": 3.0}):
            motion = motion_of(walk(), **changes)
            assert motion.time_s[0] == 0.0
            assert tuple(motion.hand_position_in_base_m[0]) == START

    def test_without_a_turn_the_displacements_are_the_recorded_ones(self) -> None:
        motion = motion_of(walk())
        np.testing.assert_allclose(
            motion.hand_position_in_base_m - START, STRAIGHT - STRAIGHT[0], rtol=0, atol=1e-14
        )

    def test_a_quarter_turn_takes_x_to_y(self) -> None:
        away = motion_of(walk(), turn_rad=pi / 2).hand_position_in_base_m - START
        x, y, z = (STRAIGHT - STRAIGHT[0]).T
        np.testing.assert_allclose(away, np.stack([-y, x, z], axis=1), rtol=0, atol=1e-14)

    @hypothesis_settings(deadline=None, max_examples=20)
    @given(turn=st.floats(min_value=-7.0, max_value=7.0))
    def test_a_turn_keeps_heights_and_distances(self, turn: float) -> None:
        straight, turned = motion_of(RECORDING), motion_of(RECORDING, turn_rad=turn)
        away, away_turned = (m.hand_position_in_base_m - START for m in (straight, turned))
        np.testing.assert_array_equal(away_turned[:, 2], away[:, 2])
        np.testing.assert_allclose(
            np.linalg.norm(away_turned, axis=1), np.linalg.norm(away, axis=1), rtol=0, atol=1e-12
        )

    def test_the_speed_factor_shortens_time_and_changes_nothing_else(self) -> None:
        slow, fast = motion_of(walk()), motion_of(walk(), speed_factor=4.0)
        np.testing.assert_array_equal(fast.time_s * 4.0, slow.time_s)
        np.testing.assert_array_equal(fast.hand_position_in_base_m, slow.hand_position_in_base_m)

    def test_the_window_is_on_the_recordings_own_clock(self) -> None:
        motion = motion_of(walk(time_s=TIME + 1.7e9), from_s=1.7e9 + 0.2, to_s=1.7e9 + 0.5)
        assert motion.time_s[-1] == pytest.approx(0.3, abs=1e-6)

    def test_the_motion_is_read_only_and_named_by_its_bytes(self) -> None:
        motion = motion_of(walk())
        assert motion.sha256 == hashlib.sha256(walk()).hexdigest()
        with pytest.raises(ValueError, match="read-only"):
            motion.hand_position_in_base_m[0, 0] = 1.0

    def test_other_columns_and_empty_lines_are_left_alone(self) -> None:
        header, *rows = walk().decode().splitlines()
        data = "\r\n".join([f"{header},phase", *(f"{row},reach" for row in rows), "", ""]).encode()
        assert_is_the_straight_motion(motion_of(data))


class TestGaps:
    def test_a_gap_is_bridged_by_straight_motion_and_reported(self) -> None:
        motion = motion_of(walk(empty={10, 11, 12, 50}))
        assert len(motion.time_s) == len(TIME) - 4
        assert_is_the_straight_motion(motion)
        assert motion.notes == ("right hand: 2 gaps of at most 0.04 s bridged",)

    def test_a_clean_recording_has_no_notes(self) -> None:
        assert motion_of(walk()).notes == ()

    def test_one_empty_cell_makes_the_whole_sample_a_gap(self) -> None:
        lines = walk().decode().splitlines()
        cells = lines[31].split(",")
        lines[31] = ",".join([*cells[:-1], "NaN"])
        motion = motion_of("\n".join(lines).encode())
        assert motion.notes == ("right hand: 1 gap of at most 0.02 s bridged",)

    def test_missing_rows_are_a_gap_as_well(self) -> None:
        keep = np.r_[0:40, 50:101]
        motion = motion_of(walk(STRAIGHT[keep], time_s=TIME[keep]))
        assert motion.notes == ("right hand: 1 gap of at most 0.11 s bridged",)
        assert_is_the_straight_motion(motion)

    def test_a_gap_as_long_as_the_bound_is_bridged_and_a_longer_one_refused(self) -> None:
        as_long, longer = set(range(31, 50)), set(range(31, 51))
        assert motion_of(walk(empty=as_long)).notes == ("right hand: 1 gap of at most 0.2 s bridged",)
        error = refusal(walk(empty=longer))
        assert error.place == Place(file=FILE, line=33, field="right_hand")
        assert error.expected == "a usable sample every 0.2 s or sooner"
        assert error.got == "none for 0.21 s, from 0.3 s to 0.51 s of the file"
        assert "from" in error.hint
        assert "longest gap" in error.hint
        assert motion_of(walk(empty=longer), longest_gap_s=0.3).notes != ()
        assert motion_of(walk(empty=longer), from_s=0.55).notes == ()

    @pytest.mark.parametrize("empty", [set(range(25)), set(range(80, 101))])
    def test_a_long_gap_at_either_end_is_refused_too(self, empty: set[int]) -> None:
        assert refusal(walk(empty=empty)).expected == "a usable sample every 0.2 s or sooner"

    def test_a_short_gap_at_either_end_is_reported(self) -> None:
        motion = motion_of(walk(empty={0, 1, 99, 100}))
        assert motion.notes == ("right hand: starts 0.02 s late, ends 0.02 s early",)
        assert motion.time_s[-1] == pytest.approx(0.96)


class TestJumps:
    def test_a_swapped_marker_is_taken_out_until_it_jumps_back(self) -> None:
        motion = motion_of(walk(swapped(*range(30, 42))))
        assert len(motion.time_s) == len(TIME) - 12
        assert_is_the_straight_motion(motion)
        assert motion.notes == (
            f"right hand: 1 gap of at most 0.13 s bridged, 1 jump removed (12 samples, fastest {JUMP})",
        )

    def test_several_swaps_are_counted_with_the_trackers_own_gaps(self) -> None:
        motion = motion_of(walk(swapped(20, *range(60, 65)), empty={80}))
        assert_is_the_straight_motion(motion)
        assert motion.notes[0].startswith(
            "right hand: 3 gaps of at most 0.06 s bridged, 2 jumps removed (6 samples"
        )

    def test_a_swap_that_ends_in_a_gap_ends_with_it(self) -> None:
        motion = motion_of(walk(swapped(30, 31, 32), empty={33, 34}))
        assert_is_the_straight_motion(motion)
        assert len(motion.time_s) == len(TIME) - 5

    def test_a_swap_that_never_ends_is_refused_with_its_jump(self) -> None:
        error = refusal(walk(swapped(*range(40, 101))))
        assert error.place.line == 42
        assert error.got == f"none for 0.61 s, from 0.39 s to 1 s of the file, after a jump of {JUMP}"

    def test_a_faster_bound_keeps_the_jump(self) -> None:
        motion = motion_of(walk(swapped(30)), fastest_jump_mps=8.0)
        assert motion.notes == ()
        assert len(motion.time_s) == len(TIME)

    def test_the_bound_is_on_recorded_speed_not_on_the_replayed_one(self) -> None:
        assert motion_of(walk(), speed_factor=50.0).notes == ()

    def test_a_jump_outside_the_window_does_not_matter(self) -> None:
        assert_is_the_straight_motion(motion_of(walk(swapped(*range(40))), from_s=0.4))

    @hypothesis_settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(
        steps=arrays(np.float64, (40, 3), elements=st.sampled_from([0.0, 0.001, -0.002, 0.04, -0.04])),
        empty=st.sets(st.integers(min_value=0, max_value=39), max_size=10),
    )
    def test_no_motion_that_is_left_is_faster_than_the_bound(
        self, steps: np.ndarray, empty: set[int]
    ) -> None:
        positions = np.cumsum(steps, axis=0)
        try:
            motion = motion_of(walk(positions, empty=empty, time_s=TIME[:40]))
        except RecordingError:
            return
        speed = np.linalg.norm(np.diff(motion.hand_position_in_base_m, axis=0), axis=1) / np.diff(
            motion.time_s
        )
        assert speed.max() <= 5.0 + 1e-9
        # Nothing is smoothed: every sample that is left is a recorded one.
        kept = np.round((motion.time_s + TIME[first_kept(motion, positions)]) * 100).astype(int)
        away = positions[kept] - positions[kept[0]]
        np.testing.assert_allclose(motion.hand_position_in_base_m - START, away, rtol=0, atol=1e-12)
        assert not set(kept.tolist()) & empty


def first_kept(motion: RecordedMotion, positions: np.ndarray) -> int:
    """Which sample the motion starts with: the one that its notes' delay names."""
    late = [note.split("starts ")[1].split(" s late")[0] for note in motion.notes if "late" in note]
    return round(float(late[0]) * 100) if late else 0


class TestElbows:
    def test_a_recorded_elbow_moves_with_the_hand(self) -> None:
        data = csv_of(TIME, {"right_hand": STRAIGHT, "right_elbow": STRAIGHT + FOREARM})
        motion = motion_of(data, elbow_track="right_elbow", elbow_towards_in_base_m=None, turn_rad=pi / 2)
        forearm = motion.elbow_position_in_base_m - motion.hand_position_in_base_m
        np.testing.assert_allclose(forearm, np.tile([-0.1, 0.2, 0.05], (101, 1)), rtol=0, atol=1e-12)

    def test_gaps_of_the_elbow_are_bridged_on_their_own(self) -> None:
        tracks = {"right_hand": STRAIGHT, "right_elbow": STRAIGHT + FOREARM}
        data = csv_of(TIME, tracks, empty={"right_hand": {5, 50, 51}, "right_elbow": {51, 52, 90}})
        motion = motion_of(data, elbow_track="right_elbow", elbow_towards_in_base_m=None)
        assert len(motion.time_s) == len(TIME) - 1  # only sample 51 has neither
        forearm = motion.elbow_position_in_base_m - motion.hand_position_in_base_m
        np.testing.assert_allclose(forearm, np.tile(FOREARM, (100, 1)), rtol=0, atol=1e-12)
        assert motion.notes == (
            "right hand: 2 gaps of at most 0.03 s bridged",
            "right elbow: 2 gaps of at most 0.03 s bridged",
        )

    def test_swaps_of_the_elbow_are_taken_out(self) -> None:
        elbow = swapped(60, 61) + FOREARM
        data = csv_of(TIME, {"right_hand": STRAIGHT, "right_elbow": elbow})
        motion = motion_of(data, elbow_track="right_elbow", elbow_towards_in_base_m=None)
        forearm = motion.elbow_position_in_base_m - motion.hand_position_in_base_m
        np.testing.assert_allclose(forearm, np.tile(FOREARM, (101, 1)), rtol=0, atol=1e-12)

    def test_the_motion_lasts_while_both_are_known(self) -> None:
        tracks = {"right_hand": STRAIGHT, "right_elbow": STRAIGHT}
        data = csv_of(TIME, tracks, empty={"right_hand": {1}, "right_elbow": {0, 99, 100}})
        motion = motion_of(data, elbow_track="right_elbow", elbow_towards_in_base_m=None)
        assert tuple(motion.hand_position_in_base_m[0]) == START
        assert motion.time_s[-1] == pytest.approx(0.97)
        assert_is_the_straight_motion(motion)

    def test_a_fixed_elbow_is_one_forearm_from_the_hand_towards_the_point(self) -> None:
        towards = np.array([2.6, -2.2, 0.3])
        motion = motion_of(walk(), elbow_towards_in_base_m=tuple(towards))
        forearm = motion.elbow_position_in_base_m - motion.hand_position_in_base_m
        np.testing.assert_allclose(np.linalg.norm(forearm, axis=1), 0.3, rtol=1e-12)
        rest = towards - motion.elbow_position_in_base_m
        np.testing.assert_allclose(np.cross(forearm, rest), 0.0, rtol=0, atol=1e-12)
        assert np.all(np.sum(forearm * rest, axis=1) > 0.0)

    def test_a_hand_that_passes_through_the_fixed_point_is_refused(self) -> None:
        on_the_way = tuple(np.array(START) + STRAIGHT[50] - STRAIGHT[0])
        assert refusal(walk(), elbow_towards_in_base_m=on_the_way).got == "a hand that passes through it"

    def test_the_same_side_has_the_default_elbow(self) -> None:
        parsed = parse_recording(RECORDING, FILE)
        assert parsed.elbow_of("right_hand") == "right_elbow"
        assert parsed.elbow_of("left_hand") is None
        assert parsed.elbow_of("right_elbow") is None


HEAD = b"time_s,right_hand_x_m,right_hand_y_m,right_hand_z_m\n"
FIRST = HEAD + b"0,1,1,1\n"
NUMBER = "a number of at most"
LATER = "a time later than the one before"
TWO = "at least two usable samples from 0 s to 0.1 s"


@pytest.mark.parametrize(
    ("data", "line", "column", "expected", "got"),
    [
        (b"", 1, None, "a line with the names of the columns", "an empty file"),
        (FIRST.replace(b"time_s", b"time"), 1, None, 'a column "time_s"', "the columns time, right"),
        (FIRST.replace(b"_y_m", b"_x_m"), 1, "right_hand_x_m", "each column once", '"right_hand_x_m" twice'),
        (HEAD, None, None, "at least two samples", "0"),
        (FIRST, None, None, "at least two samples", "1"),
        (FIRST + b"1,1,1\n", 3, None, "4 cells, as in the first line", "3"),
        (FIRST + b"0,1,1,1\n", 3, "time_s", LATER, "0 s after 0 s"),
        (FIRST + b"\n2,1,1,1\n1,1,1,1\n", 5, "time_s", LATER, "1 s after 2 s"),
        (FIRST + b",1,1,1\n", 3, "time_s", "a time", "an empty cell"),
        (FIRST + b"soon,1,1,1\n", 3, "time_s", NUMBER, "soon"),
        (FIRST + b".1,1,1 m,1\n", 3, "right_hand_y_m", NUMBER, "1 m"),
        (FIRST + b".1,1,1,inf\n", 3, "right_hand_z_m", NUMBER, "inf"),
        (FIRST + b".1,1,1_0,1\n", 3, "right_hand_y_m", NUMBER, "1_0"),
        (FIRST + b".1,1,1,812.5\n", 3, "right_hand_z_m", f"{NUMBER} 100", "812.5"),
        (FIRST + b".1,,,\n", None, "right_hand", TWO, "1"),
        (HEAD + b"0,,,\n.1,,,\n", None, "right_hand", TWO, "0"),
        (FIRST + b".1,1,\xff,1\n", 3, None, "text in UTF-8", "the byte 0xff"),
        (FIRST + b'.1,1,"1,1\n', 3, None, "a table of cells with commas", "unexpected end of data"),
        (
            FIRST.replace(b"_y_m", b"_y") + b"1,1,1,1\n",
            1,
            "right_hand",
            "one of the tracks (there is",
            "right_hand",
        ),
    ],
)
def test_what_is_no_recording_is_refused_with_line_and_column(
    data: bytes, line: int | None, column: str | None, expected: str, got: str
) -> None:
    error = refusal(data)
    assert error.place == Place(file=FILE, line=line, field=column)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


@pytest.mark.parametrize(
    ("limit", "data", "line", "expected"),
    [
        ("MAX_ROWS", FIRST + b"1,1,1,1\n2,1,1,1\n", 4, "at most 2 samples"),
        ("MAX_COLUMNS", FIRST + b"1,1,1,1\n", 1, "at most 2 columns"),
        ("MAX_BYTES", FIRST + b"1,1,1,1\n", None, "at most 2 bytes"),
    ],
)
def test_a_recording_that_is_too_large_is_refused(
    monkeypatch: pytest.MonkeyPatch, limit: str, data: bytes, line: int | None, expected: str
) -> None:
    monkeypatch.setattr(recording, limit, 2)
    error = refusal(data)
    assert (error.place, error.expected) == (Place(file=FILE, line=line), expected)


def test_the_work_on_a_recording_grows_with_its_length_and_not_with_its_square(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The usual step between samples is looked for once a track, however many samples there are."""
    medians: list[int] = []
    median = np.median
    monkeypatch.setattr(recording.np, "median", lambda values: medians.append(len(values)) or median(values))
    assert_is_the_straight_motion(motion_of(walk(swapped(20, 21), empty={50})))
    assert medians == [len(TIME) - 1]


def test_an_unknown_track_gets_a_suggestion_and_the_list() -> None:
    error = refusal(RECORDING, track="rigth_hand")
    assert error.expected == "one of the tracks right_hand, right_elbow, left_hand of walk.csv"
    assert error.hint == 'did you mean "right_hand"?'


@pytest.mark.parametrize(
    ("from_s", "to_s"),
    [(-0.1, None), (None, 1.1), (1.0, None), (0.5, 0.5), (0.6, 0.4), (2.0, 3.0), (nan, None)],
)
def test_a_window_outside_the_recording_is_refused(from_s: float | None, to_s: float | None) -> None:
    error = refusal(walk(), from_s=from_s, to_s=to_s)
    assert error.expected == '"from" before "to", both from 0 s to 1 s of walk.csv'


def test_a_window_between_two_samples_is_refused() -> None:
    assert refusal(walk(), from_s=0.101, to_s=0.109).expected.startswith("at least two usable samples")


@hypothesis_settings(deadline=None, max_examples=200)
@given(data=st.data())
def test_any_damage_to_a_recording_is_a_motion_or_refused(data: st.DataObject) -> None:
    damaged = bytearray(RECORDING[:3000])
    for _ in range(data.draw(st.integers(min_value=1, max_value=4))):
        at = data.draw(st.integers(min_value=0, max_value=len(damaged) - 1))
        junk = data.draw(
            st.sampled_from([b"", b",", b"\n", b'"', b"-", b"e9", b"nan", b"\x00", b"\xff", b"9" * 400])
        )
        damaged[at : at + data.draw(st.integers(min_value=0, max_value=60))] = junk
        damaged = damaged or bytearray(b"x")
    try:
        motion = motion_of(bytes(damaged))
    except RecordingError:
        return
    assert np.all(np.isfinite(motion.hand_position_in_base_m))
    assert np.all(np.isfinite(motion.elbow_position_in_base_m))
    assert np.all(np.diff(motion.time_s) > 0.0)


class TestTheSixRecordings:
    files = sorted(FOLDER.glob("*.csv"))

    @staticmethod
    def swaps(file: Path) -> int:
        """How often the forearm's length jumps by more than 10 mm: a sign of swapped markers."""
        table = np.genfromtxt(file, delimiter=",", names=True)
        forearm = [table[f"right_hand_{axis}_m"] - table[f"right_elbow_{axis}_m"] for axis in "xyz"]
        length = np.sqrt(sum(part**2 for part in forearm))
        return int(np.sum(np.abs(np.diff(length)) > 0.01))

    def load(self, file: Path, **changes: Any) -> RecordedMotion:
        return motion_of(
            file.read_bytes(), elbow_track="right_elbow", elbow_towards_in_base_m=None, **changes
        )

    def test_there_are_six(self) -> None:
        assert len(self.files) == 6

    @pytest.mark.parametrize("file", files, ids=lambda file: file.stem)
    def test_the_right_hand_can_be_used_whole(self, file: Path) -> None:
        motion = self.load(file)
        table = np.genfromtxt(file, delimiter=",", names=True)
        assert motion.time_s[-1] == pytest.approx(table["time_s"][-1])
        away = motion.hand_position_in_base_m - motion.hand_position_in_base_m[0]
        assert 0.5 < max(hypot(x, y) for x, y, _ in away) < 2.0

    @pytest.mark.parametrize("file", files, ids=lambda file: file.stem)
    def test_swapped_markers_are_gone(self, file: Path) -> None:
        motion = self.load(file, fastest_jump_mps=3.0)
        length = np.linalg.norm(motion.hand_position_in_base_m - motion.elbow_position_in_base_m, axis=1)
        assert np.abs(np.diff(length)).max() < 0.01
        assert (self.swaps(file) > 0) == any("jump" in note for note in motion.notes)
