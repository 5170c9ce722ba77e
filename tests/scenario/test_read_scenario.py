from __future__ import annotations

import hashlib
import os
from dataclasses import fields
from math import radians
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scenario_strategies import RECORDING, RECORDINGS

from safety_harness.exceptions import InputError, Place, RecordingError, ScenarioError
from safety_harness.scenario.model import (
    Claim,
    FollowTcp,
    JointStart,
    MoveTo,
    MovingHand,
    OffsetStart,
    ReachForTcp,
    RecordedHand,
    Scenario,
    Verdict,
    Wait,
    Withdraw,
)
from safety_harness.scenario.read import MAX_BYTES, parse_scenario, read_scenario
from safety_harness.scenario.settings_keys import MAY_BE_NEGATIVE, MAY_BE_ZERO, setting_keys
from safety_harness.settings import DEFAULTS, DetectorKind, HandSensorKind, ImageSource, InteractionChoice

FILE = Path("folder/reach.yaml")
SHA256 = hashlib.sha256(RECORDING).hexdigest()
VALID = f"""\
scenario: a hand reaches for the tool and withdraws
about: >
  Why a safety engineer
  would try this.
duration: 12 s
seed: 7
tcp start:
  offset: [40 mm, -120 mm, 60 mm]      # from the desired pose
  tilt: [0 deg, 3 deg, 0 deg]
avoider: nearest candidate
hands:
  - hand: right
    starts at: [1.2 m, -0.7 m, 100 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves:
      - wait: 1 s
      - move to: [840 mm, -350 mm, 5 mm]
        speed: 0.5 m/s
      - reach for tcp: 2 m/s
        until: 100 mm
        at most: 3 s
      - follow tcp: 0.3 m/s
        keeping: 250 mm
        for: 4 s
      - withdraw: 1.6 m/s
  - recording: walks/walk.csv
    sha256: {SHA256}
    track: left hand
    elbow track: right elbow
    starts at: [1.4 m, -0.9 m, 200 mm]
    turned: 90 deg
    speed factor: 2.0
    from: 200 ms
    to: 1.5 s
    longest gap: 100 ms
    fastest jump: 4 m/s
hand sensor:
  kind: overhead
  detector: rendered
  pixel noise: 2 px
  depth noise: 0.0025 /m
  dropout: 5 %
  rate: 30 Hz
  latency: 33 ms
camera:
  source: raster
  width: 320 px
  calibration error: {{offset: [1 mm, 0 mm, 0 mm], rotation: [0 deg, 0 deg, 1 deg]}}
settings:
  avoidance: {{critical distance: 450 mm}}
  servo: {{interaction: mean}}
claims:
  hand distance never below 50 mm: holds
  repulsive poses reachable: violated
  gain switch reached: inconclusive
"""
SHORTEST = """\
scenario: nothing happens
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims: {gain switch reached: holds}
"""


def parse(text: str) -> Scenario:
    return parse_scenario(text, FILE, RECORDINGS)


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def refusal(text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        parse(text)
    assert isinstance(caught.value, ScenarioError | RecordingError)
    return caught.value


def changed(old: str, new: str) -> str:
    assert VALID.count(old) == 1, old
    return VALID.replace(old, new)


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
                ReachForTcp(speed_mps=2.0, until_distance_m=0.1, at_most_s=3.0),
                FollowTcp(speed_mps=0.3, distance_m=0.25, duration_s=4.0),
                Withdraw(speed_mps=1.6),
            ),
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
        assert (s.hand_sensor.kind, s.hand_sensor.detector) == (HandSensorKind.OVERHEAD, DetectorKind.RENDERED)
        assert (s.hand_sensor.pixel_noise_px, s.hand_sensor.depth_noise_per_m) == (2.0, 0.0025)
        assert (s.hand_sensor.dropout_probability, s.hand_sensor.rate_hz) == (0.05, 30.0)
        assert s.hand_sensor.latency_s == 0.033
        assert (s.camera.source, s.camera.width_px) == (ImageSource.RASTER, 320)
        assert s.camera.calibration_error_offset_m == (0.001, 0.0, 0.0)
        assert s.camera.calibration_error_rotation_rad == (0.0, 0.0, radians(1.0))
        assert s.avoidance.critical_distance_m == 0.45
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
    assert scenario.avoider == "opposite pose"
    assert scenario.start == OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0))
    assert scenario.settings == DEFAULTS


