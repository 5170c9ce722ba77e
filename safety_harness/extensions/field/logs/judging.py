"""A log as one judged run, as commands and tests take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safety_harness.extensions.field.logs.certain import Recorded, trace_of
from safety_harness.extensions.field.logs.mode_motion import refuse_retreat_while_servoing
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Claim


def recorded(path: str | Path, claims: Sequence[Claim] = ()) -> Recorded:
    """The log that a LOG.yaml describes, as a trace; ``claims`` in place of its own.

    InputError with its place for whatever of it cannot be used.
    """
    log = read_log(path)
    found = trace_of(log)
    if claims:
        scenario = replace(found.trace.scenario, claims=tuple(claims))
        found = replace(found, trace=replace(found.trace, scenario=scenario))
        refuse_retreat_while_servoing(found.trace, log)
    return found
