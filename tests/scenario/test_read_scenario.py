from __future__ import annotations

from math import radians
from pathlib import Path

import pytest
from scenario_texts import FILE, SHA256, SHORTEST, VALID, changed, line_of, parse, refusal

from safety_harness.base.exceptions import Place
from safety_harness.base.settings import (
    DEFAULTS,
    DetectorKind,
    HandSensorKind,
    ImageSource,
    InteractionChoice,
)
from safety_harness.scenario.model import (
    DEFAULT_AVOIDER,
    REACHING_MPS2,
    Claim,
    JoinedHand,
    JointStart,
    MovingHand,
    OffsetStart,
    PoseStart,
    RecordedHand,
    Verdict,
)
from safety_harness.scenario.moves import (
    REACHING_MPS,
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
)


class TestWhatAFileSays:
    scenario = parse(VALID)

    def test_the_head(self) -> None:
        s = self.scenario
        assert (s.name, s.title) == ("reach", "a hand reaches for the tool and withdraws")
        assert s.about == "Why a safety engineer would try this."
        assert (s.duration_s, s.seed, s.avoider, s.file) == (12.0, 7, "nearest candidate", FILE)

    def test_the_start(self) -> None:
        assert self.scenario.start == OffsetStart(
            offset_in_base_m=(0.04, -0.12, 0.06), tilt_in_tcp_rad=(0.0, radians(3.0), 0.0)
        )

    def test_the_moving_hand(self) -> None:
        assert self.scenario.hands[0] == MovingHand(
            name="right",
            starts_at_in_base_m=(1.2, -0.7, 0.1),
            elbow_towards_in_base_m=(1.6, -1.2, 0.3),
            moves=(
                Wait(duration_s=1.0),
                MoveTo(position_in_base_m=(0.84, -0.35, 0.005), speed_mps=0.5),
                ReachForTcp(
                    speed_mps=2.0,
                    until_distance_m=0.1,
                    at_most_s=3.0,
                    hesitation=Hesitation(distance_m=0.3, duration_s=0.4),
                ),
                ReachForObject(speed_mps=0.8, until_distance_m=0.15, at_most_s=2.0),
                Wander(speed_mps=0.9, corners_in_base_m=((0.9, -0.6, 0.0), (1.1, -0.4, 0.2)), duration_s=3.0),
                Sweep(
                    speed_mps=0.7, from_in_base_m=(0.9, -0.3, 0.05), to_in_base_m=(0.9, -0.7, 0.05), times=3
                ),
                FollowTcp(speed_mps=0.3, distance_m=0.25, duration_s=4.0),
                Withdraw(speed_mps=1.6),
            ),
            shift_in_base_m=(0.02, 0.0, 0.0),
            delay_s=0.25,
            max_speed_mps=2.2,
            max_acceleration_mps2=8.0,
            tremor=Tremor(amplitude_m=0.003, rate_hz=9.0),
        )

    def test_the_recorded_hand(self) -> None:
        hand = self.scenario.hands[1]
        assert isinstance(hand, RecordedHand)
        assert (hand.name, hand.track, hand.elbow_track) == ("left hand", "left_hand", "right_elbow")
        assert (hand.recording, hand.motion.sha256) == (Path("walks/walk.csv"), SHA256)
        assert (hand.turn_rad, hand.speed_factor, hand.from_s, hand.to_s) == (radians(90.0), 2.0, 0.2, 1.5)
        assert (hand.longest_gap_s, hand.fastest_jump_mps) == (0.1, 4.0)
        assert tuple(hand.motion.hand_position_in_base_m[0]) == (1.4, -0.9, 0.2)

    def test_the_settings(self) -> None:
        s = self.scenario.settings
        assert (s.hand_sensor.kind, s.hand_sensor.detector) == (
            HandSensorKind.OVERHEAD,
            DetectorKind.RENDERED,
        )
        assert (s.hand_sensor.pixel_noise_px, s.hand_sensor.depth_noise_per_m) == (2.0, 0.0025)
        assert (s.hand_sensor.dropout_probability, s.hand_sensor.rate_hz) == (0.05, 30.0)
        assert s.hand_sensor.latency_s == 0.033
        assert (s.camera.source, s.camera.width_px) == (ImageSource.RASTER, 320)
        assert s.camera.calibration_error_offset_m == (0.001, 0.0, 0.0)
        assert s.camera.calibration_error_rotation_rad == (0.0, 0.0, radians(1.0))
        assert s.avoidance.critical_distance_m == 0.45
        assert s.object.polygon_m == ((-0.06, -0.04), (0.1, -0.04), (-0.04, 0.08))
        assert (s.object.position_in_base_m, s.object.yaw_rad) == ((0.71, 0.04, -0.3), radians(20.0))
        assert s.servo.interaction is InteractionChoice.MEAN

    def test_what_a_file_does_not_name_keeps_its_default(self) -> None:
        s = self.scenario.settings
        assert s.braking == DEFAULTS.braking
        assert s.avoidance.radius_m == DEFAULTS.avoidance.radius_m
        assert s.camera.focal_px == DEFAULTS.camera.focal_px

    def test_the_claims_in_their_order(self) -> None:
        assert self.scenario.claims == (
            Claim(sentence="hand distance never below 50 mm", expected=Verdict.HOLDS),
            Claim(sentence="repulsive poses reachable", expected=Verdict.VIOLATED),
            Claim(sentence="gain switch reached", expected=Verdict.INCONCLUSIVE),
        )

    @pytest.mark.parametrize(
        ("name", "part"),
        [
            ("tcp start", "tcp start:"),
            ("tcp start.tilt", "tilt:"),
            ("hands[0].moves[1].speed", "speed: 0.5"),
            ("hands[1].starts at", "starts at: [1.4"),
            ("camera.calibration error.offset", "calibration error"),
            ("settings.servo.interaction", "interaction"),
            ("claims", "claims:"),
        ],
    )
    def test_every_field_has_a_place_for_errors_found_later(self, name: str, part: str) -> None:
        assert self.scenario.place(name) == Place(file=FILE, line=line_of(VALID, part), field=name)

    def test_every_claim_has_its_place(self) -> None:
        assert [claim.place.line for claim in self.scenario.claims] == [
            line_of(VALID, claim.sentence) for claim in self.scenario.claims
        ]


