"""``--against`` takes a controller wherever one is tested: the same draws, and only what it does not do."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.admission.comparison import reference_for
from safety_harness.scenario.model import Driver
from tests.whole.test_own_controller import MINE, PLAN, SPACE, VISIT, command

HURRIED = """

class Hurried(StopAndGo):
    def act(self, seen):
        return Move(tcp_velocity_mps=0.5 * (self.target_in_base_m - seen.tcp_position_in_base_m))
"""
MINE_AGAINST = ("--controller", "mine.py:Hurried", "--against")
QUICK = ("--world", "kinematic", "--out", "out")


def with_both(folder: Path) -> Path:
    """The folder, with two classes, a scenario, a space and a plan of the hurried one."""
    plan = PLAN.replace("StopAndGo", "Hurried").replace("runs: 8", "runs: 4")
    texts = {"mine.py": MINE + HURRIED, "visit.yaml": VISIT, "space.yaml": SPACE, "plan.yaml": plan}
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_both(tmp_path_factory.mktemp("controllers-against"))


@pytest.fixture(autouse=True)
def _there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.mark.parametrize(
    ("tested", "named", "driver"),
    [
        (Driver("mine.py:Mine"), "other.py:Other", True),
        (Driver("mine.py:Mine"), "mc-dropout", False),
        ("mine.py:Mine", "other.py:Other", False),
        ("mine.py:Mine", "stop when near", True),
        (None, "exec:./other", True),
        (None, "opposite pose", False),
    ],
)
def test_a_reference_is_a_controller_where_its_name_or_what_is_tested_says_so(
    tested: str | None, named: str, driver: bool
) -> None:
    assert isinstance(reference_for(tested, named), Driver) is driver


def test_run_tells_what_the_reference_does_not_do_and_no_claim_that_cannot_be_compared() -> None:
    """*Always not repulsing* holds of the reference, and the controller on trial does not report its mode."""
    found = command("run", "visit.yaml", *MINE_AGAINST, "stop when near", *QUICK)
    assert found.exit_code == 0, found.output
    (run,) = json.loads(Path("out/report.json").read_text())["against"]["runs"]
    silent = next(one for one in run["claims"] if one["claim"] == "always not repulsing")
    assert (silent["verdicts"], silent["change"]) == (["inconclusive", "holds"], "no difference")


def test_run_ends_with_1_for_a_violation_that_the_reference_has_not() -> None:
    text = VISIT.replace("never below 600 mm: violated", "never below 1 mm: holds").split("  always")[0]
    Path("faster.yaml").write_text(f"{text}  TCP speed never above 60 mm/s: holds\n")
    found = command("run", "faster.yaml", *MINE_AGAINST, "stop when near", *QUICK)
    assert found.exit_code == 1, found.output
    assert "new violation: faster: TCP speed never above 60 mm/s" in found.output


@pytest.mark.parametrize("words", [("run", "visit.yaml"), ("fuzz", "space.yaml", "--budget", "4")])
def test_a_comparison_with_itself_is_refused(words: tuple[str, ...]) -> None:
    found = command(*words, *MINE_AGAINST, "./mine.py:Hurried", "--out", "itself")
    assert found.exit_code == 2
    assert "a comparison with itself has no findings" in found.output


@pytest.mark.parametrize("words", [("run", "servo.yaml"), ("fuzz", "space.yaml", "--budget", "4")])
@pytest.mark.parametrize("named", ["visual servo", "mc-dropout"])
def test_so_is_what_a_file_names_already_or_has_by_default(words: tuple[str, ...], named: str) -> None:
    Path("servo.yaml").write_text(re.sub("(?m)^controller:.*\n", "", VISIT))
    found = command(*words, "--against", named, "--out", "itself")
    assert found.exit_code == 2, found.output
    assert "a comparison with itself has no findings" in found.output


def test_fuzz_searches_for_what_only_the_controller_on_trial_violates() -> None:
    found = command(
        "fuzz", "space.yaml", *MINE_AGAINST, "mine.py:StopAndGo", "--budget", "4", "--out", "found"
    )
    assert found.exit_code in (0, 1), found.output
    told = json.loads(Path("found/findings.json").read_text())["against"]
    assert told["reference"] == "mine.py:StopAndGo"
    assert "mine.py:Hurried violates a claim that mine.py:StopAndGo keeps in" in found.output
