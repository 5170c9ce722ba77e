"""run: what a reference does not do, and scenarios that an avoider cannot take."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run

REACH = """\
scenario: a hand reaches
duration: 700 ms
avoider: opposite pose
tcp start:
  offset: [0 mm, -30 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [{x} mm, -500 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - reach for tcp: {speed}
        stop at distance: 50 mm
        give up after: 2 s
claims:
  hand distance never below {limit}: holds
"""
ELSEWHERE = (
    REACH.format(x=700, speed="0.2 m/s", limit="20 mm")
    + """\
settings:
  avoidance: {nominal hand position: [840 mm, -900 mm, 100 mm]}
"""
)
MINE = """\
import numpy as np

from safety_harness import Proposal


class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        away = tcp_position_in_base_m - hand_position_in_base_m
        away /= np.linalg.norm(away)
        aside = np.cross(away, [0.0, 0.0, 1.0])
        way = 0.995 * aside / np.linalg.norm(aside) + 0.1 * away
        return Proposal(tcp_position_in_base_m + 0.1 * (way if hand_position_in_base_m[0] > 0.78 else away))
"""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Both violate ``both``, only mine ``plane``, and no network can take ``elsewhere``."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "scenarios"
    folder.mkdir()
    (tmp_path / "mine.py").write_text(MINE)
    for name, x, speed, limit in (("both", 700, "2 m/s", "100 mm"), ("plane", 820, "0.47 m/s", "100 mm")):
        (folder / f"{name}.yaml").write_text(REACH.format(x=x, speed=speed, limit=limit))
    (folder / "elsewhere.yaml").write_text(ELSEWHERE)
    return folder


def report() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path("out/report.json").read_text())
    return found


def test_a_violation_that_the_reference_does_not_have_is_told_and_ends_with_1(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [files / "both.yaml", files / "plane.yaml"]
    assert run(paths, Path("out"), "mine.py:Mine", "opposite pose") == DIFFERS
    out = capsys.readouterr().out
    new = [line for line in out.splitlines() if line.startswith("new violation: ")]
    assert len(new) == 1
    assert new[0].startswith("new violation: plane: hand distance never below 100 mm: -")
    assert "mine.py:Mine violates a claim that opposite pose keeps in 1 of 2 runs" in out
    held = report()["against"]
    assert [run["claims"][0]["change"] for run in held["runs"]] == ["no difference", "new violation"]
    assert "Against opposite pose" in Path("out/report.html").read_text()
    assert "--against 'opposite pose'" in Path("out/report.html").read_text().replace("&#39;", "'")
    assert {file.name for file in Path("out/traces-against").iterdir()} == {"both.trace", "plane.trace"}


def test_a_violation_that_the_reference_has_as_well_is_nothing_new(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([files / "both.yaml"], Path("out"), "mine.py:Mine") == DIFFERS
    assert run([files / "both.yaml"], Path("out"), "mine.py:Mine", "opposite pose") == AS_EXPECTED
    said = capsys.readouterr()
    assert "mine.py:Mine: no violation that opposite pose does not have, in 1 runs" in said.out
    assert "0 of 1 verdicts as expected" in said.out


def test_a_scenario_that_an_avoider_cannot_take_is_told_counted_and_no_pass(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([files / "plane.yaml"], Path("out"), "ensemble") == AS_EXPECTED
    assert run([files / "plane.yaml", files / "elsewhere.yaml"], Path("out"), "ensemble") == DIFFERS
    out, err = capsys.readouterr()
    assert "skipped: elsewhere is unsuitable for ensemble: expected a seen space" in err
    assert "1 of 1 verdicts as expected (1 hold), 1 of 2 scenarios run, 1 unsuitable for ensemble" in out
    found = report()
    assert [one["scenario"] for one in found["runs"]] == ["plane"]
    assert [one["scenario"] for one in found["skipped"]] == ["elsewhere"]
    assert not found["interrupted"]
    page = Path("out/report.html").read_text()
    assert "<strong>Skipped.</strong>" in page
    assert 'class="banner fine"' not in page


def test_what_the_reference_cannot_take_is_skipped_too(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [files / "plane.yaml", files / "elsewhere.yaml"]
    assert run(paths, Path("out"), "opposite pose", "ensemble") == AS_EXPECTED
    assert "1 of 2 scenarios run, 1 unsuitable for ensemble" in capsys.readouterr().out
    assert [one["scenario"] for one in report()["against"]["runs"]] == ["plane"]


def test_nothing_is_run_if_an_avoider_can_take_none(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([files / "elsewhere.yaml"], Path("out"), "ensemble") == BAD_INPUT
    assert "nothing was run" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize("options", [{"avoider": "opposite pose"}, {"against": "opposite pose"}, {}])
def test_a_mistake_in_a_file_is_no_matter_of_avoiders(files: Path, options: dict[str, str]) -> None:
    (files / "plane.yaml").write_text(
        (files / "plane.yaml").read_text().replace("offset: [0 mm", "offset: [9 m")
    )
    assert run([files / "plane.yaml", files / "both.yaml"], Path("out"), **options) == BAD_INPUT
    assert not Path("out").exists()


def test_a_file_that_names_an_avoider_that_cannot_take_it_is_a_mistake(files: Path) -> None:
    own = ELSEWHERE.replace("avoider: opposite pose", "avoider: ensemble")
    (files / "elsewhere.yaml").write_text(own)
    paths = [files / "both.yaml", files / "elsewhere.yaml"]
    assert run(paths, Path("out"), None, "opposite pose") == BAD_INPUT
    assert not Path("out").exists()


@pytest.mark.parametrize("reference", ["opposite pose", "mine.py:Mine"])
def test_a_comparison_with_itself_is_refused(reference: str, capsys: pytest.CaptureFixture[str]) -> None:
    written = f"./{reference}" if ":" in reference else reference
    assert run([Path("any.yaml")], Path("itself"), avoider=reference, against=written) == BAD_INPUT
    assert "a comparison with itself has no findings" in capsys.readouterr().err
    assert fuzz(Path("any.yaml"), out=Path("itself"), avoider=reference, against=written) == BAD_INPUT
    assert "a comparison with itself has no findings" in capsys.readouterr().err
