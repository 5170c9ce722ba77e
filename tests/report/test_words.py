from __future__ import annotations

from dataclasses import replace

import factory
import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS, HandSensorKind
from safety_harness.claims.properties.base import Unit
from safety_harness.claims.properties.positions import BEYOND_M, RepulsivePosesReachable
from safety_harness.report.words import (
    changed_settings,
    claimed_hand_distance_m,
    claimed_tcp_speed_mps,
    drives_as_modelled,
    failed_words,
    flag_words,
    margin_words,
    milliseconds_words,
    point_words,
    setting_words,
    with_minus,
)
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.robots import Drives, OwnRobot, Payload, Robot, StopTimes
from safety_harness.trace.records import Check, Limit


def test_a_minus_sign_begins_a_number_and_no_part_of_a_name() -> None:
    assert with_minus("hands-12: -5.6 mm, (-.5), 1e-05") == "hands-12: \u22125.6 mm, (\u2212.5), 1e\u221205"


def test_the_defaults_differ_from_themselves_nowhere() -> None:
    assert changed_settings(DEFAULTS) == []


def test_every_changed_setting_is_named_once_with_both_values() -> None:
    settings = replace(
        DEFAULTS,
        avoidance=replace(DEFAULTS.avoidance, critical_distance_m=0.25),
        camera=replace(DEFAULTS.camera, rate_hz=30.0, calibration_error_rotation_rad=(0.0, 0.0, np.pi)),
        hand_sensor=replace(DEFAULTS.hand_sensor, kind=HandSensorKind.OVERHEAD),
    )
    assert sorted(changed_settings(settings)) == [
        ("avoidance.critical_distance_m", "400 mm", "250 mm"),
        ("camera.calibration_error_rotation_rad", "(0, 0, 0) deg", "(0, 0, 180) deg"),
        ("camera.rate_hz", "none", "30 Hz"),
        ("hand_sensor.kind", "ideal", "overhead"),
    ]


def test_what_the_drives_of_an_own_arm_do_is_said_as_it_is_modelled() -> None:
    drives = Drives(dead_time_s=0.02, lag_s=0.03, payload=Payload(mass_kg=2.5, centre_m=(0.0, -0.01, 0.05)))
    braking = StopTimes(reaction_time_s=0.1, stop_time_s=0.4)
    arm = OwnRobot(urdf="a.urdf", base="a", tcp="b", capsules="c.json", braking=braking, drives=drives)
    said = {name: own for name, _, own in drives_as_modelled(arm, 0.008)}
    assert said == {
        "robot.drives.dead_time": "0.024 s, 3 whole control periods",
        "robot.drives.lag": "0.03 s",
        "robot.drives.torque_limit": "100 % of the URDF's; all joints wait for the weakest",
        "robot.drives.payload": "2.5 kg in one point, (0, −10, 50) mm from the link tcp",
    }
    assert drives_as_modelled(Robot.UR5, 0.008) == drives_as_modelled(replace(arm, drives=None), 0.008) == []


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("speed_mps", 0.25, "250 mm/s"),
        ("acceleration_mps2", 1.0, "1000 mm/s²"),
        ("width_px", 640, "640 px"),
        ("latency_s", 0.008, "0.008 s"),
        ("gain_far", 0.4, "0.4"),
        ("table_height_m", -0.3, "−300 mm"),
        ("polygon_m", ((0.04, -0.03), (0.08, 0.0)), "((40, −30), (80, 0)) mm"),
    ],
)
def test_a_setting_is_shown_in_the_unit_of_its_name(name: str, value: object, shown: str) -> None:
    assert setting_words(name, value) == shown


def test_flags_are_named_in_words() -> None:
    assert flag_words(Limit.TCP_SPEED | Limit.BRAKING) == "TCP speed, braking"
    assert failed_words(Check.PATH_UNREACHABLE | Check.TABLE, Check.UNREACHABLE) == (
        "proposed: path unreachable, table; opposite: unreachable"
    )
    assert failed_words(Check.NONE, Check.NONE) == "none"


def test_a_position_that_is_not_finite_is_a_dash_and_not_a_number() -> None:
    assert point_words(np.array([0.1234, -0.35, 0.0])) == "123, −350, 0"
    assert point_words(np.array([0.1, np.nan, 0.0])) == "–"


def test_a_missing_margin_is_a_dash_and_a_negative_one_has_its_sign() -> None:
    assert margin_words(factory.evaluation("x", margin=None)) == "–"
    assert margin_words(factory.evaluation("x", margin=-0.0371)) == "−37.1 mm"


@pytest.mark.parametrize("proposed", [False, True])
def test_a_margin_at_which_the_search_ends_is_at_least_that(proposed: bool) -> None:
    sentence = RepulsivePosesReachable(proposed=proposed).sentence
    assert margin_words(factory.evaluation(sentence, margin=BEYOND_M)) == "at least 100 mm"
    assert margin_words(factory.evaluation(sentence, margin=(0.3 + BEYOND_M) - 0.3)) == "at least 100 mm"
    assert margin_words(factory.evaluation(sentence, margin=0.0845)) == "+84.5 mm"
    assert margin_words(factory.evaluation(sentence, margin=-BEYOND_M)) == "\u2212100.0 mm"
    assert margin_words(factory.evaluation("another", margin=BEYOND_M)) == "+100.0 mm"


@pytest.mark.parametrize("margin", [-1e-12, -4e-7, -0.000049, -0.00096])
def test_a_violation_never_reads_as_zero(margin: float) -> None:
    words = margin_words(factory.evaluation("x", Verdict.VIOLATED, margin=margin))
    number, unit = words.replace("\u2212", "-").split()
    assert unit == "mm"
    assert float(number) == pytest.approx(margin * 1e3, rel=0.01)


@pytest.mark.parametrize(
    ("time_s", "words"),
    [(3e-7, "0.0003 ms"), (1.23e-4, "0.12 ms"), (0.00456, "4.6 ms"), (0.1004, "100 ms"), (2.5, "2500 ms")],
)
def test_a_short_time_has_two_digits_that_mean_something(time_s: float, words: str) -> None:
    assert milliseconds_words(time_s) == words


def test_only_a_sentence_with_one_fitting_quantity_gives_a_limit_line() -> None:
    length, speed = Unit.LENGTH, Unit.SPEED
    assert claimed_hand_distance_m(factory.evaluation("hand distance never below 150 mm")) == 0.15
    assert claimed_hand_distance_m(factory.evaluation("hand distance 0.2 m and 300 mm", unit=length)) is None
    assert claimed_hand_distance_m(factory.evaluation("table distance never below 20 mm")) is None
    assert claimed_hand_distance_m(factory.evaluation("hand distance at 250 mm/s", unit=length)) is None
    assert claimed_tcp_speed_mps(factory.evaluation("TCP speed never above 250 mm/s", unit=speed)) == 0.25
    assert claimed_tcp_speed_mps(factory.evaluation("TCP speed never above 250 mm", unit=speed)) is None
    assert claimed_tcp_speed_mps(factory.evaluation("joint speed below 250 mm/s", unit=speed)) is None