def test_joints_are_another_way_to_start() -> None:
    joints = "joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, 0.5 rad]"
    start = parse(SHORTEST.replace("offset: [0 mm, 0 mm, 0 mm]", joints)).start
    assert start == JointStart(
        joint_position_rad=(*(radians(angle) for angle in (-12.0, -73.0, 113.0, -130.0, -90.0)), 0.5)
    )


def test_a_rate_can_be_every_tick() -> None:
    assert parse(SHORTEST + "camera: {rate: every tick}\n").settings.camera.rate_hz is None


def test_the_same_side_of_a_recording_gives_the_elbow() -> None:
    hand = parse(changed("    track: left hand\n    elbow track: right elbow\n", "    track: right hand\n")).hands[1]
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


# (what is changed, into what, a text on the line of the error, field, expected begins, got begins)
MISTAKES: list[tuple[str, str, str, str, str, str]] = [
    ("duration: 12 s", "duration: 12", "duration", "duration", "a time such as 0.5 s", "12, which has no unit"),
    ("duration: 12 s", "duration: 12 m", "duration", "duration", "a time such as 0.5 s", "12 m"),
    ("duration: 12 s", "duration: nan s", "duration", "duration", "a time such as 0.5 s", "nan s"),
    ("duration: 12 s", "duration: 0 s", "duration", "duration", "a time such as 0.5 s, above 0 and at most 3600 s", "0 s"),
    ("duration: 12 s", "duration: 61 min", "duration", "duration", "a time such as 0.5 s, above 0", "61 min"),
    ("duration: 12 s", "duration: [12 s]", "duration", "duration", "a time such as 0.5 s", "a list of 1"),
    ("duration: 12 s", "duration:", "duration", "duration", "a time such as 0.5 s", "nothing"),
    ("duration: 12 s\n", "", "scenario", "duration", 'the key "duration"', "only scenario, about"),
    ("duration: 12 s", "durations: 12 s", "durations", "durations", "one of the keys scenario", 'the key "durations"'),
    ("seed: 7", "seed: 7.5", "seed", "seed", "a whole number from 0 to 9223372036854775807", "7.5"),
    ("seed: 7", "seed: -1", "seed", "seed", "a whole number from 0", "-1"),
    ("seed: 7", "seed: 99999999999999999999999", "seed", "seed", "a whole number from 0", "99999"),
    ("scenario: a hand reaches for the tool and withdraws", "scenario: ''", "scenario", "scenario", "a title", "nothing"),
    ("nearest candidate", '"nearest\\ncandidate"', "avoider", "avoider", "the name of an avoider: one line", "nearest"),
    ("[40 mm, -120 mm, 60 mm]", "[40 mm, -120 mm]", "offset", "tcp start.offset", "a list of three", "a list of 2"),
    ("[40 mm, -120 mm, 60 mm]", "[40, -120 mm, 60 mm]", "offset", "tcp start.offset[0]", "a length", "40, which has no"),
    ("[40 mm, -120 mm, 60 mm]", "[40 mm, -120 m, 60 mm]", "offset", "tcp start.offset[1]", "a length such as 80 mm, at", "-120"),
    ("3 deg, 0 deg]\n", "3 deg, 0 deg]\n  joints: []\n", "offset", "tcp start.offset", "either joints or an offset", "both"),
    ("3 deg", "3 mm", "tilt", "tcp start.tilt[1]", "an angle such as 30 deg", "3 mm"),
    ("    starts at: [1.2 m, -0.7 m, 100 mm]\n", "", "- hand: right", "hands[0].starts at", 'the key "starts at"', "only hand"),
    ("starts at: [1.2 m", "start at: [1.2 m", "start at: [1.2", "hands[0].start at", "one of the keys hand, starts at", "the key"),
    ("[1.6 m, -1.2 m, 300 mm]", "[1.2 m, -0.7 m, 100 mm]", "elbow towards", "hands[0].elbow towards", "a point other", "a list of 3"),
    ("speed: 0.5 m/s", "speed: 0 m/s", "speed: 0 m/s", "hands[0].moves[1].speed", "a speed such as 0.5 m/s, above 0", "0 m/s"),
    ("speed: 0.5 m/s", "speed: -0.5 m/s", "speed: -0.5", "hands[0].moves[1].speed", "a speed such as 0.5 m/s, above 0", "-0.5 m/s"),
    ("speed: 0.5 m/s", "sped: 0.5 m/s", "sped", "hands[0].moves[1].sped", "one of the keys move to, speed", 'the key "sped"'),
    ("        speed: 0.5 m/s\n", "", "move to", "hands[0].moves[1].speed", 'the key "speed"', "only move to"),
    ("- wait: 1 s", "- wiat: 1 s", "wiat", "hands[0].moves[0]", "one move: one of the keys", "the keys wiat"),
    ("- wait: 1 s", "- wait: 1 s\n        withdraw: 1 m/s", "wait", "hands[0].moves[0]", "one move: one", "the keys wait, withdraw"),
    ("- wait: 1 s", "- {}", "- {}", "hands[0].moves[0]", "one move: one of the keys", "an empty mapping"),
    ("- wait: 1 s", "- wait", "- wait", "hands[0].moves[0]", "a move: a mapping", "wait"),
    ("until: 100 mm", "until: -1 mm", "until", "hands[0].moves[2].until", "a length such as 80 mm, at least 0", "-1 mm"),
    ("for: 4 s", "for: 0 s", "for: 0", "hands[0].moves[3].for", "a time such as 0.5 s, above 0", "0 s"),
    ("hand: right", "hand: left hand", "recording:", "hands[1]", "another name for each hand", '"left hand" twice'),
    ("track: left hand", "track: left hnd", "recording", "left_hnd", "one of the tracks right_hand, right_elbow, left_hand", "left_hnd"),
    ("    elbow track: right elbow\n", "", "recording", "hands[1]", 'the key "elbow track" or "elbow towards"', "neither"),
    ("elbow track: right elbow", "elbow track: right elbow\n    elbow towards: [0 m, 0 m, 0 m]", "elbow towards: [0 m", "hands[1].elbow towards", "either", "both"),
    ("speed factor: 2.0", "speed factor: 0", "speed factor", "hands[1].speed factor", "a number such as 0.4, at least 0.01", "0"),
    ("turned: 90 deg", "turned: 90", "turned", "hands[1].turned", "an angle such as 30 deg", "90, which has no unit"),
    (SHA256, SHA256[:-1], "sha256", "hands[1].sha256", "a SHA-256: 64 digits", SHA256[:20]),
    ("kind: overhead", "kind: over head", "kind", "hand sensor.kind", "ideal, overhead or eye in hand", "over head"),
    ("dropout: 5 %", "dropout: 105 %", "dropout", "hand sensor.dropout", "a fraction such as 5 % or 0.05, at least 0 and at most 1", "105 %"),
    ("dropout: 5 %", "dropout: -0.1", "dropout", "hand sensor.dropout", "a fraction", "-0.1"),
    ("rate: 30 Hz", "rate: 0 Hz", "rate", "hand sensor.rate", "a rate such as 30 Hz, above 0 Hz", "0 Hz"),
    ("rate: 30 Hz", "rate: 33 ms", "rate", "hand sensor.rate", "a rate such as 30 Hz", "33 ms"),
    ("latency: 33 ms", "latency: -1 ms", "latency", "hand sensor.latency", "a time such as 0.5 s, at least 0 s", "-1 ms"),
    ("width: 320 px", "width: 320.5 px", "width", "camera.width", "a whole number of pixels", "320.5 px"),
    ("width: 320 px", "width: 320", "width", "camera.width", "a number of pixels such as 2 px", "320, which has no unit"),
    ("width: 320 px", "width: 99999 px", "width", "camera.width", "a number of pixels such as 2 px, at least 1 and at most 4096 px", "99999"),
    ("offset: [1 mm", "ofset: [1 mm", "calibration", "camera.calibration error.ofset", "one of the keys rotation, offset", "the key"),
    ("{critical distance: 450 mm}", "{critcal distance: 450 mm}", "critcal", "settings.avoidance.critcal distance", "one of the keys", "the key"),
    ("{critical distance: 450 mm}", "450 mm", "avoidance", "settings.avoidance", "a mapping with the keys critical distance", "450 mm"),
    ("interaction: mean", "interaction: meen", "interaction", "settings.servo.interaction", "current, desired or mean", "meen"),
    ("interaction: mean", "gain far: 0.4 /s", "servo", "settings.servo.gain far", "a number such as 0.4", "0.4 /s"),
    ("interaction: mean", "gain far: 0", "servo", "settings.servo.gain far", "a number such as 0.4, above 0", "0"),
    ("  servo: {interaction: mean}", "  clock: {physics substeps: 0}", "substeps", "settings.clock.physics substeps", "a whole number from 1 to 100", "0"),
    ("  servo: {interaction: mean}", "  clock: {control period: 0 s}", "period", "settings.clock.control period", "a time such as 0.5 s, above 0", "0 s"),
    ("  servo: {interaction: mean}", "  clock: {control period: 1e-9 s}", "duration", "duration", "at most 1,000,000 control periods", "12 s"),
    ("  servo: {interaction: mean}", "  cell: {object polygon: [[0 m, 0 m], [1 m, 0 m]]}", "polygon", "settings.cell.object polygon", "a list of at least three corners", "a list of 2"),
    ("gain switch reached: inconclusive", "gain switch reached: yes", "gain switch", "claims.gain switch reached", "holds, violated or inconclusive", "yes"),
    ("gain switch reached: inconclusive", "gain switch reached:", "gain switch", "claims.gain switch reached", "holds, violated or", "nothing"),
]


