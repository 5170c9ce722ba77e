"""Write numbers, settings and codes of a trace as text for people, for example in millimetres or degrees."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum, IntFlag
from typing import Any

import numpy as np

from safety_harness.base.geometry.arrays import Array3
from safety_harness.base.settings import DEFAULTS, DecisionTimes, Settings
from safety_harness.cell.robot.drive import delay_ticks
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.positions import BEYOND_M, RepulsivePosesReachable
from safety_harness.scenario.decision_times import write_decision_time
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import EXEC, names_a_program
from safety_harness.scenario.robots import AnyRobot, OwnRobot, Robot
from safety_harness.trace.records import Check, DecisionOutcome, Mode, Trigger
from safety_harness.trace.system import SystemUnderTest

MODE_WORDS = {mode: mode.name.lower().replace("_", " ") for mode in Mode}
TRIGGER_WORDS = {trigger: trigger.name.lower().replace("_", " ") for trigger in Trigger}
OUTCOME_WORDS = {
    DecisionOutcome.PROPOSED: "proposed position",
    DecisionOutcome.OPPOSITE: "opposite pose",
    DecisionOutcome.STOP: "protective stop",
}
CHECK_MEANINGS = {
    Check.NOT_FINITE: "the avoider raised an error, or answered with something that is no position",
    Check.UNREACHABLE: "no joint angles within their limits put the TCP there",
    Check.PATH_UNREACHABLE: "the arm could be there, but cannot go there straight",
    Check.TABLE: "the TCP would end too near to the table, or below its surface",
    Check.UNCERTAIN: "the largest spread of the proposal is above the avoider's own threshold",
    Check.NEAR_REACH_LIMIT: "reachable, but the straight way ends hardly farther than that",
    Check.TOWARDS_A_HAND: "the straight way does not lead away from every predicted hand",
    Check.ROBOT_ITSELF: "on the way the wrist comes too near to the robot's base, shoulder or upper arm",
    Check.OBSTACLE: "on the way the arm comes too near to an obstacle of the cell",
    Check.OUTSIDE_REGION: "the question is outside of the region that the scenario's gate keeps to",
    Check.LATE: "the avoider had not answered when the decision deadline was over",
}
_UNITS = (  # suffix of a setting's name, shown unit, number of shown units in one SI unit
    ("_mps2", "mm/s\u00b2", 1e3),
    ("_mps", "mm/s", 1e3),
    ("_radps2", "deg/s\u00b2", 180.0 / np.pi),
    ("_radps", "deg/s", 180.0 / np.pi),
    ("_rad", "deg", 180.0 / np.pi),
    ("_px", "px", 1.0),
    ("_hz", "Hz", 1.0),
    ("_m", "mm", 1e3),
    ("_s", "s", 1.0),
)
_LENGTH_IN_SENTENCE = re.compile(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)(?![\w/])")
_SPEED_IN_SENTENCE = re.compile(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)/s(?![\w\u00b2^])")
_REACHABLE = {RepulsivePosesReachable(proposed=proposed).sentence for proposed in (False, True)}
_PER_METRE = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def with_minus(text: str) -> str:
    """Replace each hyphen before a number in ``text`` by a minus sign.

    Hyphens within names stay.
    """
    return re.sub(r"(?<!\w)-(?=[\d.])|(?<=\de)-(?=\d)", "\u2212", text)


def count_words(count: int, singular: str, plural: str) -> str:
    """Return ``count`` with its noun in the singular or the plural."""
    return f"{count} {singular if count == 1 else plural}"


def margin_words(evaluation: Evaluation) -> str:
    """Return the margin with its sign and unit, or a dash if there is no margin.

    The text begins with "at least" if the margin lies beyond the distance that the harness searches.
    """
    margin_m = evaluation.margin
    if evaluation.sentence in _REACHABLE and margin_m is not None and margin_m >= BEYOND_M - 1e-9:
        return f"at least {BEYOND_M * 1e3:.0f} mm"
    text = evaluation.margin_text()
    return "\u2013" if text == "-" else with_minus(text)


def milliseconds_words(time_s: float) -> str:
    """Return a duration in ms, with two significant digits below 10 ms and without decimals from 10 ms on."""
    shown = time_s * 1e3
    return f"{shown:.0f} ms" if shown >= 10.0 else f"{shown:.2g} ms"


def spread_words(spread_m: Array3, threshold_m: float) -> str:
    """Return the largest axis of a predictive spread [mm], compared with the avoider's threshold.

    The text is empty for an avoider that has no spread and no threshold. The text has enough digits to show
    which of the two numbers is larger.

    Args:
        spread_m: The spread (3,) [m].
        threshold_m: The avoider's threshold [m], which is not finite if the avoider has no threshold.

    """
    limited = bool(np.isfinite(threshold_m))
    if not limited and not (np.all(np.isfinite(spread_m)) and np.any(spread_m)):
        return ""
    if not np.all(np.isfinite(spread_m)):
        return "\u2013"
    largest, allowed = float(np.max(spread_m)) * 1e3, threshold_m * 1e3
    if not limited:
        return f"{largest:.1f}, no threshold"
    digits = 1
    while digits < 12 and largest != allowed and round(largest, digits) == round(allowed, digits):
        digits += 1
    sign = ">" if largest > allowed else "\u2264"
    return f"{largest:.{digits}f} {sign} {allowed:.{digits}f}"


def point_words(position_m: Array3) -> str:
    """Return a position in whole millimetres, or a dash if the position is not finite."""
    if not np.all(np.isfinite(position_m)):
        return "\u2013"
    whole = np.rint(position_m * 1e3).astype(np.int64)
    return with_minus(", ".join(str(value) for value in whole))


def flag_words(flags: IntFlag) -> str:
    """Return the names of all flags that are set, as words."""
    names = ((flag.name or str(flag.value)).lower().replace("_", " ") for flag in flags)
    return ", ".join(names).replace("tcp", "TCP")


def failed_words(proposed: Check, opposite: Check, fault: str = "") -> str:
    """Describe the checks that a decision's two candidates failed, and the reason for an unusable answer."""
    parts = []
    for name, check in (("proposed", proposed), ("opposite", opposite)):
        if check:
            parts.append(f"{name}: {flag_words(check)}")
    if fault:
        parts.append(f"fault: {fault}")
    return "; ".join(parts) or "none"


