"""Scenario files: ``read_scenario`` turns the text that a safety engineer wrote into a Scenario.

docs/scenario-language.md is the reference of the language.  One function reads one object; all
checks that need no kinematics are made here, every error has file, line and field.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from safety_harness.exceptions import Place, ScenarioError
from safety_harness.scenario.compose import COMPOSING, MATRIX, SPACE_KEY, SUITE, Library, Variant, variants
from safety_harness.scenario.faults import read_faults
from safety_harness.scenario.fields import SENTENCE, Field, Fields, Places, is_sentence
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar, Sequence, parse_tree
from safety_harness.scenario.read_hands import read_hands
from safety_harness.scenario.reference_tables import CLAIMS, TOP
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, TOP_GROUPS, read_group, setting_keys
from safety_harness.scenario.units import shown
from safety_harness.settings import DEFAULTS, Settings

MOST_TICKS = 1_000_000
_COMPOSED = dict.fromkeys(
    COMPOSING, "only a file can have it, and a text is none: read_all_scenarios reads files"
) | {SUITE: "a suite is many scenarios: read_all_scenarios reads them"}

# What a scenario must not have: distributions, which belong to scenario spaces.
_HINT = f'a file that begins with "{SPACE_KEY}:" may have distributions in place of values'
_SENTENCES = re.compile(r"from [+-]?[0-9.].* to .+|normal .+(\+-|\+/-|±).+|one of .+,.+")
_KEYS = ({"one of"}, {"one of", "chances"}, {"box"}, {"shell", "from", "to"}, {"in"}, {"repeat", "moves"})
_PROSE = ("scenario", "about", "claims")


def read_scenario(path: Path) -> Scenario:
    """The scenario in a file, with what it extends.

    ScenarioError or RecordingError when it cannot be used as it stands, and for a matrix or a suite,
    which ``read_all_scenarios`` reads.
    """
    found = variants(path, Library())
    if len(found) > 1:
        raise ScenarioError(
            place=Place(file=path, field=MATRIX), expected="one scenario", got=f"a matrix of {len(found)}"
        )
    return scenario_of_variant(found[0], path)


def scenario_of_variant(variant: Variant, file: Path) -> Scenario:
    """The scenario of one tree that ``file`` stands for."""
    refuse_distributions(Field(variant.tree, file, path="", line=1))
    return scenario_of(variant.tree, file, name=variant.name)


def parse_scenario(
    text: str,
    file: Path | None = None,
    recordings: Mapping[str, bytes] | None = None,
    *,
    name: str | None = None,
    claims_required: bool = True,
) -> Scenario:
    """The scenario that ``text`` describes, which has to be complete in itself.

    ``file`` names it, unless ``name`` does, and is where recordings are sought from.

    ``recordings`` are bytes of recordings by their SHA-256, for a text that says ``sha256`` beside
    ``recording``: they are used in place of files.  A scenario without claims says nothing and is
    refused unless ``claims_required`` is False.  ScenarioError or RecordingError otherwise.
    """
    tree = parse_tree(text, file)
    refuse_distributions(Field(tree, file, path="", line=1))
    name = name or (file.stem if file else "unnamed")
    return scenario_of(tree, file, recordings, name=name, claims_required=claims_required)


def scenario_of(
    tree: Node,
    file: Path | None,
    recordings: Mapping[str, bytes] | None = None,
    *,
    name: str,
    claims_required: bool = True,
) -> Scenario:
    """As ``parse_scenario``, for a text that is a tree already."""
    root = Field(tree, file, path="", line=1)
    given = root.fields(TOP.names, hints=_COMPOSED)
    values = TOP.values(given)
    settings = _settings(given)
    _check_duration(values["duration_s"], given.required("duration"), settings)
    return Scenario(
        name=name,
        hands=read_hands(given.optional("hands"), settings=settings, carried=recordings or {}),
        claims=_claims(given.required("claims"), required=claims_required),
        settings=settings,
        faults=read_faults(given.optional("faults"), duration_s=values["duration_s"]),
        file=file,
        places=Places(root),
        **values,
    )


def refuse_distributions(root: Field) -> None:
    """ScenarioError, with a hint, for a scenario space and for a value that a distribution stands for."""
    if not isinstance(root.node, MappingNode):
        return
    for key, field in root.entries("a scenario"):
        if key == SPACE_KEY:
            raise field.error(
                "one scenario",
                got="a scenario space",
                hint="safety-harness sample draws scenarios from it",
            )
        if key not in _PROSE:
            _refuse_below(field)


def _refuse_below(field: Field) -> None:
    if isinstance(field.node, Scalar):
        if _SENTENCES.fullmatch(field.node.text.strip()):
            raise field.error("one value", hint=_HINT)
    elif isinstance(field.node, Sequence):
        for item in field.items("a list"):
            _refuse_below(item)
    else:
        entries = field.entries("a mapping")
        if {key for key, _ in entries} in _KEYS:
            raise field.error("one value", got=f"a mapping with the key {entries[0][0]}", hint=_HINT)
        for _, child in entries:
            _refuse_below(child)


def _check_duration(duration_s: float, field: Field, settings: Settings) -> None:
    if duration_s < settings.clock.control_period_s:
        raise field.error(f"at least one control period, {settings.clock.control_period_s:g} s")
    if duration_s > MOST_TICKS * settings.clock.control_period_s:
        raise field.error(f"at most {MOST_TICKS:,} control periods")


def _settings(given: Fields) -> Settings:
    """The defaults with the values that the file changes."""
    changes: dict[str, Any] = {}
    for key, name in TOP_GROUPS.items():
        group = given.optional(key)
        if group is not None:
            changes[name] = read_group(group, getattr(DEFAULTS, name))
    whole = given.optional("settings")
    if whole is not None:
        groups = whole.fields(tuple(SETTINGS_KEYS), hints=_misplaced())
        for key in groups:
            name = SETTINGS_KEYS[key]
            changes[name] = read_group(groups.required(key), getattr(DEFAULTS, name))
    return replace(DEFAULTS, **changes)


def _misplaced() -> dict[str, str]:
    """What to write instead of a key that stands one level too high, or too low, in ``settings``."""
    hints = {key: f'"{key}:" stands at the top of the file' for key in TOP_GROUPS}
    for group, name in SETTINGS_KEYS.items():
        for key in setting_keys(type(getattr(DEFAULTS, name))):
            hint = f"{group}: {{{key.path[0]}: ...}}"
            before = hints.get(key.path[0])
            hints[key.path[0]] = f"{before}, or {hint}" if before else f"write {hint}"
    return hints


def _claims(field: Field, *, required: bool) -> tuple[Claim, ...]:
    """Claims are looked up later; here they only have to be sentences with a verdict."""
    entries = CLAIMS.read(field) if required else field.entries(CLAIMS.expected)
    return tuple(_claim(sentence, verdict) for sentence, verdict in entries)


def _claim(sentence: str, verdict: Field) -> Claim:
    if not is_sentence(sentence):
        raise verdict.error(SENTENCE, got=shown(sentence))
    return Claim(sentence=sentence, expected=verdict.choice(Verdict), place=verdict.place)
