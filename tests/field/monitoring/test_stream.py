"""What a stream may do to a monitor: lines that are late, missing, out of order, or no samples at all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.base.exceptions import FormulaError, StreamError
from safety_harness.extensions.field.monitoring.cell import cell_taken, read_cell
from safety_harness.extensions.field.monitoring.earlier import EarlierSamples
from safety_harness.extensions.field.monitoring.monitor import Monitor, VerdictLine
from safety_harness.scenario.model import Verdict

PLACE = {"hand_position_in_base_m": [1.1, 0.2, 0.4], "elbow_position_in_base_m": [1.4, 0.2, 0.5]}
JOINTS = [-0.22, -1.27, 1.98, -2.27, -1.57, -0.22]
LOW = "always TCP height > 20 mm"
NEAR = "always hand distance > 10 mm"


@cache
def the_cell(claims: tuple[str, ...], hands: tuple[str, ...]):
    return cell_taken("UR10", hands, "8 ms", claims)


def monitor(*claims: str, hands: Sequence[str] = ("hand",), wait_s: float = 0.0) -> Monitor:
    return Monitor(cell=the_cell(claims, tuple(hands)), wait_s=wait_s)


def line(tick: float, **more: object) -> bytes:
    """Joints that stand still, and what else is said."""
    return json.dumps({"time_s": 100.0 + tick * 0.008, "joint_position_rad": JOINTS} | more).encode()


def take(own: Monitor, *lines: bytes) -> list[VerdictLine]:
    return [change for one in lines for change in own.take(one)]


def seen(ticks: Sequence[int], hands: Sequence[str] = ("hand",)) -> list[bytes]:
    return [line(tick, hands=dict.fromkeys(hands, PLACE)) for tick in ticks]


def test_a_verdict_line_comes_when_one_changes_and_not_otherwise() -> None:
    own = monitor(LOW)
    (first,) = take(own, *seen(range(30)))
    assert (first.verdict, first.time_s, first.unit) == (Verdict.HOLDS, 100.0, "mm")
    low = [-0.22, -0.77, 1.98, -2.77, -1.57, -0.22]  # 0.5 rad lower, within the bounds of speed
    path = [np.array(JOINTS) + (np.array(low) - JOINTS) * k / 60 for k in range(61)]
    changes = take(own, *(line(30 + k, joint_position_rad=q.tolist()) for k, q in enumerate(path)))
    assert [change.verdict for change in changes][-1] is Verdict.VIOLATED
    assert "TCP height" in changes[-1].reason


def test_a_hand_that_is_lost_is_inconclusive_at_once_and_known_again_when_it_is_seen() -> None:
    own = monitor(NEAR)
    take(own, *seen(range(20)))
    assert own.claims[0].latest is Verdict.HOLDS
    (change,) = take(own, line(20, hands={"hand": None}))
    assert change.latest is Verdict.INCONCLUSIVE
    assert "hand distance not known" in change.reason
    assert change.time_s == pytest.approx(100.16)
    take(own, *seen([21]))  # within the longest gap: where it can have been meanwhile is known
    assert own.claims[0].latest is Verdict.HOLDS


def test_a_hand_of_which_no_more_is_heard_is_lost_after_half_of_the_longest_gap() -> None:
    own = monitor(NEAR)
    take(own, *seen(range(20)), *(line(tick) for tick in range(20, 60)))
    assert own.claims[0].verdict is Verdict.INCONCLUSIVE
    assert own.counts.lost == 40 - 12  # 100 ms are twelve ticks and a half
    take(own, *seen(range(60, 70)))
    assert own.claims[0].latest is Verdict.HOLDS
    assert own.claims[0].verdict is Verdict.INCONCLUSIVE  # for good: nobody saw it meanwhile


def test_one_of_two_hands_is_enough_to_lose() -> None:
    own = monitor(NEAR, hands=("right", "left"))
    take(own, *seen(range(20), ("right", "left")))
    assert own.claims[0].latest is Verdict.HOLDS
    take(own, *seen(range(20, 50), ("right",)))
    assert own.claims[0].latest is Verdict.INCONCLUSIVE


def test_joints_that_are_missing_are_counted_and_bridged_as_far_as_is_said() -> None:
    own = monitor(LOW)
    take(own, *seen(range(10)), *seen(range(15, 20)))
    assert (own.counts.missing, own.counts.ticks) == (5, 20)
    assert own.claims[0].verdict is Verdict.HOLDS
    take(own, *seen(range(40, 45)))
    assert own.claims[0].verdict is Verdict.INCONCLUSIVE


def test_late_and_repeated_lines_are_counted_and_left_out() -> None:
    own = monitor(LOW)
    take(own, *seen([0, 1, 2, 1, 2, 3]))
    assert (own.counts.late, own.counts.repeated, own.counts.out_of_order) == (2, 2, 2)  # joints and hand
    assert own.counts.ticks == 4


def test_an_elbow_of_a_late_hand_is_late_too() -> None:
    """A row of the log has both, and its times rise."""
    own = monitor(NEAR)
    without = {"hand_position_in_base_m": PLACE["hand_position_in_base_m"]}
    take(
        own, line(0, hands={"hand": PLACE}), line(2, hands={"hand": without}), line(1, hands={"hand": PLACE})
    )
    hand, elbow = own._hands["hand"]
    assert elbow is not None
    assert (len(hand.samples), len(elbow.samples)) == (2, 1)
    assert own.counts.late == 2  # joints and hand


def test_lines_that_wait_are_put_in_order() -> None:
    lines = seen(range(30))
    for k in range(0, 28, 3):
        lines[k], lines[k + 2] = lines[k + 2], lines[k]
    waiting, straight = monitor(NEAR, wait_s=0.05), monitor(NEAR)
    take(waiting, *lines)
    list(waiting.end())
    take(straight, *seen(range(30)))
    assert waiting.counts.out_of_order
    assert (waiting.counts.late, waiting.counts.ticks) == (0, 30)
    assert waiting.verdicts() == straight.verdicts()


def test_nothing_at_all_is_inconclusive_until_something_comes() -> None:
    own = monitor(LOW)
    assert not list(own.silent())
    take(own, *seen(range(10)))
    (change,) = own.silent()
    assert change.verdict is Verdict.INCONCLUSIVE
    assert "no joints that can be used came for 100 ms" in change.reason
    assert not list(own.silent())
    changes = take(own, *seen(range(10, 50)))
    assert changes[-1].verdict is Verdict.HOLDS


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (b"garbage", "a JSON object with time_s"),
        (b"[1, 2]", "a JSON object with time_s"),
        (b'{"time_s": NaN}', "a JSON object with time_s"),
        (b'{"time_s": 1e999}', "a JSON object with time_s"),
        (b"\xff\xfe", "a JSON object with time_s"),
        (b'{"joint_position_rad": [0]}', "time_s"),
        (line(3, joint_position_rad=[0.0] * 5), "6 numbers"),
        (line(3, joint_position_rad=[90.0] * 6), "at most 25.13"),
        (line(3, joint_position_rad=[*JOINTS[:5], None]), "a JSON object with time_s"),
        (line(3, joint_position_rad=[*JOINTS[:5], 2.5]), "a sample that the stated speeds allow"),
        (line(3, hands={"left": PLACE}), "hands that the monitor was told of: hand"),
        (line(3, hands={"hand": {"hand_position_in_base_m": [900, 1, 2]}}), "places within 10 m"),
        (
            line(3, hands={"hand": PLACE | {"hand_position_in_base_m": [0.1, 0, 0]}}),
            "a sample that the stated speeds allow",
        ),
        (line(3, gripper=1), "a JSON object with time_s"),
        (line(10_000), "within 60 s of the latest one"),
        (b" " * 70_000, "at most 65,536 characters"),
    ],
)
def test_a_line_that_cannot_be_used_is_named_counted_and_does_no_harm(bad: bytes, words: str) -> None:
    own = monitor(LOW)
    take(own, *seen(range(3)))
    with pytest.raises(StreamError, match="line 4 of the stream") as told:
        take(own, bad)
    assert words in str(told.value)
    assert own.counts.refused == 1
    take(own, *seen(range(4, 20)))
    assert own.claims[0].verdict is Verdict.HOLDS


def test_a_hand_that_jumps_is_lost_at_once() -> None:
    own = monitor(NEAR)
    take(own, *seen(range(20)))
    far = PLACE | {"hand_position_in_base_m": [0.2, 0.9, 0.4]}
    with pytest.raises(StreamError, match=r"hands\.hand\.hand_position_in_base_m"):
        take(own, line(20, hands={"hand": far}))
    assert own.claims[0].latest is Verdict.INCONCLUSIVE


def monitor_with(text: str, tmp_path: Path) -> Monitor:
    """Return a monitor of a cell that its own LOG.yaml describes."""
    file = tmp_path / "LOG.yaml"
    file.write_text(f"{text}robot: UR10\nclaims: [{LOW}]\n")
    return Monitor(cell=read_cell(file), wait_s=0.0)


NO_FORM = """log: {joints: none, hands: {hand: none}, period: 8 ms}
joints: {known to: 0.1 deg, longest gap: 100 ms}
hands: {forearm: none, frame: base, known to: 5 mm, moves at most: 0.1 m/s, longest gap: 100 ms}
clock: {hands are ahead by: 0 ms, known to: 0 ms}
"""


def test_a_hand_that_is_faster_than_stated_is_lost_although_each_step_is_within_its_error(
    tmp_path: Path,
) -> None:
    """At 0.5 m/s a step of 8 ms is 4 mm, less than twice 5 mm; 0.1 m/s allows it, and 32 mm in 64 ms not."""
    own = monitor_with(NO_FORM, tmp_path)
    refused = []
    for tick in range(60):
        place = {"hand_position_in_base_m": [1.1 + 0.004 * tick, 0.2, 0.4]}
        try:
            take(own, line(tick, hands={"hand": place}))
        except StreamError as error:
            refused.append((tick, str(error)))
    assert refused[0][0] <= 8
    assert "its limit is 0.1 m/s" in refused[0][1]
    assert len(refused) > 40
    slow = monitor_with(NO_FORM, tmp_path)
    for tick in range(200):
        place = {"hand_position_in_base_m": [1.1 + 0.0008 * tick, 0.2, 0.4]}
        take(slow, line(tick, hands={"hand": place}))
    assert slow.counts.refused == 0


@pytest.mark.parametrize(("rate_radps2", "refused"), [(2.0, True), (0.5, False)])
def test_joints_that_accelerate_more_than_stated_are_refused(
    rate_radps2: float, refused: bool, tmp_path: Path
) -> None:
    """Three neighbours hide 2 rad/s2 behind the errors of their positions; samples far apart do not."""
    joints = "joints: {known to: 0.1 deg, longest gap: 100 ms, accelerate at most: 57.3 deg/s2}"
    own = monitor_with(NO_FORM.replace(NO_FORM.splitlines()[1], joints), tmp_path)
    for tick in range(100):
        angle = JOINTS[0] + rate_radps2 * (0.008 * tick) ** 2 / 2.0
        with suppress(StreamError):
            take(own, line(tick, joint_position_rad=[angle, *JOINTS[1:]]))
    assert (own.counts.refused > 0) is refused


@given(st.integers(1, 300))
def test_samples_of_each_power_of_two_before_the_next_one_are_kept(count: int) -> None:
    earlier = EarlierSamples(1)
    for number in range(count):
        earlier.add(number, np.array([float(number)]))
    times_ns, values = earlier.kept_samples()
    assert (times_ns == values[..., 0]).all()
    for level, (later, former) in enumerate(times_ns.T.tolist()):
        last = (count - 1) >> level << level
        assert (later, former) == (last, max(last - (1 << level), 0))


NO_NUMBERS = [float("nan")] * 6


@pytest.mark.parametrize(
    "rest",
    [
        [json.dumps({"time_s": 100.0 + k * 0.008, "hands": {"hand": PLACE}}).encode() for k in range(20, 60)],
        [line(k, joint_position_rad=NO_NUMBERS) for k in range(20, 60)],
        [line(19)] * 40,
    ],
    ids=["hands alone", "joints that are no numbers", "a clock that stands"],
)
def test_a_stream_that_ends_without_joints_holds_nothing(rest: list[bytes]) -> None:
    own = monitor(LOW)
    take(own, *seen(range(20)))
    assert [change.verdict for change in own.verdicts()] == [Verdict.HOLDS]
    for one in rest:
        with suppress(StreamError):
            take(own, one)
    *_, change = own.end()
    assert (change.verdict, own.counts.silent) == (Verdict.INCONCLUSIVE, 1)
    assert [change.verdict for change in own.verdicts()] == [Verdict.INCONCLUSIVE]


@pytest.mark.parametrize("rest", [[], [line(k, joint_position_rad=NO_NUMBERS) for k in range(20, 30)]])
def test_one_that_ends_within_their_longest_gap_holds_what_it_held(rest: list[bytes]) -> None:
    own = monitor(LOW)
    take(own, *seen(range(20)))
    for one in rest:
        with suppress(StreamError):
            take(own, one)
    assert not list(own.end())
    assert [change.verdict for change in own.verdicts()] == [Verdict.HOLDS]


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        ("always servoing", "a signal that this stream has"),
        ("always for 2 s (always hand distance > 50 mm)", "which only the end of the run decides"),
        ("always for 1 h hand distance > 50 mm", "units"),
        ("always for 10 min hand distance > 50 mm", "windows that reach at most"),
        ("always for 1 ms from here", "always"),
    ],
)
def test_what_cannot_be_told_in_bounded_memory_or_at_all_is_refused_with_the_reason(
    claim: str, words: str
) -> None:
    with pytest.raises(FormulaError) as told:
        monitor(claim)
    assert words in str(told.value)


def test_what_is_remembered_does_not_grow_with_the_run() -> None:
    own = monitor(NEAR)

    def sizes() -> list[int]:
        hand, elbow = own._hands["hand"]
        assert elbow is not None
        kept = [
            own._moments,
            hand.samples,
            elbow.samples,
            own._waiting,
            hand._within._off,
            own._joints._bends,
        ]
        return [len(one) for one in kept]

    take(own, *seen(range(150)))
    before = sizes()
    take(own, *seen(range(150, 400)))
    assert sizes() == before


@pytest.mark.parametrize("pair", [(PLACE, None), (None, PLACE), (PLACE, PLACE)])
def test_a_line_in_which_a_name_occurs_twice_is_refused_and_counted(pair: tuple[object, object]) -> None:
    """JSON has no word on which of them counts, and the last one may be the one that is far away."""
    own = monitor(NEAR)
    take(own, *seen(range(20)))
    one, other = map(json.dumps, pair)
    twice = f'{{"time_s": 100.16, "hands": {{"hand": {one}, "hand": {other}}}}}'
    with pytest.raises(StreamError, match="each name once"):
        take(own, twice.encode())
    with pytest.raises(StreamError, match="each name once"):
        take(own, b'{"time_s": 100.16, "time_s": 100.168}')
    assert own.counts.refused == 2


@pytest.mark.parametrize("body", ["hand", "elbow"])
def test_zeros_are_a_word_for_not_seen(body: str) -> None:
    own = monitor(NEAR)
    take(own, *seen(range(20)))
    nowhere = PLACE | {f"{body}_position_in_base_m": [0.0, 0.0, 0.0]}
    take(own, *(line(tick, hands={"hand": nowhere}) for tick in range(20, 50)))
    assert own.claims[0].latest is Verdict.INCONCLUSIVE
    assert own.counts.refused == 0