def test_the_shortest_scenario_takes_every_default() -> None:
    scenario = parse(SHORTEST)
    assert (scenario.about, scenario.seed, scenario.hands) == ("", 0, ())
    assert scenario.avoider == DEFAULT_AVOIDER
    assert scenario.start == OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0))
    assert scenario.settings == DEFAULTS


def test_joints_are_another_way_to_start() -> None:
    joints = "joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, 0.5 rad]"
    start = parse(SHORTEST.replace("offset: [0 mm, 0 mm, 0 mm]", joints)).start
    assert start == JointStart(
        joint_position_rad=(*(radians(angle) for angle in (-12.0, -73.0, 113.0, -130.0, -90.0)), 0.5)
    )


def test_a_pose_is_another_way_to_start() -> None:
    pose = "position: [0.7 m, 50 mm, 400 mm], tilt: [0 deg, 3 deg, 0 deg]"
    start = parse(SHORTEST.replace("offset: [0 mm, 0 mm, 0 mm]", pose)).start
    assert start == PoseStart(position_in_base_m=(0.7, 0.05, 0.4), tilt_in_tcp_rad=(0.0, radians(3.0), 0.0))
    upright = parse(SHORTEST.replace("offset: [0 mm, 0 mm, 0 mm]", "position: [0 m, 0 m, 1 m]")).start
    assert upright == PoseStart(position_in_base_m=(0.0, 0.0, 1.0))


HANDS = """\
hands:
  - hand: right
    starts at: [1.2 m, -0.7 m, 100 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves: []
  - hand: left
    together with: right
    apart: [0 mm, 300 mm, 20 mm]
    elbow towards: [1.6 m, 0.9 m, 300 mm]
"""


def test_a_second_hand_can_hold_the_same_part() -> None:
    scenario = parse(SHORTEST + HANDS)
    right, left = scenario.hands
    assert left == JoinedHand(
        name="left",
        joined_to="right",
        apart_in_base_m=(0.0, 0.3, 0.02),
        elbow_towards_in_base_m=(1.6, 0.9, 0.3),
    )
    assert scenario.leader(left) is right
    assert scenario.leader(right) is right