@pytest.mark.parametrize(
    ("old", "new", "at", "field", "expected", "got"), MISTAKES, ids=[f"{m[3]}: {m[5]}" for m in MISTAKES]
)
def test_a_mistake_is_refused_with_line_field_expected_and_got(
    old: str, new: str, at: str, field: str, expected: str, got: str
) -> None:
    text = changed(old, new)
    error = refusal(text)
    assert error.place.field == field
    if isinstance(error, ScenarioError):
        assert error.place == Place(file=FILE, line=line_of(text, at), field=field)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("duration: 12 s", "durations: 12 s", 'did you mean "duration"?'),
        ("speed: 0.5 m/s", "sped: 0.5 m/s", 'did you mean "speed"?'),
        ("speed: 0.5 m/s", "speed: 0.5 mps", "allowed units: m/s, cm/s, mm/s, km/h"),
        ("- wait: 1 s", "- wiat: 1 s", 'did you mean "wait"?'),
        ("track: left hand", "track: left hnd", 'did you mean "left_hand"?'),
        ("interaction: mean", "interaction: meen", 'did you mean "mean"?'),
        ("kind: overhead", "kind: Overhead", 'did you mean "overhead"?'),
        ("  servo: {interaction: mean}", "  gain far: 0.3", "write servo: {gain far: ...}"),
        ("  servo: {interaction: mean}", "  camera: {rate: 30 Hz}", '"camera:" stands at the top of the file'),
    ],
)
def test_a_near_miss_gets_advice(old: str, new: str, hint: str) -> None:
    assert hint in refusal(changed(old, new)).hint


