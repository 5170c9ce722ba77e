"""``report.json`` is of docs/schema/report.schema.json, also where a trace was measured in part."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from partly_measured import partly_measured

from safety_harness.admission.trial import judge
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.machine import report_data
from safety_harness.trace.trace import Trace

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "schema" / "report.schema.json").read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def data(trace: Trace) -> dict[str, Any]:
    run = JudgedRun(trace, judge(trace), replay_command="safety-harness replay a.trace")
    return json.loads(json.dumps(report_data([run], interrupted=False)))  # type: ignore[no-any-return]


def test_a_report_is_of_the_schema_whole_or_measured_in_part(visit: Trace) -> None:
    VALIDATOR.check_schema(SCHEMA)
    for trace in (visit, partly_measured(visit)):
        VALIDATOR.validate(data(trace))


@pytest.mark.parametrize("field", ["known", "claims", "decisions"])
def test_a_run_without_one_of_its_fields_is_refused(visit: Trace, field: str) -> None:
    wrong = copy.deepcopy(data(partly_measured(visit)))
    del wrong["runs"][0][field]
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(wrong)
