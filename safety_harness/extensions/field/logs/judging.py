"""A log as one judged run, for commands and tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safety_harness.extensions.field.logs.certain import LoggedTrace, trace_from_log
from safety_harness.extensions.field.logs.mode_motion import refuse_retreat_while_servoing
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Claim


def recorded(path: str | Path, claims: Sequence[Claim] = ()) -> LoggedTrace:
    """Return the trace of the log that a LOG.yaml describes.

    Args:
        path: The LOG.yaml.
        claims: The claims to judge in place of the log's own. Empty: its own.

    Raises:
        InputError: Any part of it cannot be used; the error has its place.

    """
    log = read_log(path)
    result = trace_from_log(log)
    if claims:
        scenario = replace(result.trace.scenario, claims=tuple(claims))
        result = replace(result, trace=replace(result.trace, scenario=scenario))
        refuse_retreat_while_servoing(result.trace, log)
    return result
