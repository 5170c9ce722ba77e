"""The whole path of a user with a broken avoider: fuzz, run the file, pytest it, replay its trace, repair."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pytest_sessions import Sessions

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.attribution import search_attribution
from safety_harness.report import search_job
from safety_harness.search import counterexample as counterexample_module
from safety_harness.search import session as search_session
from safety_harness.search.sampling import UniformSampling

SPACE = """\
scenario space: a hand from the right
duration: 300 ms
avoider: {avoider}
tcp start:
  offset: [from -40 mm to 40 mm, from -60 mm to 60 mm, from 0 mm to 40 mm]
hands:
  - hand: right hand
    starts at: {{box: [[700 mm, -600 mm, 250 mm], [950 mm, -480 mm, 550 mm]]}}
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - reach for tcp: from 0.5 m/s to 2 m/s
        stop at distance: 50 mm
        give up after: 2 s
claims:
  proposed repulsive poses reachable: holds
  joint speeds within limits: holds
"""
AVOIDER = """\
import numpy as np

from safety_harness import Proposal


class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        low_m = max(tcp_position_in_base_m[2] - hand_position_in_base_m[2], 0.0)
        way = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(tcp_position_in_base_m + way / np.linalg.norm(way) * (0.1 + 40.0 * low_m))
"""
REPAIRED = AVOIDER.replace("40.0 * low_m", "0.0 * low_m")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 5)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 2)
    monkeypatch.setattr(counterexample_module, "DRAWS", 2)
    (tmp_path / "mine.py").write_text(AVOIDER)
    (tmp_path / "space.yaml").write_text(SPACE.format(avoider="mine.py:Mine"))
    return tmp_path


def test_a_bug_is_found_run_again_tested_replayed_and_gone_once_it_is_repaired(
    project: Path, sessions: Sessions, capsys: pytest.CaptureFixture[str]
) -> None:
    out, own = project / "out", f"{project / 'mine.py'}:Mine"
    assert fuzz(project / "space.yaml", out=out, budget=40) == DIFFERS
    (file,) = out.glob("*.yaml")
    assert sorted(one.name for one in out.iterdir() if one.is_file()) == sorted(
        ["coverage.svg", "findings.json", "fuzz.html", file.name, file.with_suffix(".trace").name]
    )
    assert json.loads((out / "findings.json").read_text())["confirmed"] >= 1

    assert run([file], project / "again") == AS_EXPECTED
    tested = ("-q", "-p", "no:cacheprovider", str(file))
    kept = sessions(project, *tested)
    assert kept.returncode == 0, kept.stdout
    trace = file.with_suffix(".trace")
    assert replay(trace) == BAD_INPUT  # a trace must not execute a program that it names itself
    assert replay(trace, own) == AS_EXPECTED
    assert "identical" in capsys.readouterr().out

    (project / "mine.py").write_text(REPAIRED)
    assert replay(trace, own) == DIFFERS
    assert "first difference at decision 0 (t = " in capsys.readouterr().out
    broken = sessions(project, *tested)
    assert broken.returncode == 1
    assert "proposed repulsive poses reachable" in broken.stdout


def test_a_baseline_of_uniform_sampling_itself_is_a_mistake(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = fuzz(project / "space.yaml", out=project / "out", searcher="uniform", baseline=True)
    assert code == BAD_INPUT
    assert "another searcher" in capsys.readouterr().err


def test_what_only_the_baseline_meets_is_shrunk_and_written_too(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Blind(UniformSampling):
        """Proposes one place over and over, where nothing is wrong."""

        name = "blind"

        def propose(self, count: int):  # type: ignore[no-untyped-def]
            return super().propose(count) * 0.0 + 0.99

    monkeypatch.setattr(search_job, "searcher_named", lambda name: Blind)
    out = project / "out"
    assert fuzz(project / "space.yaml", out=out, budget=32, searcher="blind", baseline=True) == DIFFERS
    assert "uniform: tried 32/32" in capsys.readouterr().err
    found = json.loads((out / "findings.json").read_text())
    assert found["baseline"]["tried"] == found["tried"] == 32
    assert found["baseline"]["claims"][0]["violated"] > found["claims"][0]["violated"] == 0
    (file,) = out.glob("*.yaml")
    assert "of searcher uniform" in file.read_text()
    assert "of searcher uniform led to it" in (out / "fuzz.html").read_text()
    assert list((out / "as-found" / "baseline").glob("*.yaml"))
