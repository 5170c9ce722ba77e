"""The table of ratios: what meets an aim, what was not measured, and who offers one."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
import results
from ratios import Ratio

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_a_ratio_is_the_median_between_its_extremes() -> None:
    row = Ratio.of("loop", [3.0, 1.0, 2.0], aim=2.0)
    assert (row.value, row.least, row.greatest, row.verdict) == (2.0, 1.0, 3.0, "met")


@pytest.mark.parametrize(
    ("value", "at_most", "verdict"),
    [(1.9, False, "NOT MET"), (2.0, False, "met"), (2.0, True, "met"), (2.1, True, "NOT MET")],
)
def test_an_aim_is_met_from_its_side(value: float, at_most: bool, verdict: str) -> None:
    assert Ratio.of("loop", [value], aim=2.0, at_most=at_most).verdict == verdict


@pytest.mark.parametrize("values", [[], [1.0, math.nan], [math.inf], [0.0], [-1.0]])
def test_what_is_no_ratio_is_refused(values: list[float]) -> None:
    with pytest.raises(ValueError, match="loop"):
        Ratio.of("loop", values, aim=2.0)


@pytest.mark.parametrize("at_most", [False, True])
def test_what_was_not_measured_meets_no_aim(at_most: bool) -> None:
    missing = Ratio("loop", math.nan, math.nan, math.nan, aim=2.0, at_most=at_most)
    assert missing.verdict == "not measured"


def test_a_row_says_what_was_not_measured_and_why() -> None:
    rows = [
        (Ratio.missing("theirs", "not installed"), "overhead", "1 to 2"),
        (Ratio.of("ours", [2.0]), "loop", "-"),
    ]
    lines = results.table(rows).splitlines()
    assert "| theirs | - | - |  | not measured | not installed | 1 to 2 | `overhead.py` |" in lines
    assert "| ours | 2 | 2 to 2 |  |  |  | - | `loop.py` |" in lines


def test_a_benchmark_that_fails_is_a_row_that_says_so() -> None:
    (row,) = results.measured("no_such_benchmark")
    assert row.verdict == "not measured"
    assert "no_such_benchmark" in row.note


def test_a_name_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert results.main(["lop"]) == 2
    assert "got lop" in capsys.readouterr().err


@pytest.mark.parametrize("name", results.BENCHMARKS)
def test_every_benchmark_of_the_table_offers_ratios_and_stands_in_it(name: str) -> None:
    tree = ast.parse((BENCHMARKS / f"{name}.py").read_text())
    assert "ratios" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert f"| `{name}.py` |" in results.RESULTS.read_text()
