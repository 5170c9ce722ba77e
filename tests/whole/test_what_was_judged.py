"""A green result is of what the user meant: every file of a folder, this system, this claim, this reason."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from safety_harness.base.exceptions import InputError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.main import app
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.space.read import parse_space
from tests.whole.test_own_controller import search_little_in

BOUND = "hand distance never below 50 mm"
REACH = """\
scenario: a fast reach
duration: 1.2 s
avoider: opposite pose
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
hands:
  - hand: right hand
    starts at: [1000 mm, -500 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - {reach for tcp: 2 m/s, stop at distance: 20 mm, give up after: 2 s}
claims:
  hand distance never below 50 mm: violated
"""
INTO = """\
import numpy as np
from safety_harness import Proposal

class Into:
    name = "into"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        ahead = hand_position_in_base_m - tcp_position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.1 * ahead / np.linalg.norm(ahead))
"""
STILL = """\
from safety_harness import Move

class Still:
    name = "still"
    sees = ("joints",)
    reports = ()

    def reset(self, **start): pass

    def act(self, seen): return Move()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reach.yaml").write_text(REACH)
    (tmp_path / "into.py").write_text(INTO)
    (tmp_path / "still.py").write_text(STILL)
    return tmp_path


def command(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def ran(*words: str) -> Result:
    return command("run", *words, "--world", "kinematic", "--out", "out")


def test_a_folder_means_every_file_of_ours_below_it_and_names_what_is_left_aside(folder: Path) -> None:
    """Whatever their endings, as pytest collects them; the violation of each is found."""
    some = folder / "some"
    for name in ("a.yaml", "b.yml", "c.YAML", "deep/er/d.yaml"):
        (some / name).parent.mkdir(parents=True, exist_ok=True)
        (some / name).write_text(REACH.replace(": violated", ": holds"))
    (some / "child.yml").write_text("extends: a.yaml\nseed: 3\n")
    others = {
        "space.yaml": REACH.replace("scenario:", "scenario space:").replace("2 m/s", "from 1 m/s to 2 m/s"),
        "load.yml": "scenario: checkout\nusers: 10\n",
        "venv/x.yaml": REACH,
    }
    for name, text in others.items():
        (some / name).parent.mkdir(exist_ok=True)
        (some / name).write_text(text)
    result = ran("some")
    assert result.exit_code == DIFFERS
    for name in ("a", "b", "c", "d", "child"):
        assert re.search(rf"^VIOLATED  {name}: {BOUND} .*\(expected holds\)$", result.output, re.MULTILINE)
    assert "left aside, a scenario space: some/space.yaml" in result.output
    assert "left aside, not ours: some/load.yml" in result.output
    found = command("validate", "some").stdout.splitlines()
    usable = {Path(line.split()[1].rstrip(":")).name for line in found if line.startswith("ok ")}
    assert usable == {"a.yaml", "b.yml", "c.YAML", "d.yaml", "child.yml", "space.yaml"}


def test_an_avoider_that_makes_the_rows_of_a_matrix_equal_is_refused(folder: Path) -> None:
    """Else a row that is named after one avoider would hold for another."""
    matrix = "matrix: {who: {opposite: {avoider: opposite pose}, into: {avoider: 'into.py:Into'}}}\n"
    (folder / "rows.yaml").write_text(matrix + REACH.replace("avoider: opposite pose\n", ""))
    result = ran("rows.yaml", "--avoider", "nearest candidate")
    assert result.exit_code == BAD_INPUT
    assert "the same scenario in rows[opposite], rows[into]" in result.output
    assert ran("rows.yaml").exit_code == AS_EXPECTED
    (folder / "rows.yaml").write_text("matrix: {at: {slow: {seed: 1}, fast: {seed: 2}}}\n" + REACH)
    assert ran("rows.yaml", "--avoider", "nearest candidate").exit_code == AS_EXPECTED


def test_rows_of_a_matrix_that_are_the_same_scenario_are_refused(folder: Path) -> None:
    """A row named "late" would hold for a sensor that is not late; other claims make another row."""
    for late in ("{}", "{hand sensor: {kind: ideal}}"):
        matrix = f"matrix: {{sensor: {{ideal: {{}}, late: {late}}}}}\n"
        (folder / "rows.yaml").write_text(matrix + REACH)
        for result in (ran("rows.yaml"), command("validate", "rows.yaml")):
            assert result.exit_code == BAD_INPUT
            assert "rows[late] is the same as rows[ideal]" in result.output
    claims = "matrix: {claim: {both: {claims: {joint positions within limits: holds}}, one: {}}}\n"
    (folder / "rows.yaml").write_text(claims + REACH)
    assert ran("rows.yaml").exit_code == AS_EXPECTED


def test_every_verdict_names_avoider_shield_and_what_is_not_the_default(folder: Path) -> None:
    changed = REACH.replace("avoider: opposite pose\n", "shield: speed and separation\n")
    (folder / "shielded.yaml").write_text(changed + "settings: {avoidance: {gate: reach}}\n")
    result = ran("shielded.yaml", "--avoider", "into.py:Into")
    assert (
        "tested in shielded: avoider into, shield speed and separation, avoidance.gate reach" in result.output
    )


def test_an_expected_violation_may_have_a_bound_and_a_larger_one_is_not_expected(folder: Path) -> None:
    assert ran("reach.yaml").exit_code == AS_EXPECTED
    (claim,) = json.loads((folder / "out/report.json").read_text())["runs"][0]["claims"]
    margin = claim["margin_si"]
    for most_m, code in ((-margin + 1e-3, AS_EXPECTED), (-margin - 1e-3, DIFFERS)):
        words = f"violated by at most {1e3 * most_m:.3f} mm"
        (folder / "bound.yaml").write_text(REACH.replace(": violated", f": {words}"))
        assert ran("bound.yaml").exit_code == code
        scenario = read_scenario(folder / "bound.yaml")
        assert parse_scenario(write_scenario(scenario)).claims == scenario.claims
    (folder / "bound.yaml").write_text(REACH.replace(": violated", ": violated by at most 5 deg"))
    assert "violated by at most a margin in mm" in ran("bound.yaml").output
    (folder / "bound.yaml").write_text(REACH.replace(": violated", ": violated by at most -3 mm"))
    assert ran("bound.yaml").exit_code == BAD_INPUT


def test_a_space_expects_no_bound() -> None:
    space = REACH.replace("scenario:", "scenario space:").replace("2 m/s", "from 1 m/s to 2 m/s")
    with pytest.raises(InputError, match="without a bound, in a space"):
        parse_space(space.replace(": violated", ": violated by at most 5 mm"))


def test_a_violation_that_was_expected_of_another_avoider_is_not_ok_in_silence() -> None:
    alone, other = ran("reach.yaml"), ran("reach.yaml", "--avoider", "into.py:Into")
    words = "expected of another than --avoider: it may be for another reason"
    assert words not in alone.output
    assert re.search(rf"^violated, as expected  {BOUND} .*\({words}\)$", other.output, re.MULTILINE)


def test_a_claim_that_cannot_concern_a_controller_is_not_applicable(folder: Path) -> None:
    """It counts neither for nor against; where no claim concerns it, nothing is shown."""
    of_others = "  proposals lead away to within 10 mm: holds\n  task pauses at most 10 s: holds\n"
    (folder / "both.yaml").write_text(
        REACH.replace(": violated", ": violated\n  trace finite and monotone: holds") + of_others
    )
    result = ran("both.yaml", "--controller", "still.py:Still")
    assert result.exit_code == AS_EXPECTED, result.output
    assert "2 of 2 verdicts as expected" in result.output
    assert "2 claims not applicable to the controller" in result.output
    (folder / "others.yaml").write_text(REACH.partition("claims:")[0] + "claims:\n" + of_others)
    assert ran("others.yaml", "--controller", "still.py:Still").exit_code == DIFFERS


def test_a_search_finds_no_fault_in_a_controller_for_want_of_an_avoider(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search_little_in(folder, monkeypatch)
    space = REACH.replace("scenario:", "scenario space:").replace("2 m/s", "from 1 m/s to 2 m/s")
    space += "  proposals lead away to within 10 mm: violated\n"
    (folder / "space.yaml").write_text(space)
    result = command(
        "fuzz", "space.yaml", "--controller", "still.py:Still", "--budget", "8", "--out", "found"
    )
    assert "NOT FOUND" not in result.output
    assert "not applicable to the controller: proposals lead away to within 10 mm" in result.output
    assert "tested in space: controller still.py:Still" in result.output
