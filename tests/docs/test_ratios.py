"""The table of ratios: what meets an aim, what was not measured, and who offers one."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path
from types import SimpleNamespace

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


def test_what_stands_in_the_table_is_read_again() -> None:
    rows = [
        Ratio.of("many", [1234.0, 1050.0, 2345.0], aim=400.0),
        Ratio.of("few", [0.0123, 0.02, 0.01], aim=0.05, at_most=True),
        Ratio.missing("theirs", "not installed"),
    ]
    found = results.read(results.table([(row, "loop", "1.0 to 2.0") for row in rows]))
    assert set(found) == {"many", "few"}
    assert (found["many"].value, found["many"].least, found["many"].greatest) == (1234.0, 1050.0, 2345.0)
    assert [found[what].at_most for what in ("many", "few")] == [False, True]
    assert len(results.read(results.RESULTS.read_text())) > 15


@pytest.mark.parametrize(
    ("turns", "at_most", "said", "worse"),
    [
        ([9.0, 10.0, 14.0], False, None, False),
        ([20.0, 21.0, 22.0], False, "better", False),
        ([20.0, 21.0, 22.0], True, "WORSE", True),
        ([1.0, 2.0, 3.0], False, "WORSE", True),
        ([1.0, 2.0, 3.0], True, "better", False),
        (None, False, "gone", True),
    ],
)
def test_a_ratio_changed_if_none_of_its_turns_is_among_those_before(
    turns: list[float] | None, at_most: bool, said: str | None, worse: bool
) -> None:
    before = {"a": Ratio.of("a", [10.0, 12.0, 15.0], at_most=at_most)}
    now = {} if turns is None else {"a": Ratio.of("a", turns, at_most=at_most)}
    lines, got_worse = results.changes(before, now)
    assert [line.partition(":")[0] for line in lines] == ([said] if said else [])
    assert got_worse is worse


def test_every_script_is_run_by_bench_all_or_writes_a_page() -> None:
    (listed,) = re.findall(r"^LONG := ((?:.*\\\n)*.*)$", (BENCHMARKS.parent / "Makefile").read_text(), re.M)
    scripts = {file.stem for file in BENCHMARKS.glob("*.py") if "__main__" in file.read_text()}
    asked_by_others = {"results", "overhead_of_others", "bits", "bits_items", "stale"}
    writers = {"gallery", "meshless_urdfs", "model_cards", "mutants", "sample_reports", "smallest_breaks"}
    of_hours = {"million", "fair_trial"}  # and told where to write, or what to measure
    of_other_software = {"drives", "accessibility"}  # MuJoCo's viewer and axe-core, which nothing else needs
    others = asked_by_others | writers | of_hours | of_other_software
    assert sorted(listed.replace("\\", " ").split()) == sorted(scripts - others)


def test_a_benchmark_that_fails_is_a_row_that_says_so() -> None:
    (row,) = results.measured("no_such_benchmark")
    assert row.verdict == "not measured"
    assert "no_such_benchmark" in row.note


def test_a_benchmark_that_takes_too_long_is_killed_and_said_to_be_late() -> None:
    (row,) = results.measured("loop", within_s=0.05)
    assert row.verdict == "not measured"
    assert "20 minutes" in row.note


def test_all_benchmarks_together_have_one_limit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    left_s: dict[str, float] = {}

    def taking_eleven_minutes(name: str, within_s: float) -> list[Ratio]:
        left_s[name] = within_s
        clock.append(clock[-1] + min(660.0, within_s))
        return [Ratio.of(name, [2.0])]

    clock = [100.0]
    monkeypatch.setattr(results, "measured", taking_eleven_minutes)
    monkeypatch.setattr(results, "time", SimpleNamespace(monotonic=lambda: clock[-1]))
    assert results.main(["loop", "decision", "formulas"]) == 0
    assert left_s == {"loop": 1200.0, "decision": 540.0, "formulas": 0.0}
    printed = capsys.readouterr().out
    assert [line.split(" | ")[0] for line in printed.splitlines() if line.endswith(".py` |")] == [
        "| loop",
        "| decision",
        "| formulas",
    ]


def test_a_name_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert results.main(["lop"]) == 2
    assert "got lop" in capsys.readouterr().err


@pytest.mark.parametrize("name", results.BENCHMARKS)
def test_every_benchmark_of_the_table_offers_ratios_and_stands_in_it(name: str) -> None:
    tree = ast.parse((BENCHMARKS / f"{name}.py").read_text())
    assert "ratios" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert f"| `{name}.py` |" in results.RESULTS.read_text()
