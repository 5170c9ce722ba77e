"""``pytest scenarios/`` without any Python: an item a claim, and mistakes told at their place."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.scenario.ours import is_ours
from tests.basis import rests_on
from tests.testing.plugin.conftest import INI

DISTANCE, SPEED = "hand distance never below 50 mm", "TCP speed never above 250 mm/s"


def test_claims_are_items_that_k_and_ids_and_lf_select(run, project: Path) -> None:
    first = run("fast.yaml", "fine.yaml", "-v")
    first.assert_outcomes(passed=3, failed=1)
    first.stdout.fnmatch_lines([f"fast.yaml::{DISTANCE} FAILED*", f"fast.yaml::{SPEED} PASSED*"])
    run("fast.yaml", "fine.yaml", "--lf").assert_outcomes(failed=1)
    run("fast.yaml", "fine.yaml", "-k", "speed").assert_outcomes(passed=2, deselected=2)
    run(f"fine.yaml::{DISTANCE}").assert_outcomes(passed=1)


def test_a_failure_tells_margin_moment_decision_picture_and_commands(
    run, pytester: pytest.Pytester, project: Path
) -> None:
    """In the world that is taken where no setting names one."""
    pytest.importorskip("pybullet")
    pytester.makeini(INI)
    result = run("fast.yaml")
    assert rests_on(result.stdout.str(), "PyBullet")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            f"{DISTANCE}: violated",
            "  margin    -* mm at *.* s",
            "  decision  * of *, at *.* s, because: *",
            "  predicted hand at (*) mm, TCP at (*) mm",
            "  chosen    (*) mm: *",
            "hand distance [[]mm[]]",
            "    50 |*-*",
            "*! the worst moment*",
            "to see it again:",
            f"  pytest 'fast.yaml::{DISTANCE}'",
            "  safety-harness run fast.yaml",
            "claim *runs *exercised*",
            f"{DISTANCE} * 1 *",
        ]
    )
    result.stdout.no_fnmatch_line("*Traceback*")


def test_the_combinations_of_a_matrix_and_the_members_of_a_suite_are_nodes(run, project: Path) -> None:
    text = (project / "fine.yaml").read_text().replace("avoider: opposite pose\n", "")
    axes = (
        "matrix:\n  by:\n    opposite: {avoider: opposite pose}\n    nearest: {avoider: nearest candidate}\n"
    )
    (project / "both.yaml").write_text(text + axes)
    (project / "all.yaml").write_text("suite: both\nscenarios: [fine.yaml, reaches.yaml]\n")
    collected = run("both.yaml", "all.yaml", "--collect-only", "-q")
    collected.stdout.fnmatch_lines(
        [
            f"both.yaml::opposite::{DISTANCE}",
            f"both.yaml::nearest::{SPEED}",
            f"all.yaml::fine::{DISTANCE}",
            f"all.yaml::reaches::{SPEED}",
        ]
    )
    run(f"both.yaml::nearest::{SPEED}").assert_outcomes(passed=1)


def test_a_suffix_in_capitals_is_one(run, project: Path) -> None:
    (project / "fine.yaml").rename(project / "FINE.YAML")
    result = run("--collect-only", "-q", ".")
    result.stdout.fnmatch_lines([f"FINE.YAML::{SPEED}"])


def test_mistakes_are_told_at_collection_without_our_frames(run, project: Path) -> None:
    (project / "unit.yaml").write_text((project / "fine.yaml").read_text().replace("1.2 s", "1.2 parsec"))
    (project / "claim.yaml").write_text((project / "fine.yaml").read_text().replace("TCP speed", "TCP sped"))
    (project / "test_bad.py").write_text((project / "test_it.py").read_text().replace("reaches", "nowhere"))
    result = run()
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(["claim.yaml:16: claims.TCP sped*", "  hint *did you mean*"])
    result.stdout.fnmatch_lines(["unit.yaml:2: duration", "  expected a time *", "  got *parsec"])
    result.stdout.fnmatch_lines(["nowhere.yaml", "  got *no such file*", "  asked for at test_bad.py:6"])
    result.stdout.no_fnmatch_line("*Traceback*")
    result.stdout.no_fnmatch_line("*safety_harness/*.py:*")


@pytest.mark.parametrize(
    "text",
    [
        "scenario: a hand\nduration: 1 s\nhand sensor: {}\n",
        "Scenario: a hand\nclaims: {no moving part touches a hand: holds}\n",
        "scenario: cannot be parsed }}\nhands: [\n",
        "extends: shipped:fast-reach\n",
        "scenario space: hands\nseed: 1\n",
        "scenario: >\n  folded\nextends: base.yaml\n",
        "# a comment\nsuite: all of them\nscenarios: [shipped:fast-reach]\n",
        "'scenario': quoted\r\nclaims:\r\n  no moving part touches a hand: holds\r\n",
        "{scenario: in braces, hands: []}\n",
        "  scenario: indented\n  hands: []\n",
        "suite:\n  on its own line\nscenarios: [some.yaml]\n",
        "? scenario space # of a complex key\n: x\nseed: 1\n",
        f"{'# late' * 20_000}\nscenario: x\nhands: []\n",
    ],
)
def test_scenario_files_are_known_by_their_keys(tmp_path: Path, text: str) -> None:
    file = tmp_path / "some.yaml"
    file.write_text(text)
    assert is_ours(file)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "services:\n  web:\n    image: x\n    extends: base\n",
        "scenario:\n  name: default\n",
        "name: test\non: push\njobs: {}\n",
        "matrix: [1, 2]\n",
        "about: a scenario: of a kind\n",
        "seed: 1\nrobot: ur10\ncamera: {}\n",
        "scenario: of another program\n",
        "scenario: checkout at peak\nduration: 5 m\nusers: 100\n",
        "scenario: chaos\nseed: 1\nfaults: [{kill: web}]\nmatrix: {a: [1]}\n",
        "scenario: log in\nclaims: {sub: alice, scope: read}\n",
        "scenario: a street\nextends: some.json\ncamera: {fov: 90}\nobject: car\n",
        "suite: api\nseed: 1\nscenarios: [login, checkout]\n",
        "plan: of ours\nscenario: x\nclaims: []\n",
        "{plan: of ours, scenario: x, claims: []}\n",
        "a:\n  scenario: nested\n  hands: []\n",
        "{scenario: checkout, users: 10}\n",
        "{scenario: , hands: 2}\n",
        "{hands: 2, scenario: cannot be parsed }}\n",
        "\x00\xff",
    ],
)
def test_other_yaml_files_are_left_alone(tmp_path: Path, text: str) -> None:
    file = tmp_path / "some.yaml"
    file.write_bytes(text.encode("latin-1"))
    assert not is_ours(file)