def setting_words(name: str, value: object) -> str:
    """Return the value of a setting in a common unit.

    The suffix of ``name`` determines the unit.
    """
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, DecisionTimes):
        known = value.measured
        return f"of {known.avoider}, as measured" if known else str(write_decision_time(value))
    if isinstance(value, bool) or not isinstance(value, int | float | tuple):
        return "none" if value is None else str(value)
    unit, factor = "", 1.0
    for suffix, shown, per_si in _UNITS:
        if name.endswith(suffix):
            unit, factor = f" {shown}", per_si
            break
    return with_minus(_numbers(value, factor) + unit)


def _numbers(value: Any, factor: float) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(_numbers(item, factor) for item in value) + ")"
    return f"{value * factor:.6g}"


def changed_settings(settings: Settings) -> list[tuple[str, str, str]]:
    """Return (name, default, value in this run) for every setting that differs from ``DEFAULTS``."""
    return list(_changes("", DEFAULTS, settings))


def changes(scenario: Scenario) -> list[tuple[str, str, str]]:
    """Return (setting, default, value in this run) for each changed setting.

    The robot and its drives come first.
    """
    robot = [("robot", Robot.UR10.value, scenario.robot.label)] if scenario.robot is not Robot.UR10 else []
    drives = drives_as_modelled(scenario.robot, scenario.settings.clock.control_period_s)
    return robot + drives + changed_settings(scenario.settings)


