"""A log as one judged run, as commands and tests take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safety_harness.logs.certain import Recorded, trace_of
from safety_harness.logs.read import read_log
from safety_harness.scenario.model import Claim


def recorded(path: str | Path, claims: Sequence[Claim] = ()) -> Recorded:
    """The log that a LOG.yaml describes, as a trace; ``claims`` in place of its own.

    InputError with its place for whatever of it cannot be used.
    """
    found = trace_of(read_log(path))
    if not claims:
        return found
    scenario = replace(found.trace.scenario, claims=tuple(claims))
    return replace(found, trace=replace(found.trace, scenario=scenario))