def test_a_third_hand_is_refused() -> None:
    hand = "  - {hand: NAME, starts at: [1 m, 0 m, 0 m], elbow towards: [2 m, 0 m, 0 m], moves: []}\n"
    text = SHORTEST + "hands:\n" + "".join(hand.replace("NAME", name) for name in "abc")
    error = refusal(text)
    assert (error.place.field, error.expected, error.got) == ("hands", "a list of at most 2 hands", "a list of 3")


def test_a_scenario_without_claims_is_refused() -> None:
    error = refusal(SHORTEST.replace("{gain switch reached: holds}", "{}"))
    assert (error.place.line, error.place.field, error.got) == (4, "claims", "an empty mapping")


@pytest.mark.parametrize(("text", "got"), [("[1, 2]", "a list of 2"), ("hello", "hello")])
def test_a_file_that_is_no_mapping_is_refused(text: str, got: str) -> None:
    error = refusal(text)
    assert (error.place.line, error.got) == (1, got)
    assert error.expected.startswith("a mapping with the keys scenario, about, duration")


@pytest.mark.parametrize("character", ["\\x07", "\\ud800", "\\u2028"])
def test_a_title_with_control_characters_is_refused(character: str) -> None:
    error = refusal(SHORTEST.replace("nothing happens", f'"a{character}b"'))
    assert (error.place.line, error.place.field) == (1, "scenario")
    assert error.got.startswith("a text with the character U+")