def tested_words(scenario: Scenario, system: SystemUnderTest) -> str:
    """Describe the tested system: its avoider or controller, shield, gate, and changed settings."""
    shield = [] if scenario.shield is None else [f"shield {scenario.shield.kind.value}"]
    shield += [f"safety filter {system.safety_filter.name}"] if system.safety_filter else []
    shield += [f"predictor {system.predictor.name}"] if system.predictor else []
    gate = [] if scenario.gate is None else [f"gate {', '.join(scenario.gate.demands)}"]
    changed = (f"{name} {value}" for name, _, value in changes(scenario))
    return ", ".join([system.label, *shield, *gate, *changed]) + unknown_files(scenario)


UNKNOWN_OF_SIMULATOR = (
    "which files the simulator opens is not known, but for those of its command and of its HARNESS_FILES"
)


def unknown_files(scenario: Scenario) -> str:
    """Return a warning that a program under test may open unknown files.

    The text is empty if the tested system includes no program that the harness starts or connects to.
    """
    programs = [reference for reference in scenario.parts_under_test if names_a_program(reference)]
    if not programs:
        return ""
    declares = all(program.startswith(EXEC) for program in programs)
    declared = ", but for those that it declares in HARNESS_FILES" * declares
    return f"; which files this program opens is not known{declared}"


def _changes(prefix: str, default: Any, own: Any) -> Iterator[tuple[str, str, str]]:
    for item in fields(default):
        name = f"{prefix}{item.name}"
        default_value, value = getattr(default, item.name), getattr(own, item.name)
        if is_dataclass(default_value):
            yield from _changes(f"{name}.", default_value, value)
        elif default_value != value:
            yield name, setting_words(item.name, default_value), setting_words(item.name, value)


def drives_as_modelled(robot: AnyRobot, period_s: float) -> list[tuple[str, str, str]]:
    """Return (name, default, value in this run) for the drives of a user's own arm.

    The values are those of the model, for example the dead time in whole control periods. The list is empty
    for an arm that states no drives.
    """
    drives = robot.drives if isinstance(robot, OwnRobot) else None
    if drives is None:
        return []
    periods = delay_ticks(drives.dead_time_s, period_s)
    rows = [
        ("robot.drives.dead_time", "0 s", f"{periods * period_s:.6g} s, {periods} whole control periods"),
        ("robot.drives.lag", "0 s", f"{drives.lag_s:.6g} s"),
    ]
    if drives.torque_limit is not None:
        text = f"{100.0 * drives.torque_limit:.6g} % of the URDF's; all joints wait for the weakest"
        rows.append(("robot.drives.torque_limit", "none", text))
    if drives.payload is not None:
        at = with_minus(_numbers(drives.payload.centre_m, 1e3))
        text = f"{drives.payload.mass_kg:.6g} kg in one point, {at} mm from the link tcp"
        rows.append(("robot.drives.payload", "none", text))
    return rows


def claimed_hand_distance_m(evaluation: Evaluation) -> float | None:
    """Return the length [m] in a sentence about the hand distance.

    The result is None for any other sentence, or if the sentence does not have exactly one length.
    """
    sentence = evaluation.sentence.lower().replace("predicted hand distance", "")
    if evaluation.unit is not Unit.LENGTH or "hand distance" not in sentence:
        return None
    return _only_number(_LENGTH_IN_SENTENCE, evaluation.sentence)


def claimed_tcp_speed_mps(evaluation: Evaluation) -> float | None:
    """Return the speed [m/s] in a sentence about the TCP speed.

    The result is None for any other sentence, or if the sentence does not have exactly one speed.
    """
    if evaluation.unit is not Unit.SPEED or "tcp speed" not in evaluation.sentence.lower():
        return None
    return _only_number(_SPEED_IN_SENTENCE, evaluation.sentence)


def _only_number(pattern: re.Pattern[str], sentence: str) -> float | None:
    matches = pattern.findall(sentence)
    if len(matches) != 1:
        return None
    number, unit = matches[0]
    return float(number) * _PER_METRE[unit]
