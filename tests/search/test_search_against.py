"""A search against a reference finds what only the avoider on trial violates, and nothing of its equal."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.claims.properties.against import VerdictChange
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run
from safety_harness.scenario.model import Verdict
from safety_harness.search import session as search_session
from safety_harness.search.against import Reference, difference, difference_of
from safety_harness.search.confirm import Complaint, Confirm
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space
from tests.search.short_space import TEXT

SPACE = TEXT.replace("400 ms", "700 ms").replace("150 mm", "100 mm")
PLANE_M = 0.78
MINE = f"""\
import numpy as np

from safety_harness import Proposal


class Equal:
    name = "equal"

    def way(self, hand, tcp):
        return (tcp - hand) / np.linalg.norm(tcp - hand)

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        way = self.way(hand_position_in_base_m, tcp_position_in_base_m)
        return Proposal(tcp_position_in_base_m + 0.1 * way)


class Sideways(Equal):
    name = "sideways beyond a plane"

    def way(self, hand, tcp):
        away = super().way(hand, tcp)
        if hand[0] <= {PLANE_M}:
            return away
        aside = np.cross(away, [0.0, 0.0, 1.0])
        return 0.995 * aside / np.linalg.norm(aside) + 0.1 * away
"""
REFERENCE = "opposite pose"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 15)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    (tmp_path / "space.yaml").write_text(SPACE)
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path


def test_what_leads_is_negative_exactly_where_only_the_avoider_on_trial_violates() -> None:
    margins = np.linspace(-0.3, 0.3, 13)
    for mine in margins:
        for reference in margins:
            found = difference(mine, reference, 0.1)
            assert (found < 0.0) == (mine < 0.0 and reference >= 0.01)
            if found < 0.0:
                assert math.isclose(found, mine - reference)


def test_what_leads_falls_on_the_way_from_no_difference_to_a_violation_that_is_new() -> None:
    way = [(0.3, 0.3), (0.2, 0.3), (0.1, 0.3), (0.01, 0.3), (-0.01, 0.3), (-0.1, 0.3)]
    led = [difference(*pair, 0.1) for pair in way]
    assert led == sorted(led, reverse=True)
    assert difference(-0.3, -0.1, 0.1) > difference(-0.3, -0.01, 0.1) > 0.0


@pytest.mark.parametrize(("mine", "reference"), [(None, 0.1), (math.nan, 0.1), (0.1, None), (0.1, math.nan)])
def test_nothing_is_known_without_a_margin(mine: float | None, reference: float | None) -> None:
    assert math.isnan(difference(mine, reference, 0.1))


def test_a_violation_counts_where_the_reference_has_no_margin() -> None:
    assert difference(-0.2, None, 0.1) == -0.2


@pytest.mark.parametrize(("reference", "counts"), [(0.07, False), (0.14, False), (0.15, True)])
def test_a_share_of_seven_counts_where_the_reference_keeps_it_by_one_of_them(
    reference: float, counts: bool
) -> None:
    def share(margin: float, verdict: Verdict) -> Evaluation:
        return Evaluation(
            sentence="-", verdict=verdict, unit=Unit.FRACTION, margin=margin, reason="-", exercised=7
        )

    both = share(-0.07, Verdict.VIOLATED), share(reference, Verdict.HOLDS)
    assert (difference_of(*both) < 0.0) == counts


@pytest.mark.parametrize("alias", ["mine2.py:Equal", "link.py:Equal", "here/mine.py:Equal"])
def test_a_copy_and_an_alias_of_what_is_tested_are_no_reference(
    alias: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "mine2.py").write_text(MINE)
    (folder / "link.py").symlink_to("mine.py")
    (folder / "here").symlink_to(".")
    space = Path("space.yaml")
    assert fuzz(space, out=Path("out"), avoider="mine.py:Equal", against=alias, budget=4) == BAD_INPUT
    assert "a comparison with itself has no findings" in capsys.readouterr().err


def test_the_file_of_one_of_ours_is_that_one_and_a_program_beside_other_files_is_another(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space, copy = Path("space.yaml"), folder / "copied.safetensors"
    copy.write_bytes(shipped_model("student").read_bytes())
    assert fuzz(space, out=Path("out"), avoider="student", against=str(copy), budget=4) == BAD_INPUT
    assert "a comparison with itself has no findings" in capsys.readouterr().err
    (folder / "apart").mkdir()
    (folder / "apart/mine.py").write_text(MINE)
    other = "apart/mine.py:Equal"
    assert fuzz(space, out=Path("out"), avoider="mine.py:Equal", against=other, budget=4) == AS_EXPECTED


def test_shrinking_keeps_to_what_the_reference_does_not_violate(folder: Path) -> None:
    reference = Reference(REFERENCE)
    trials = Trials(
        read_space(folder / "space.yaml"), in_kinematic, avoider="mine.py:Sideways", reference=reference
    )
    points = np.array([[0.67, 0.71, 0.17], [0.67, 0.71, 0.9]])  # slow; too fast for both
    found = trials(points, 0)
    assert [run.claims[0].change for run in trials.differences] == [VerdictChange.NEW, VerdictChange.NONE]
    assert (found.margins[:, 0] < 0.0).tolist() == [True, False]
    of_mine, of_both = Complaint(trials.claims[0]), Complaint(trials.claims[0], reference=reference)
    for number, (point, new) in enumerate(zip(points, (True, False), strict=True)):
        scenario = trials.scenario(point, number)
        assert Confirm(of_mine, in_kinematic)(scenario)
        assert Confirm(of_both, in_kinematic)(scenario) is new


def test_an_avoider_that_is_worse_beyond_a_plane_is_found_there_within_64_runs(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space, mine = Path("space.yaml"), "mine.py:Sideways"
    assert fuzz(space, out=Path("out"), avoider=mine, against=REFERENCE, budget=64) == DIFFERS
    said = capsys.readouterr()
    assert "with opposite pose on the same draws: holds, +" in said.out
    assert "mine.py:Sideways violates a claim that opposite pose keeps in" in said.err
    assert "--against 'opposite pose'" in said.err
    found = json.loads((folder / "out" / "findings.json").read_text())
    assert found["against"]["reference"] == REFERENCE
    distinct = [group for group in found["distinct"] if group["complaint"].startswith("hand distance")]
    assert distinct
    for group in distinct:  # the second coordinate is where the hand starts, from 700 mm to 900 mm
        assert 0.7 + 0.2 * group["worst_point"][1] > PLANE_M - 0.02
        assert group["worst_margin_si"] < 0.0
    (file,) = sorted((folder / "out").glob("*.yaml"))
    text = file.read_text()
    assert "against opposite pose" in text
    assert "with opposite pose on the same draws: holds, +" in text
    capsys.readouterr()
    assert run([file], Path("again"), against=REFERENCE) == DIFFERS
    assert "new violation: " in capsys.readouterr().out


def test_an_equal_of_the_reference_has_nothing_that_it_does_not_do_as_well(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space, mine = Path("space.yaml"), "mine.py:Equal"
    assert fuzz(space, out=Path("out"), avoider=mine, against=REFERENCE, budget=24) == AS_EXPECTED
    said = capsys.readouterr()
    assert "nothing found that opposite pose does not do as well, in 24 runs" in said.err
    assert said.out == ""
    found = json.loads((folder / "out" / "findings.json").read_text())
    assert found["distinct"] == []
    assert [claim["least_margin_si"] for claim in found["claims"]] == [None, None]
    assert fuzz(space, out=Path("alone"), avoider=mine, budget=12) == DIFFERS


def test_a_reference_that_there_is_not_ends_a_search_at_once(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(Path("space.yaml"), out=Path("out"), against="no-such-avoider", budget=4) == BAD_INPUT
    assert "--against" in capsys.readouterr().err
