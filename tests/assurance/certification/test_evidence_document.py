from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from made_up_evidence import evidence

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.certification.evidence import as_text, read_evidence, schema

PUBLISHED = Path(__file__).parents[3] / "docs" / "schema" / "evidence.schema.json"


def test_the_published_schema_is_the_one_that_the_types_give() -> None:
    assert json.loads(PUBLISHED.read_text()) == schema()
    jsonschema.Draft202012Validator.check_schema(schema())


def test_the_json_keeps_to_the_schema_and_is_read_again_as_it_was(tmp_path: Path) -> None:
    for one in (evidence(), evidence(only_shown=True, counterexamples=0)):
        text = as_text(one)
        jsonschema.Draft202012Validator(schema()).validate(json.loads(text))
        file = tmp_path / "evidence.json"
        file.write_text(text)
        assert read_evidence(file) == one


def test_the_schema_refuses_what_is_missing_or_of_another_kind() -> None:
    validator = jsonschema.Draft202012Validator(schema())
    found = json.loads(as_text(evidence()))
    for change in (
        {"claims": 3},
        {"standing": "certified"},
        {"format": "something else"},
        {"plan": {**found["plan"], "confidence": "95 %"}},
        {"more": 1},
    ):
        assert not validator.is_valid(found | change), change
    del found["exclusions"]
    assert not validator.is_valid(found)


def test_a_number_that_is_not_finite_is_refused() -> None:
    one = evidence()
    broken = replace(one, plan=replace(one.plan, confidence=float("nan")))
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_text(broken)


def _changed(value: Any, path: str, new: Any) -> Any:
    found = json.loads(json.dumps(value))
    place = found
    *names, last = path.split(".")
    for name in names:
        place = place[int(name) if name.isdigit() else name]
    place[int(last) if last.isdigit() else last] = new
    return found


@pytest.mark.parametrize(
    ("path", "new", "where"),
    [
        ("claims.0.number", "one", "claims[0].number"),
        ("claims.0.number", True, "claims[0].number"),
        ("claims.0.outcomes.1.standing", "fine", "claims[0].outcomes[1].standing"),
        ("plan.confidence", None, "plan.confidence"),
        ("strata", {}, "strata"),
        ("system.gate.0", ["only one"], "system.gate[0]"),
        ("provenance.commands", [1], "provenance.commands[0]"),
        ("coverage", {"runs": 1}, "coverage.without_hand"),
        ("format", "safety-harness evidence 0", "format"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_place(
    tmp_path: Path, path: str, new: Any, where: str
) -> None:
    file = tmp_path / "evidence.json"
    file.write_text(json.dumps(_changed(json.loads(as_text(evidence())), path, new)))
    with pytest.raises(InputError) as refused:
        read_evidence(file)
    assert refused.value.place.file == file
    assert refused.value.place.field == where


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"format": 1}', "[" * 100_000, '{"format": "safety-harness evidence 1", "plan": NaN}'],
)
def test_what_is_no_evidence_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "evidence.json"
    file.write_text(text)
    with pytest.raises(InputError):
        read_evidence(file)
    with pytest.raises(InputError):
        read_evidence(tmp_path / "none.json")
