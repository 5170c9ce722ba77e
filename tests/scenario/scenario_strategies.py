"""Scenarios at random: every kind of start, hand, move and setting that a file can give."""

from __future__ import annotations

import hashlib
from dataclasses import fields, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from safety_harness.base.settings import DEFAULTS, DecisionCost, DecisionTimes, Settings, Vector3
from safety_harness.scenario.codec import Key, QuantityValue, Several
from safety_harness.scenario.faults import EVERY_FAULT, MOST_FALSE_HANDS, OWN_KEYS, FalseHand, Fault, Joint
from safety_harness.scenario.fields import LARGEST_COORDINATE_M
from safety_harness.scenario.model import (
    ACCELERATIONS_MPS2,
    LARGEST_FACTOR,
    NOT_LOADED,
    Claim,
    HandTrajectory,
    JoinedHand,
    JointStart,
    MovingHand,
    OffsetStart,
    PoseStart,
    RecordedHand,
    Robot,
    Scenario,
    Verdict,
)
from safety_harness.scenario.moves import (
    FASTEST_MPS,
    LONGEST_S,
    MOST_TIMES,
    TREMORS_HZ,
    TREMORS_M,
    FollowTcp,
    Hesitation,
    MoveTo,
    ReachForObject,
    ReachForTcp,
    Sweep,
    Tremor,
    Wait,
    Wander,
    Withdraw,
    shifted,
)
from safety_harness.scenario.read import MOST_TICKS
from safety_harness.scenario.recording import load_recording, parse_recording
from safety_harness.scenario.settings_keys import setting_keys
from safety_harness.scenario.units import TIME


def csv_of(
    time_s: np.ndarray, tracks: dict[str, np.ndarray], *, empty: dict[str, set[int]] | None = None
) -> bytes:
    """A recording: tracks (n, 3) over time (n,); rows in ``empty[track]`` have empty cells."""
    header = ["time_s", *(f"{name}_{axis}_m" for name in tracks for axis in "xyz")]
    lines = [",".join(header)]
    for row, time in enumerate(time_s):
        cells = [repr(float(time))]
        for name, positions in tracks.items():
            gap = row in (empty or {}).get(name, set())
            cells += ["" if gap else repr(float(value)) for value in positions[row]]
        lines.append(",".join(cells))
    return ("\n".join(lines) + "\n").encode()


def _walk() -> bytes:
    """Two seconds of a hand with an elbow, and of another without; a few gaps."""
    time_s = np.arange(201) / 100
    hand = np.stack([0.3 * time_s, np.sin(time_s), 0.1 * np.cos(2 * time_s)], axis=1)
    tracks = {"right_hand": hand, "right_elbow": hand + np.array([0.2, 0.1, 0.1]), "left_hand": hand - 0.5}
    return csv_of(time_s, tracks, empty={"right_hand": {20, 21, 50}, "right_elbow": {50, 100}})


RECORDING = _walk()
RECORDINGS = {hashlib.sha256(RECORDING).hexdigest(): RECORDING}

durations = st.floats(min_value=0.0, max_value=LONGEST_S, exclude_min=True, allow_subnormal=True)
speeds = st.floats(min_value=0.0, max_value=FASTEST_MPS, exclude_min=True)
distances = st.floats(min_value=0.0, max_value=LARGEST_COORDINATE_M)
angles = st.floats(min_value=-6.28, max_value=6.28)


def vectors(numbers: st.SearchStrategy[float]) -> st.SearchStrategy[Vector3]:
    return st.tuples(numbers, numbers, numbers)


