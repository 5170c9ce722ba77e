"""``--safety-against``: tests fail only for what a reference does not do; and what an avoider cannot take."""

from __future__ import annotations

from pathlib import Path

import pytest

OPPOSITE, NEAREST = "opposite pose", "nearest candidate"
ELSEWHERE = "settings:\n  avoidance: {nominal hand position: [840 mm, -900 mm, 100 mm]}\n"
AS_WELL = """\
import numpy as np

from safety_harness import DEFAULTS, Proposal


class AsWell:
    name = "as well"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        away = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(tcp_position_in_base_m + DEFAULTS.avoidance.radius_m * away / np.linalg.norm(away))
"""


def test_a_violation_that_the_reference_has_too_is_skipped_and_never_passed(run, project: Path) -> None:
    run("fast.yaml").assert_outcomes(passed=1, failed=1)
    result = run("fast.yaml", "--safety-against", NEAREST, "-rs")
    result.assert_outcomes(passed=1, skipped=1)
    result.stdout.fnmatch_lines(
        [
            "*hand distance never below 50 mm: violated with nearest candidate too (-* mm against -* mm)",
        ]
    )
    result.stdout.fnmatch_lines(
        [
            "each file's own avoider violates a claim that nearest candidate keeps in 0 of 1 runs; the other "
            "way round in 0 (p = 1)"
        ]
    )


def test_a_scenario_that_names_the_reference_already_is_not_compared_with_itself(run, project: Path) -> None:
    result = run("fast.yaml", "--safety-against", OPPOSITE, "-rs")
    result.assert_outcomes(skipped=2)
    assert result.ret == 1
    result.stdout.fnmatch_lines(["*opposite pose itself; a comparison with itself has no findings*"])


def test_a_violation_that_the_reference_does_not_have_fails_and_says_so(run, project: Path) -> None:
    fine = (
        (project / "fast.yaml").read_text().replace("hand distance never below 50 mm", "the avoider answered")
    )
    (project / "fast.yaml").write_text(fine)
    (project / "avoiders.py").write_text(
        (project / "avoiders.py")
        .read_text()
        .replace("return Proposal(tcp", "raise ValueError(1)\n        return (tcp")
    )
    options = ("--avoider", "avoiders.py:Upwards", "--safety-against", OPPOSITE)
    result = run("fast.yaml", *options)
    result.assert_outcomes(failed=2)  # that the avoider answered is asked of every test
    result.stdout.fnmatch_lines(["*new violation: * against +0 with opposite pose"])
    result.stdout.fnmatch_lines(
        ["avoiders.py:Upwards violates a claim that opposite pose keeps in 1 of 1 runs;*"]
    )
    (project / "same.py").write_text((project / "avoiders.py").read_text())
    both = run("fast.yaml", *options[:2], "--safety-against", "same.py:Upwards")
    both.assert_outcomes(skipped=2)
    itself = run("fast.yaml", *options[:2], "--safety-against", "./avoiders.py:Upwards")
    assert itself.ret == pytest.ExitCode.USAGE_ERROR
    itself.stderr.fnmatch_lines(["*expected another reference than avoiders.py:Upwards*"])


def test_draws_that_the_reference_violates_too_skip_a_space_and_a_python_test(run, project: Path) -> None:
    (project / "opposite.py").write_text(AS_WELL)
    options = ("--safety-against", "opposite.py:AsWell", "--safety-derandomize", "-rs")
    run("reaches.yaml", *options).assert_outcomes(passed=1, skipped=1)
    result = run("test_it.py", *options)
    result.assert_outcomes(passed=1, skipped=1)
    result.stdout.no_fnmatch_line("*(p = *")  # Hypothesis chose the runs
    assert not (project / ".safety-harness").exists()


def test_a_scenario_that_an_avoider_cannot_take_is_skipped_with_the_reason(run, project: Path) -> None:
    (project / "elsewhere.yaml").write_text((project / "fine.yaml").read_text() + ELSEWHERE)
    run("elsewhere.yaml").assert_outcomes(passed=2)
    result = run("fine.yaml", "elsewhere.yaml", "--avoider", "ensemble", "-rs")
    result.assert_outcomes(passed=2, skipped=2)
    result.stdout.fnmatch_lines(["*elsewhere is unsuitable for ensemble: expected a seen space*"])
    result.stdout.fnmatch_lines(["not run: 2 tests of scenarios that ensemble cannot take"])
    assert result.ret == 0
    alone = run("elsewhere.yaml", "--avoider", "ensemble")
    alone.assert_outcomes(skipped=2)
    assert alone.ret == 1  # nothing was shown


def test_a_space_that_an_avoider_cannot_take_is_skipped_too(run, project: Path) -> None:
    (project / "reaches.yaml").write_text((project / "reaches.yaml").read_text() + ELSEWHERE)
    run("reaches.yaml", "--avoider", "ensemble").assert_outcomes(skipped=2)


def test_a_reference_that_there_is_not_ends_the_session_at_once(run, project: Path) -> None:
    result = run("fast.yaml", "--safety-against", "no-such-avoider")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*--safety-against*"])
