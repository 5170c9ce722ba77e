"""``safety-harness schema``: the JSON Schema of scenario files."""

from __future__ import annotations

import json

from safety_harness.cli.console import AS_EXPECTED, result
from safety_harness.scenario.schema import scenario_schema


def print_schema() -> int:
    """Print it; returns the exit code."""
    result(json.dumps(scenario_schema(), indent=1, ensure_ascii=False))
    return AS_EXPECTED