points = vectors(st.floats(min_value=-LARGEST_COORDINATE_M, max_value=LARGEST_COORDINATE_M))
sentences = st.text(min_size=1, max_size=40).filter(lambda text: text.strip() and text.isprintable())
titles = st.text(st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp")), min_size=1).filter(str.strip)
prose = st.text(
    st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp"), include_characters="\n"), max_size=200
)


@st.composite
def hesitations(draw: st.DrawFn) -> dict[str, Any]:
    """Where a reach ends, and where it hesitates before that, if it does."""
    until_m = draw(st.floats(min_value=0.0, max_value=9.0))
    stop_m = draw(st.none() | st.floats(min_value=until_m, max_value=10.0, exclude_min=True))
    hesitation = None if stop_m is None else Hesitation(distance_m=stop_m, duration_s=draw(durations))
    return {"until_distance_m": until_m, "at_most_s": draw(durations), "hesitation": hesitation}


two_points = st.tuples(points, points).filter(lambda pair: np.linalg.norm(np.subtract(*pair)) > 0.01)
moves = st.one_of(
    st.builds(MoveTo, position_in_base_m=points, speed_mps=speeds),
    st.builds(Wait, duration_s=durations),
    st.builds(lambda v, how: ReachForTcp(speed_mps=v, **how), speeds, hesitations()),
    st.builds(lambda v, how: ReachForObject(speed_mps=v, **how), speeds, hesitations()),
    st.builds(FollowTcp, speed_mps=speeds, distance_m=distances, duration_s=durations),
    st.builds(Wander, speed_mps=speeds, corners_in_base_m=two_points, duration_s=durations),
    st.builds(
        lambda v, pair, times: Sweep(speed_mps=v, from_in_base_m=pair[0], to_in_base_m=pair[1], times=times),
        speeds,
        two_points,
        st.integers(min_value=1, max_value=MOST_TIMES),
    ),
    st.builds(Withdraw, speed_mps=speeds),
)
tremors = st.builds(
    Tremor,
    amplitude_m=st.floats(min_value=TREMORS_M[0], max_value=TREMORS_M[1]),
    rate_hz=st.floats(min_value=TREMORS_HZ[0], max_value=TREMORS_HZ[1]),
)
starts = st.one_of(
    st.builds(OffsetStart, offset_in_base_m=points, tilt_in_tcp_rad=vectors(angles)),
    st.builds(PoseStart, position_in_base_m=points, tilt_in_tcp_rad=vectors(angles)),
    st.builds(JointStart, joint_position_rad=st.tuples(*[angles] * 6)),
)


def number_of(key: Key) -> QuantityValue:
    """The value of a setting, or each of its numbers; for one that is a word or a text, any time."""
    value: Any = key.value
    while isinstance(value, Several):
        value = value.of
    return (
        value if isinstance(value, QuantityValue) else QuantityValue(TIME, least=TIME.least, most=TIME.most)
    )


def setting_values(key: Key, default: Any) -> st.SearchStrategy[Any]:
    """Values that a file may give for one field of the settings."""
    bounds = number_of(key)
    number = st.floats(min_value=bounds.least, max_value=bounds.most)
    if isinstance(default, DecisionCost):
        times = st.lists(number, min_size=1, max_size=2).map(sorted).map(tuple)
        return st.sampled_from(DecisionCost) | st.builds(DecisionTimes, quantiles_s=times)
    if isinstance(default, Enum):
        return st.sampled_from(type(default))
    if isinstance(default, int):
        assert bounds.least is not None
        assert bounds.most is not None
        return st.integers(min_value=int(bounds.least), max_value=int(bounds.most))
    if isinstance(default, tuple) and isinstance(default[0], tuple):
        return st.lists(st.tuples(number, number), min_size=3, max_size=6).map(tuple)
    if isinstance(default, tuple):
        return st.tuples(*[number] * len(default))
    return st.none() | number if default is None else number


def _groups() -> dict[str, st.SearchStrategy[Any]]:
    strategies = {}
    for name in (one.name for one in fields(DEFAULTS)):
        group = getattr(DEFAULTS, name)
        values = {
            key.attribute: setting_values(key, getattr(group, key.attribute))
            for key in setting_keys(type(group))
        }
        strategies[name] = st.fixed_dictionaries({}, optional=values).map(
            lambda changes, group=group: replace(group, **changes)
        )
    return strategies


settings = st.fixed_dictionaries({}, optional=_groups()).map(lambda groups: replace(DEFAULTS, **groups))


@st.composite
def moving_hands(draw: st.DrawFn) -> MovingHand:
    start, elbow, shift = draw(points), draw(points), draw(points)
    taken = (start, shifted(start, shift))
    if elbow in taken:
        beside = ((start[0] / 2 + x, start[1], start[2]) for x in (1.0, 2.0, 3.0))
        elbow = next(point for point in beside if point not in taken)
    done = tuple(draw(st.lists(moves, max_size=4)))
    tremor = draw(st.none() | tremors)
    fastest = max((getattr(move, "speed_mps", 0.0) for move in done), default=0.0)
    least = fastest + (tremor.max_speed_mps if tremor else 0.0)
    if least > FASTEST_MPS * 0.999:
        done, least = (), tremor.max_speed_mps if tremor else 0.0
    return MovingHand(
        name=draw(sentences),
        starts_at_in_base_m=start,
        elbow_towards_in_base_m=elbow,
        moves=done,
        shift_in_base_m=shift,
        delay_s=draw(st.floats(min_value=0.0, max_value=LONGEST_S)),
        max_speed_mps=draw(st.floats(min_value=least * 1.0001 + 1e-9, max_value=FASTEST_MPS)),
        max_acceleration_mps2=draw(st.floats(*ACCELERATIONS_MPS2)),
        tremor=tremor,
    )


@st.composite
def recorded_hands(draw: st.DrawFn, forearm_length_m: float) -> RecordedHand:
    recording = parse_recording(RECORDING, Path("walk.csv"))
    track, elbow_track = draw(
        st.sampled_from([("right_hand", "right_elbow"), ("right_hand", None), ("left_hand", "right_elbow")])
    )
    begin = draw(st.none() | st.floats(min_value=0.0, max_value=0.9))
    usage: dict[str, Any] = {
        "track": track,
        "elbow_track": elbow_track,
        "elbow_towards_in_base_m": None,
        "starts_at_in_base_m": draw(points),
        "turn_rad": draw(angles),
        "speed_factor": draw(st.floats(min_value=0.01, max_value=LARGEST_FACTOR)),
        "from_s": begin,
        "to_s": draw(st.none() | st.floats(min_value=1.0, max_value=2.0)),
        "longest_gap_s": draw(st.floats(min_value=0.1, max_value=10.0)),
        "fastest_jump_mps": draw(st.floats(min_value=2.0, max_value=10.0)),
    }
    if elbow_track is None:
        usage["elbow_towards_in_base_m"] = draw(st.sampled_from([(-10.0, 10.0, 5.0), (0.1, 0.2, 9.9)]))
        usage["starts_at_in_base_m"] = draw(vectors(st.floats(min_value=-5.0, max_value=5.0)))
    shift_in_base_m = draw(vectors(st.floats(min_value=-1.0, max_value=1.0)))
    delay_s = draw(st.sampled_from([0.0, 0.5, 3600.0]))
    hand = RecordedHand(
        name=draw(sentences),
        recording=Path("walks/walk.csv"),
        motion=NOT_LOADED,
        shift_in_base_m=shift_in_base_m,
        delay_s=delay_s,
        max_speed_mps=20.0 if usage["speed_factor"] > 1.0 else draw(st.sampled_from([None, 20.0])),
        **usage,
    )
    return replace(hand, motion=load_recording(recording, hand, forearm_length_m=forearm_length_m))


def fault_values(key: Key) -> st.SearchStrategy[Any]:
    """Values that a file may give for one key of a fault."""
    if isinstance(key.value, Several):
        assert isinstance(key.value.of, QuantityValue)
        return vectors(st.floats(min_value=key.value.of.least, max_value=key.value.of.most))
    if isinstance(key.value, QuantityValue):
        return st.floats(min_value=0.0, max_value=key.value.most, exclude_min=True)
    return st.sampled_from(Joint)


@st.composite
def faults(draw: st.DrawFn, duration_s: float) -> Fault:
    kind = draw(st.sampled_from(EVERY_FAULT))
    begin_s = draw(st.just(0.0) | st.floats(min_value=0.0, max_value=duration_s, exclude_max=True))
    until = st.floats(min_value=begin_s, max_value=2 * LONGEST_S, exclude_min=True)
    ends: st.SearchStrategy[dict[str, float]] = st.one_of(
        st.just({}), durations.map(lambda s: {"for_s": s}), until.map(lambda s: {"until_s": s})
    )
    values = {key.attribute: draw(fault_values(key)) for key in OWN_KEYS[kind].keys}
    fault: Fault = kind(**values, **draw(ends), from_s=begin_s)
    return fault


def _few_false_hands(several: list[Fault]) -> bool:
    return sum(isinstance(fault, FalseHand) for fault in several) <= MOST_FALSE_HANDS


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    chosen: Settings = draw(settings)
    hand = moving_hands() | recorded_hands(chosen.hand.forearm_length_m)
    hands: list[HandTrajectory] = draw(st.lists(hand, max_size=2, unique_by=lambda one: one.name))
    if len(hands) == 2 and draw(st.booleans()):
        hands[1] = JoinedHand(
            name=hands[1].name,
            joined_to=hands[0].name,
            apart_in_base_m=draw(points),
            elbow_towards_in_base_m=draw(points),
        )
    claims = draw(st.dictionaries(sentences, st.sampled_from(Verdict), min_size=1, max_size=4))
    period_s = chosen.clock.control_period_s
    longest_s = min(LONGEST_S, MOST_TICKS * period_s)
    duration_s = draw(st.floats(min_value=period_s, max_value=longest_s))
    return Scenario(
        name="example",
        title=draw(titles),
        about=draw(prose),
        duration_s=duration_s,
        seed=draw(st.integers(min_value=0, max_value=2**63 - 1)),
        start=draw(starts),
        hands=tuple(hands),
        avoider=draw(sentences),
        claims=tuple(Claim(sentence=sentence, expected=verdict) for sentence, verdict in claims.items()),
        settings=chosen,
        robot=draw(st.sampled_from(Robot)),
        faults=tuple(draw(st.lists(faults(duration_s), max_size=4).filter(_few_false_hands))),
    )
