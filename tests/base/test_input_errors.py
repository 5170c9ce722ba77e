"""Several mistakes in one file count as one input that cannot be used."""

from __future__ import annotations

from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.base.input_errors import InputErrors


def error(file: str | None, line: int) -> ScenarioError:
    place = Place(file=None if file is None else Path(file), line=line)
    return ScenarioError(place=place, expected="a time", got=str(line))


def test_inputs_are_counted_by_their_files() -> None:
    assert InputErrors([error("a.yaml", 1), error("a.yaml", 2), error("b.yaml", 1)]).inputs == 2
    assert InputErrors([error(None, 1), error(None, 2), error("b.yaml", 1)]).inputs == 3
