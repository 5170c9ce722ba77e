"""Plans: what they say, what is refused with its place, and what makes two of them different."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError, ScenarioError
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.assurance.campaign.identity import Identity, PlanFile, unpacked
from safety_harness.extensions.assurance.campaign.plan import read_plan, stratum_number
from safety_harness.scenario.kinds import FileKind, kind_of
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT

ROOT = Path(__file__).parents[3]


def test_a_plan_is_what_its_text_says(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    assert (plan.name, plan.title, plan.about) == ("plan", "a hand nearby", "a test")
    assert plan.world is KINEMATIC
    assert plan.confidence == 0.95
    assert [(one.name, one.runs) for one in plan.strata] == [("near", 30), ("nearer", 20)]
    first, second = plan.claims
    assert (first.target, first.hazard, first.unit) == (0.5, "a hand is crushed", Unit.LENGTH)
    assert (second.target, second.hazard) == (None, "")
    assert (plan.random_traces, plan.violations_kept, plan.search_runs) == (2, 3, 0)
    assert not plan.stop_early


def test_a_plan_that_names_what_ships_is_the_same_wherever_it_is_unpacked(tmp_path: Path) -> None:
    own = "scenario space: mine\nextends: shipped:nominal\nduration: 400 ms\n"
    plan = plan_in(tmp_path / "mine", PLAN, own)
    assert [file.name for file in plan.files] == [
        "plan.yaml",
        "short.yaml",
        "shipped/scenarios/spaces/nominal.yaml",
    ]
    again = read_plan(unpacked(plan.files, tmp_path / "elsewhere" / "deeper"))
    assert again.identity == plan.identity


def test_the_shipped_plans_can_be_read() -> None:
    plans = [file for file in sorted((ROOT / "plans").glob("*.yaml")) if kind_of(file) is FileKind.PLAN]
    assert len(plans) >= 2
    for file in plans:
        assert read_plan(file).runs > 0


@pytest.mark.parametrize(
    ("old", "new", "line", "field", "expected"),
    [
        ("seed: 7", "seed: -1", 5, "seed", "a whole number"),
        ("world: kinematic", "world: gazebo", 4, "world", "PyBullet, kinematic, MuJoCo, or a simulator"),
        ("stratum: nearer", "stratum: near", 10, "strata[1].stratum", "a name for one stratum only"),
        ("runs: 30", "runs: 0", 9, "strata[0].runs", "a whole number from 1"),
        (
            "space: short.yaml\n    runs: 20",
            "space: none.yaml\n    runs: 20",
            11,
            "strata[1].space",
            "relative",
        ),
        (
            "violated in at most: 50 %",
            "violated in at most: 0 %",
            15,
            "claims[0].violated in at most",
            "at least",
        ),
        ("claim: joint speeds within limits", "claim: hands are happy", 17, "claims[1].claim", "a formula"),
        (
            "claim: joint speeds within limits",
            "claim: hand distance never below 15 cm",
            17,
            "claims[1].claim",
            "each claim once",
        ),
        (
            "claim: joint speeds within limits",
            "claim: always hand distance > 15 cm",
            17,
            "claims[1].claim",
            "each claim once",
        ),
        ("avoider: opposite pose", "stop early: yes", 3, "stop early", "which tells when"),
        ("about: a test", "abuot: a test", 2, "abuot", "one of the keys"),
    ],
)
def test_a_mistake_is_told_with_its_place(
    tmp_path: Path, old: str, new: str, line: int, field: str, expected: str
) -> None:
    assert old in PLAN
    with pytest.raises(InputError) as caught:
        plan_in(tmp_path, PLAN.replace(old, new, 1))
    assert (caught.value.place.line, caught.value.place.field) == (line, field)
    assert expected in caught.value.expected
    assert caught.value.place.file == tmp_path / "plan.yaml"


def test_every_file_of_a_plan_is_part_of_its_identity(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("class Mine:\n    name = 'mine'\n")
    text = PLAN.replace("opposite pose", "mine.py:Mine")
    before = plan_in(tmp_path / "a", text.replace("mine.py", "../mine.py"), TEXT)
    assert [file.name for file in before.files] == ["a/plan.yaml", "a/short.yaml", "mine.py"]
    (tmp_path / "mine.py").write_text("class Mine:\n    name = 'other'\n")
    after = read_plan(tmp_path / "a" / "plan.yaml")
    assert before.identity.changes(after.identity) == ["the file mine.py changed"]
    assert before.identity.sha256 != after.identity.sha256


def test_what_a_space_extends_is_part_of_a_plan(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(TEXT)
    plan = plan_in(tmp_path, PLAN, "scenario space: another\nextends: base.yaml\nduration: 200 ms\n")
    assert {file.name for file in plan.files} == {"plan.yaml", "short.yaml", "base.yaml"}


def test_a_network_the_package_and_the_libraries_are_part_of_the_identity(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("opposite pose", "ensemble"))
    names = [name for name, _ in plan.identity.parts]
    assert {"the network ensemble", "the source of this package", "the library numpy"} <= set(names)
    assert Identity.from_json(plan.identity.as_json()) == plan.identity


def test_the_identity_does_not_hang_on_where_the_files_are(tmp_path: Path) -> None:
    assert plan_in(tmp_path / "here").identity == plan_in(tmp_path / "there" / "deep").identity


def test_the_files_of_a_plan_are_enough_to_read_it_elsewhere(tmp_path: Path) -> None:
    plan = plan_in(tmp_path / "here")
    elsewhere = read_plan(unpacked(plan.files, tmp_path / "elsewhere"))
    assert elsewhere.identity == plan.identity


def test_a_file_that_would_leave_the_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="below the plan's folder"):
        unpacked([PlanFile("../escaped.yaml", b"")], tmp_path / "folder")
    assert not (tmp_path / "escaped.yaml").exists()


def test_a_stratum_keeps_its_number_whatever_else_there_is() -> None:
    assert stratum_number("seen") == stratum_number("seen")
    assert stratum_number("seen") != stratum_number("unseen")
    assert 0 <= stratum_number("seen") < 2**63