class TestFiles:
    def test_a_file_is_read_and_named_after_it(self, tmp_path: Path) -> None:
        file = tmp_path / "quiet.v2.yaml"
        file.write_bytes(b"\xef\xbb\xbf" + SHORTEST.replace("\n", "\r\n").encode())
        scenario = read_scenario(file)
        assert (scenario.name, scenario.file) == ("quiet.v2", file)
        assert scenario == parse_scenario(SHORTEST, file)

    def test_a_recording_is_sought_beside_the_file(self, tmp_path: Path) -> None:
        (tmp_path / "walks").mkdir()
        (tmp_path / "walks/walk.csv").write_bytes(RECORDING)
        file = tmp_path / "reach.yaml"
        file.write_text(changed(f"    sha256: {SHA256}\n", ""))
        assert read_scenario(file) == parse(VALID)

    def test_a_changed_recording_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "walks").mkdir()
        (tmp_path / "walks/walk.csv").write_bytes(RECORDING + b"2.01" + b",1" * 9 + b"\n")
        file = tmp_path / "reach.yaml"
        file.write_text(VALID)
        with pytest.raises(RecordingError, match="expected a recording with this SHA-256") as caught:
            read_scenario(file)
        assert caught.value.place == Place(file=file, line=line_of(VALID, "sha256"), field="hands[1].sha256")

    def test_carried_bytes_under_a_wrong_sha256_are_refused(self) -> None:
        with pytest.raises(RecordingError, match="SHA-256"):
            parse_scenario(VALID, FILE, {SHA256: RECORDING.replace(b"0.3", b"0.4")})

    def test_a_missing_recording_is_refused_where_it_is_named(self) -> None:
        with pytest.raises(RecordingError, match="no such file: folder/walks/walk.csv") as caught:
            parse_scenario(VALID, FILE)
        assert caught.value.place == Place(FILE, line_of(VALID, "recording:"), "hands[1].recording")

    def test_a_missing_file_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ScenarioError, match="no such file"):
            read_scenario(tmp_path / "none.yaml")

    def test_a_folder_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ScenarioError, match="not a regular file"):
            read_scenario(tmp_path)

    def test_a_pipe_is_refused_rather_than_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe.yaml")
        with pytest.raises(ScenarioError, match="not a regular file"):
            read_scenario(tmp_path / "pipe.yaml")

    def test_a_name_that_is_too_long_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ScenarioError, match="File name too long"):
            read_scenario(tmp_path / ("x" * 5000))

    def test_a_large_file_is_refused(self, tmp_path: Path) -> None:
        file = tmp_path / "large.yaml"
        file.write_bytes(b"#" * (MAX_BYTES + 1))
        with pytest.raises(ScenarioError, match="at most 1,000,000 bytes"):
            read_scenario(file)

    def test_text_in_another_encoding_is_refused_with_its_line(self, tmp_path: Path) -> None:
        file = tmp_path / "latin.yaml"
        file.write_bytes("scenario: x\nabout: grün\n".encode("latin-1"))
        with pytest.raises(ScenarioError, match="expected text in UTF-8; got the byte 0xfc") as caught:
            read_scenario(file)
        assert caught.value.place == Place(file=file, line=2)


