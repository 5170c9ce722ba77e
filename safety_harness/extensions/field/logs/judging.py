"""Read the log of a cell as a recorded run, so that commands and tests can judge it."""

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
        claims: The claims that replace the log's own claims. If empty, the log's own claims apply.

    Raises:
        InputError: A part of the log cannot be used (the error states its place).

    """
    log = read_log(path)
    result = trace_from_log(log)
    if claims:
        scenario = replace(result.trace.scenario, claims=tuple(claims))
        result = replace(result, trace=replace(result.trace, scenario=scenario))
        refuse_retreat_while_servoing(result.trace, log)
    return result
