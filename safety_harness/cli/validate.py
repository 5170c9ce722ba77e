"""``safety-harness validate``: read and admit files, run nothing, tell every mistake."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from safety_harness.admission.admit import Admitted
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain, result, say
from safety_harness.cli.run import read_all


def validate(paths: Sequence[Path], avoider: str | None = None) -> int:
    """A line for each file that can be run, every mistake of the others; returns the exit code."""
    try:
        admitted, errors = read_all(paths, avoider)
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    bad = {error.place.file for error in errors}
    for file, scenarios in groupby(admitted, key=lambda one: one.scenario.file):
        if file not in bad:
            result(f"ok {file}: {_words(list(scenarios))}")
    for error in errors:
        explain(error)
    if errors:
        say(f"{_count(len(errors), 'mistake')}; {_count(len(admitted), 'scenario')} could be run.")
    return BAD_INPUT if errors else AS_EXPECTED


def _words(admitted: Sequence[Admitted]) -> str:
    """What a file holds: ``2 hands, 3 claims, 8 s``; for a matrix the number of its scenarios as well."""
    scenario = admitted[0].scenario
    words = [_count(len(scenario.hands), "hand"), _count(len(scenario.claims), "claim")]
    words += [f"{scenario.duration_s:g} s", scenario.avoider]
    if len(admitted) > 1:
        words.insert(0, _count(len(admitted), "scenario"))
    return ", ".join(words)


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
