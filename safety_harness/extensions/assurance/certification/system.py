"""A description of the system under test: avoider with its card, gate, settings, robot and hashes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from typing import Any

from safety_harness.admission.avoiders import NAMES
from safety_harness.admission.driving import named_system
from safety_harness.base.settings import DecisionCost, Settings
from safety_harness.cell.avoidance.model_file import Model, load_model
from safety_harness.cell.avoidance.shipped import network_file_of
from safety_harness.claims.properties.answered import NOT_MODELLED
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import SystemDescription
from safety_harness.report.decisions import cost_words
from safety_harness.report.words import (
    UNKNOWN_OF_SIMULATOR,
    changed_settings,
    drives_as_modelled,
    setting_words,
    unknown_files,
)
from safety_harness.scenario.model import Scenario

DATA, LEARNING = "Data: ", "Learning: "  # prefixes: data sheet, log of learning
CARD = {  # keys of a model's card, and their labels
    "command": LEARNING + "made by",
    "recipe": LEARNING + "recipe",
    "software": LEARNING + "software",
    "seed": LEARNING + "seed",
    "metrics": LEARNING + "what came of it",
}
ANSWERS = {
    "eq13": "equation 13 of the paper, for the best of {candidates} random candidates: others, other answers",
    "continuous": "equation 13 of the paper, for its continuous optimum: no noise of random candidates",
}


def system_of(plan: Plan, opened: Mapping[str, str]) -> SystemDescription:
    """Return the description of the plan's system, from the simplest scenario of each stratum.

    ``opened`` has the SHA-256 of each file that the user's own modules opened.
    """
    scenarios = [plan.with_avoider(stratum.space.simplest) for stratum in plan.strata]
    first = scenarios[0]
    model = model_of(first)
    changed = dict.fromkeys(row for scenario in scenarios for row in _changed(scenario))
    return SystemDescription(
        under_test=tuple(dict.fromkeys(map(named_system, scenarios))),
        card=() if model is None else tuple(card_of(model)),
        limits=(
            *(() if model is None else (str(limit) for limit in model.card.get("limits", ()))),
            *([UNKNOWN_OF_SIMULATOR] if plan.world.program else []),
            *dict.fromkeys(
                unknown_files(case).removeprefix("; ") for case in scenarios if unknown_files(case)
            ),
        ),
        gate=() if first.driven else tuple(_gate(first.settings, model, named=first.avoider in NAMES)),
        settings=(
            *((f"file {name}", f"sha256 {sha256}") for name, sha256 in opened.items() if sha256),
            *_settings("", first.settings),
        ),
        changed=tuple(changed),
    )


def _changed(scenario: Scenario) -> list[tuple[str, str, str]]:
    """Return the settings that differ from the defaults, and the drives of a user's arm."""
    drives = drives_as_modelled(scenario.robot, scenario.settings.clock.control_period_s)
    return changed_settings(scenario.settings) + drives


def model_of(scenario: Scenario) -> Model | None:
    """Return the network of the avoider in ``scenario``.

    Return None if the avoider is not a file in this package's format.
    """
    file = network_file_of(scenario)
    return None if file is None else load_model(file)


def card_of(model: Model) -> Iterator[tuple[str, str]]:
    """Yield the statements on ``model`` that its own file contains."""
    yield "Network", f"{model.kind}, {model.members} member(s), dropout {model.dropout.value}"
    if model.passes > 1:
        yield "Passes", f"{model.passes}, dropout probability {model.dropout_probability:g}"
    data, recipe = model.card.get("data"), model.card.get("recipe")
    if isinstance(data, Mapping):
        yield from _datasheet(data, recipe if isinstance(recipe, Mapping) else {})
    seen = model.seen
    yield "Seen hands", f"{_corner(seen.hand_low_m)} to {_corner(seen.hand_high_m)} mm in the base frame"
    yield "Seen TCPs", f"{_corner(seen.tcp_low_m)} to {_corner(seen.tcp_high_m)} mm in the base frame"
    for key, title in CARD.items():
        if key in model.card:
            yield title, _plain(model.card[key])
    if model.calibration is not None:
        known = model.calibration
        residual = " / ".join(f"{value * 1e3:.1f}" for value in known.residual_std_m)
        intervals = f"intervals of {known.interval_multiplier:.3f} times the spread"
        text = f"{known.samples} held-out samples: {intervals} and the residual {residual} mm together"
        yield "Calibration", text


def _datasheet(data: Mapping[str, Any], recipe: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield statements on the data set that ``train`` drew: its content and its gaps.

    A line is omitted if the card lacks its values.
    """
    yield DATA + "a sample", "where one hand and the TCP are in the base frame; no image, person or motion"
    amount = "{tcps} TCPs, each with the same {hands} hands; split {split}, {training_samples} to learn from"
    origin = "drawn from the regions of the space {space!r}, seed {seed}; sha256 {sha256}"
    answer = ANSWERS.get(str(recipe.get("target")), "not stated")
    known = {key: value for key, value in data.items() if isinstance(value, str | int)}
    for name, text in ("how many", amount), ("where from", origin), ("answers", answer):
        with suppress(KeyError):  # a card without the values
            yield DATA + name, text.format(**known)
    yield DATA + "not in it", "two hands at once, recorded hands, and what lies outside of the corners below"


def _corner(point_m: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value * 1e3:.0f}" for value in point_m) + ")"


def _plain(value: Any) -> str:
    """Return ``value``, which comes from a card, as text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{str(name).replace('_', ' ')} {_plain(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _gate(settings: Settings, model: Model | None, *, named: bool) -> Iterator[tuple[str, str]]:
    """Yield the gate's checks and limits.

    ``named`` is true if the avoider ships with the package.
    """
    avoidance = settings.avoidance
    checks = "finite, reachable, above the table"
    if avoidance.gate.value == "full":
        checks = "certain, reachable with margin, away from every hand, clear of table and robot, in time"
    yield "Asks", f"{avoidance.gate.value}: {checks}"
    if model is not None and model.calibration is not None and model.calibration.spread_threshold_m > 0.0:
        yield "Largest spread", f"{model.calibration.spread_threshold_m * 1e3:.2f} mm"
    yield "Otherwise", "the opposite pose under the same checks, and else a protective stop"
    for name in ("critical_distance_m", "decision_deadline_s", "table_clearance_m", "restart_delay_s"):
        label = name.rpartition("_")[0].replace("_", " ").capitalize()
        yield label, setting_words(name, getattr(avoidance, name))
    declared_s = 0.0 if model is None else model.decision_time_s
    known = model is not None or named or avoidance.decision_time is not DecisionCost.AS_DECLARED
    cost = cost_words(avoidance.decision_time, declared_s)
    yield "Computing time", cost if known else f"as the avoider declares, and if it does not: {NOT_MODELLED}"


def _settings(prefix: str, part: Any) -> Iterator[tuple[str, str]]:
    """Yield every setting of ``part`` with its path and its value."""
    for item in fields(part):
        value = getattr(part, item.name)
        if is_dataclass(value):
            yield from _settings(f"{prefix}{item.name}.", value)
        else:
            yield f"{prefix}{item.name}", setting_words(item.name, value)
