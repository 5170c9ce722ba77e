"""The setting ``decision time``: the time that a decision costs in simulation.

The setting is a kind of cost, a time, or a measured profile. A profile is a JSON file written by
``safety-harness time``.  The stored form of a scenario contains the content of its profile, so a trace needs
no further file.
"""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from safety_harness.base.exceptions import InputError, Place, ScenarioError
from safety_harness.base.settings import DecisionCost, DecisionTimes, Measured
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.fields import Field, is_sentence
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.nodes import Mapping
from safety_harness.scenario.units import TIME, format_quantity, parse_quantity

if TYPE_CHECKING:
    from safety_harness.scenario.model import Scenario

FORMAT = "safety-harness decision times 1"
LONGEST_S = 60.0  # a choice
MOST_QUANTILES = 1_001  # a choice: a measured profile has 101
MOST_BYTES = 1_000_000  # a limit of the memory; a choice
PROFILE = ".json"
KEYS = ("quantiles", *(entry.name for entry in fields(Measured)))
FORM = (
    f"a time from 0 s to {LONGEST_S:g} s; `between 5 ms and 40 ms`; `FILE{PROFILE}`, a measured profile; "
    f"`{DecisionCost.AS_DECLARED.value}` or `{DecisionCost.WALL_CLOCK.value}`"
)
_EXPECTED = FORM.replace("`", '"')


def read_decision_time(field: Field) -> DecisionCost | DecisionTimes:
    """Return the decision time that a field states in any allowed form.

    Raise ScenarioError for another form.
    """
    if isinstance(field.node, Mapping):
        return _inline(field)
    text = " ".join(field.scalar(_EXPECTED).split())
    for cost in DecisionCost:
        if text == cost.value:
            return cost
    if text.endswith(PROFILE):
        place = field.place
        folder = place.file.parent if place.file else Path()
        return _profile(located(folder / Path(text).expanduser(), place), place)
    low, _, high = text.removeprefix("between ").partition(" and ")
    if not text.startswith("between "):
        return DecisionTimes(quantiles_s=(field.quantity(TIME, least=0.0, most=LONGEST_S),))
    return _checked(field, tuple(parse_quantity(entry, TIME, field.place) for entry in (low, high)), None)


def write_decision_time(value: DecisionCost | DecisionTimes) -> str | dict[str, str | list[str]]:
    """Return the text or the mapping from which ``read_decision_time`` returns ``value``."""
    if isinstance(value, DecisionCost):
        return value.value
    texts = [format_quantity(entry, TIME) for entry in value.quantiles_s]
    if value.measured is None:
        return texts[0] if len(texts) == 1 else f"between {texts[0]} and {texts[1]}"
    own = {key: json.dumps(text) for key, text in asdict(value.measured).items()}
    return {"quantiles": texts} | own


def profile_text(times: DecisionTimes) -> str:
    """Return the text of a profile's file that contains the decision times ``times``."""
    assert times.measured is not None
    whole = {"format": FORMAT, **asdict(times.measured), "quantiles_s": list(times.quantiles_s)}
    return json.dumps(whole, indent=1) + "\n"


def refuse_wall_clock(scenario: Scenario, error: type[InputError], *, runs: str) -> None:
    """Raise ``error`` if the decisions have a wall-clock cost, because the runs would not be repeatable.

    Args:
        scenario: The scenario.
        error: The type of the error.
        runs: The runs that must be repeatable, in words for the message.

    """
    if scenario.settings.avoidance.decision_time is DecisionCost.WALL_CLOCK:
        expected = f"a time that does not depend on the machine: {runs} have to repeat"
        hint = "safety-harness run takes it for one scenario; a measured profile is taken here too"
        got = DecisionCost.WALL_CLOCK.value
        place = scenario.place("settings.avoidance.decision time")
        raise error(place=place, expected=expected, got=got, hint=hint)


def _inline(field: Field) -> DecisionTimes:
    """Return the decision times of a profile that the scenario itself contains as a mapping."""
    given = field.fields(KEYS)
    items = given.required("quantiles").items("a list of times", least=2, most=MOST_QUANTILES)
    measured = Measured(
        avoider=given.required("avoider").sentence("the avoider that was measured"),
        sha256=given.required("sha256").scalar("the hash of its file, or nothing"),
        machine=given.required("machine").sentence("the machine that it was measured on"),
        questions=given.required("questions").integer(least=1, most=10**9),
    )
    return _checked(field, tuple(item.quantity(TIME) for item in items), measured)


def _checked(field: Field, times_s: tuple[float, ...], measured: Measured | None) -> DecisionTimes:
    """Return the decision times as an object.

    Raise ScenarioError unless the times rise and lie within the bounds.
    """
    if not _rise(times_s):
        raise field.error(f"times that rise, from 0 s to {LONGEST_S:g} s")
    return DecisionTimes(quantiles_s=times_s, measured=measured)


def _rise(times_s: tuple[float, ...]) -> bool:
    """Return whether the times [s] rise and lie between 0 and LONGEST_S."""
    return times_s[0] >= 0.0 and times_s[-1] <= LONGEST_S and tuple(sorted(times_s)) == times_s


def _profile(path: Path, place: Place) -> DecisionTimes:
    """Return the decision times in a profile's file.

    ``place`` is where the file's name is written.
    """
    data = read_bytes(path, most=MOST_BYTES, place=place, error=ScenarioError)
    text = decode(data, most=MOST_BYTES, file=path, error=ScenarioError)
    times = _parsed(text)
    if times is None:
        expected = f"a profile of decision times ({FORMAT!r})"
        hint = '"safety-harness time AVOIDER --out FILE.json" measures one'
        raise ScenarioError(place=place, expected=expected, got=f"another file: {path.name}", hint=hint)
    return times


class _Profile(msgspec.Struct):
    """The content of a profile's file."""

    format: str
    avoider: str
    sha256: str
    machine: str
    questions: Annotated[int, msgspec.Meta(gt=0)]
    quantiles_s: Annotated[tuple[float, ...], msgspec.Meta(min_length=2, max_length=MOST_QUANTILES)]


@lru_cache(maxsize=16)  # the scenarios of a space all name the same profile
def _parsed(text: str) -> DecisionTimes | None:
    """Return the decision times in a profile's text, or None if the text is no profile."""
    try:
        profile = msgspec.json.decode(text, type=_Profile)
    except (ValueError, RecursionError):
        return None
    texts = (profile.avoider, profile.machine, profile.sha256 or "none")
    if profile.format != FORMAT or not all(map(is_sentence, texts)) or not _rise(profile.quantiles_s):
        return None
    measured = Measured(**{key: getattr(profile, key) for key in KEYS[1:]})
    return DecisionTimes(quantiles_s=profile.quantiles_s, measured=measured)
