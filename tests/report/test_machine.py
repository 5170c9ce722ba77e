from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import factory
import numpy as np
import pytest

from safety_harness.claims.properties.base import Unit
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.machine import SI_UNITS, report_data, write_json


def written(path: Path, *runs: JudgedRun, interrupted: bool = False) -> dict[str, Any]:
    write_json(path, report_data(runs, interrupted=interrupted))

    def no_constant(text: str) -> float:
        raise AssertionError(f"{text} is not JSON")

    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"), parse_constant=no_constant)
    return found


def test_every_claim_is_there_with_its_margin_in_full_precision(tmp_path: Path) -> None:
    run = factory.violated_run()
    margin_m = -0.1 - 0.2
    run = replace(run, evaluations=(replace(run.evaluations[0], margin=margin_m), *run.evaluations[1:]))
    (found,) = written(tmp_path / "deep" / "report.json", run)["runs"]
    assert found["claims"][0] == {
        "claim": factory.APART,
        "verdict": "violated",
        "expected": "holds",
        "margin_si": margin_m,
        "unit": "m",
        "worst_time_s": 8.6,
        "reason": "right hand 112.9 mm from wrist 1",
        "exercised": 120,
        "unmeasured": [],
        "parts": [],
    }
    assert [claim["unit"] for claim in found["claims"]] == ["m", "m/s", "s"]
    assert (found["scenario"], found["seed"], found["complete"]) == ("two-hands", 7, True)
    assert found["decisions"] == {
        "made": 3,
        "proposed": 1,
        "opposite": 1,
        "stops": 1,
        "faults": 0,
        "unanswered": 0,
    }
    overruling = found["overruling"]
    assert [overruling[name] for name in ("proposals", "overruled", "overruled_stopped")] == [3, 2, 1]
    assert written(tmp_path / "r.json", run, run)["overruling"]["opposite"]["overruled"] == 4


def test_how_often_each_claim_was_put_to_the_test_is_there(tmp_path: Path) -> None:
    first = factory.violated_run()
    write_json(tmp_path / "r.json", report_data([first, first], interrupted=False))
    coverage = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["coverage"]
    assert [row["claim"] for row in coverage] == [e.sentence for e in first.evaluations]
    assert coverage[0] == {
        "claim": factory.APART,
        "runs": 2,
        "exercised": 2,
        "occasions": 240,
        "holds": 0,
        "violated": 2,
        "inconclusive": 0,
        "unmeasured": 0,
        "worst_margin_si": first.evaluations[0].margin,
        "worst_scenario": "two-hands",
        "untested": False,
        "untested_for": None,
    }


def test_what_has_no_number_is_null_and_what_json_cannot_write_is_text(tmp_path: Path) -> None:
    run = factory.no_hands_run()
    (found,) = written(tmp_path / "r.json", run)["runs"]
    (claim,) = found["claims"]
    assert (claim["margin_si"], claim["worst_time_s"], found["trace_file"]) == (None, None, None)
    endless = replace(run, evaluations=(replace(run.evaluations[0], margin=np.inf),))
    (claim,) = written(tmp_path / "r.json", endless)["runs"][0]["claims"]
    assert claim["margin_si"] == "inf"


def test_a_cut_short_run_and_an_interrupted_report_say_so(tmp_path: Path) -> None:
    found = written(tmp_path / "r.json", factory.truncated_run(), interrupted=True)
    assert found["interrupted"] is True
    assert (found["runs"][0]["complete"], found["runs"][0]["ended"]) == (
        False,
        "the arm reached a joint limit",
    )


def test_the_trace_file_is_named_with_the_hash_of_its_bytes(tmp_path: Path) -> None:
    file = tmp_path / "reach-in.trace"
    file.write_bytes(b"not really a trace")
    (found,) = written(tmp_path / "r.json", replace(factory.holds_run(), trace_file=file))["runs"]
    assert found["trace_file"] == "reach-in.trace"  # outside the working directory: no path of this machine
    assert found["trace_sha256"] == hashlib.sha256(b"not really a trace").hexdigest()


def test_a_trace_file_that_is_gone_is_an_error_and_leaves_the_old_report(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    before = written(path, factory.holds_run())
    with pytest.raises(FileNotFoundError):
        write_json(
            path, report_data([replace(factory.holds_run(), trace_file=tmp_path / "gone")], interrupted=False)
        )
    assert json.loads(path.read_text(encoding="utf-8")) == before


def test_markup_and_text_that_cannot_be_encoded_survive(tmp_path: Path) -> None:
    run = factory.hostile_run()
    run = replace(run, evaluations=(replace(run.evaluations[0], reason="\udcff"),))
    (found,) = written(tmp_path / "r.json", run)["runs"]
    assert found["title"] == f"title {factory.HOSTILE}"
    assert found["claims"][0]["reason"] == "\udcff"


def test_every_unit_has_its_si_symbol() -> None:
    assert set(SI_UNITS) == set(Unit)