@pytest.mark.parametrize(
    ("old", "new", "field", "expected"),
    [
        ("with: right", "with: rihgt", "together with", 'the name of a hand that is written before: "right"'),
        ("with: right", "with: left", "together with", 'the name of a hand that is written before: "right"'),
        ("    apart: [0 mm, 300 mm, 20 mm]\n", "", "apart", 'the key "apart"'),
        ("apart: [0 mm,", "apart: [0,", "apart[0]", "a length such as 80 mm"),
        ("    apart", "    moves: []\n    apart", "moves", "one of the keys hand, together with, apart"),
    ],
)
def test_a_hand_that_cannot_hold_the_same_part_is_refused(
    old: str, new: str, field: str, expected: str
) -> None:
    error = refusal(SHORTEST + HANDS.replace(old, new))
    assert error.place.field == f"hands[1].{field}"
    assert error.expected.startswith(expected)


def test_a_hand_is_as_fast_as_one_that_reaches_unless_the_file_says_more() -> None:
    right = parse(SHORTEST + HANDS).hands[0]
    assert isinstance(right, MovingHand)
    assert (right.max_speed_mps, right.max_acceleration_mps2) == (REACHING_MPS, REACHING_MPS2) == (2.0, 10.0)
    fast = SHORTEST + HANDS.replace("moves: []", "moves: [{move to: [1 m, 0 m, 0 m], speed: 2.5 m/s}]")
    error = refusal(fast)
    assert error.place.field == "hands[0].moves[0].speed"
    assert error.expected == "a speed of at most 2 m/s, the hand's bound"
    assert "speed at most" in error.hint
    assert parse(fast.replace("    moves:", "    speed at most: 2.5 m/s\n    moves:")).hands[0]


def test_a_recording_is_shifted_delayed_and_held_to_its_bound() -> None:
    plain = parse(VALID).hands[1]
    assert isinstance(plain, RecordedHand)
    assert plain.motion.max_speed_mps > REACHING_MPS
    error = refusal(changed("    speed at most: 4 m/s\n", ""))
    assert error.place.field == "hands[1].speed factor"
    assert error.hint == "speed at most: 2.1 m/s, if it is meant"
    asked = changed("speed factor: 2.0\n    speed at most: 4 m/s\n", "speed at most: 1 m/s\n")
    assert refusal(asked).place.field == "hands[1].speed at most"
    assert parse(changed("speed factor: 2.0\n    speed at most: 4 m/s\n", "speed factor: 1.0\n"))
    later = "    shifted by: [0 m, 0.5 m, 0 m]\n    delayed by: 2 s\n    track: left hand\n"
    moved = parse(changed("    track: left hand\n", later)).hands[1]
    assert isinstance(moved, RecordedHand)
    assert (moved.shift_in_base_m, moved.delay_s) == ((0.0, 0.5, 0.0), 2.0)
    assert moved.motion.time_s[1:] == pytest.approx(plain.motion.time_s + 2.0)
    for name in ("hand_position_in_base_m", "elbow_position_in_base_m"):
        path, before = getattr(moved.motion, name), getattr(plain.motion, name)
        assert path[1:] == pytest.approx(before + (0.0, 0.5, 0.0))
        assert tuple(path[0]) == tuple(path[1])


def test_a_rate_can_be_every_tick() -> None:
    assert parse(SHORTEST + "camera: {rate: every tick}\n").settings.camera.rate_hz is None


def test_the_same_side_of_a_recording_gives_the_elbow() -> None:
    hand = parse(
        changed("    track: left hand\n    elbow track: right elbow\n", "    track: right hand\n")
    ).hands[1]
    assert isinstance(hand, RecordedHand)
    assert hand.elbow_track == "right_elbow"


def test_a_fixed_elbow_replaces_a_recorded_one() -> None:
    text = changed(
        "    track: left hand\n    elbow track: right elbow\n",
        "    track: right hand\n    elbow towards: [2 m, -2 m, 0 m]\n",
    )
    hand = parse(text).hands[1]
    assert isinstance(hand, RecordedHand)
    assert (hand.elbow_track, hand.elbow_towards_in_base_m) == (None, (2.0, -2.0, 0.0))
