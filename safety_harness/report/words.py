"""Numbers, settings and codes of a trace as words for people: millimetres, degrees, plain names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit
from safety_harness.settings import DEFAULTS, Settings
from safety_harness.trace.records import Check, Mode, Outcome, Trigger

MODE_WORDS = {
    Mode.SERVOING: "servoing",
    Mode.REPULSING: "repulsing",
    Mode.PROTECTIVE_STOP: "protective stop",
    Mode.OBJECT_LOST: "object lost",
}
TRIGGER_WORDS = {
    Trigger.HAND_ENTERED: "hand entered",
    Trigger.HAND_STILL_THERE: "hand still there",
    Trigger.ANOTHER_HAND: "another hand",
}
OUTCOME_WORDS = {
    Outcome.PROPOSED: "proposed position",
    Outcome.OPPOSITE: "opposite pose",
    Outcome.STOP: "protective stop",
}
_UNITS = (  # suffix of a setting's name, shown unit, how many of it are one SI unit
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
_PER_METRE = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def with_minus(text: str) -> str:
    """Hyphens before digits as minus signs."""
    return re.sub(r"-(?=[\d.])", "\u2212", text)


def margin_words(evaluation: Evaluation) -> str:
    """The margin with sign and unit; a dash where there is none."""
    text = evaluation.margin_text()
    return "\u2013" if text == "-" else with_minus(text)


def point_words(position_m: NDArray[np.float64]) -> str:
    """A position (3,) in whole millimetres; a dash when it is not finite."""
    if not np.all(np.isfinite(position_m)):
        return "\u2013"
    whole = np.rint(position_m * 1e3).astype(np.int64)
    return with_minus(", ".join(str(value) for value in whole))


def flag_words(flags: IntFlag) -> str:
    """The names of the set flags, in words."""
    names = ((flag.name or str(flag.value)).lower().replace("_", " ") for flag in flags)
    return ", ".join(names).replace("tcp", "TCP")


def failed_words(proposed: Check, opposite: Check, fault: str = "") -> str:
    """Which checks the two candidates of a decision failed, and why the avoider gave no usable answer."""
    parts = []
    for name, check in (("proposed", proposed), ("opposite", opposite)):
        if check:
            parts.append(f"{name}: {flag_words(check)}")
    if fault:
        parts.append(f"fault: {fault}")
    return "; ".join(parts) or "none"


def setting_words(name: str, value: object) -> str:
    """A setting's value in the unit that people use, told by the suffix of its name."""
    if isinstance(value, Enum):
        return str(value.value)
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
    """(name, default, this run) of every setting that differs from ``DEFAULTS``."""
    return list(_changes("", DEFAULTS, settings))


def _changes(prefix: str, default: Any, own: Any) -> Iterator[tuple[str, str, str]]:
    for item in fields(default):
        name = f"{prefix}{item.name}"
        before, after = getattr(default, item.name), getattr(own, item.name)
        if is_dataclass(before):
            yield from _changes(f"{name}.", before, after)
        elif before != after:
            yield name, setting_words(item.name, before), setting_words(item.name, after)


def claimed_hand_distance_m(evaluation: Evaluation) -> float | None:
    """The one length that a sentence about the hand distance names, or None when there is not just one."""
    if evaluation.unit is not Unit.LENGTH or "hand distance" not in evaluation.sentence.lower():
        return None
    return _only_number(_LENGTH_IN_SENTENCE, evaluation.sentence)


def claimed_tcp_speed_mps(evaluation: Evaluation) -> float | None:
    """The one speed that a sentence about the TCP speed names, or None when there is not just one."""
    if evaluation.unit is not Unit.SPEED or "tcp speed" not in evaluation.sentence.lower():
        return None
    return _only_number(_SPEED_IN_SENTENCE, evaluation.sentence)


def _only_number(pattern: re.Pattern[str], sentence: str) -> float | None:
    found = pattern.findall(sentence)
    if len(found) != 1:
        return None
    number, unit = found[0]
    return float(number) * _PER_METRE[unit]