class TestSettingsKeys:
    groups = [type(getattr(DEFAULTS, field.name)) for field in fields(DEFAULTS)]

    @pytest.mark.parametrize("group", groups)
    def test_no_two_fields_have_the_same_words(self, group: type) -> None:
        words = [key.words for key in setting_keys(group)]
        assert len(set(words)) == len(words)

    @pytest.mark.parametrize("group", groups)
    def test_no_unit_is_left_in_the_words(self, group: type) -> None:
        units = {"m", "s", "px", "px2", "rad", "mps", "mps2", "hz", "radps", "radps2", "pxps", "pxps2", "px2ps", "s2pm"}
        for key in setting_keys(group):
            assert not units & set(" ".join(key.words).split())

    def test_the_exceptions_about_signs_are_fields(self) -> None:
        names = {field.name for group in self.groups for field in fields(group)}
        assert names >= MAY_BE_ZERO | MAY_BE_NEGATIVE


LINES = VALID.splitlines()
TOKENS = [
    "", " ", "  ", "\n", ":", ": ", "-", "- ", "[", "]", "{", "}", ",", "#", "&a", "*a", "!t", "|", ">", "'", '"', "%",
    "~", "null", "0", "-1", "1e309", "nan", ".inf", "mm", "m/s", "deg", "x", "²", "\\", "\t", "\x00", "\ufeff", "\ud800",
    "../..", "/dev/zero", "---", "...", "? ", "<<: ", "0 m", "1 s", "hands", "moves", "recording: x",
]  # fmt: skip


@st.composite
def broken_texts(draw: st.DrawFn) -> str:
    """The valid file after a few slips of the editor."""
    lines = list(LINES)
    for _ in range(draw(st.integers(min_value=1, max_value=4))):
        at = draw(st.integers(min_value=0, max_value=len(lines) - 1))
        slip = draw(st.sampled_from(["delete", "duplicate", "swap", "indent", "insert", "replace", "cut"]))
        line, column = lines[at], draw(st.integers(min_value=0, max_value=len(lines[at])))
        token = draw(st.sampled_from(TOKENS))
        if slip == "delete" and len(lines) > 1:
            del lines[at]
        elif slip == "duplicate":
            lines.insert(draw(st.integers(min_value=0, max_value=len(lines))), line)
        elif slip == "swap":
            other = draw(st.integers(min_value=0, max_value=len(lines) - 1))
            lines[at], lines[other] = lines[other], line
        elif slip == "indent":
            lines[at] = " " * draw(st.integers(min_value=0, max_value=8)) + line.lstrip()
        elif slip == "insert":
            lines[at] = line[:column] + token + line[column:]
        elif slip == "replace":
            words = line.split(" ")
            words[draw(st.integers(min_value=0, max_value=len(words) - 1))] = token
            lines[at] = " ".join(words)
        else:
            lines[at] = line[:column]
    return "\n".join(lines) + "\n"


@hypothesis_settings(deadline=None, max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(broken_texts())
def test_a_broken_file_is_a_scenario_or_refused_with_its_reasons(text: str) -> None:
    try:
        scenario = parse(text)
    except (ScenarioError, RecordingError) as error:
        assert error.expected
        assert error.got
        assert error.place.line is None or 1 <= error.place.line <= text.count("\n") + 1
        assert error.place.file is not None
    else:
        assert isinstance(scenario, Scenario)
        assert scenario.ticks > 0
