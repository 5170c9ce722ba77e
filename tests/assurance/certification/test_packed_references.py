"""A report carries its plan: references by absolute path and outside the plan's folder are made relative."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from once import replayed_once  # noqa: F401

from safety_harness.base.exceptions import ScenarioError
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.validate import validate
from safety_harness.extensions.assurance.campaign.plan import read_packable, read_plan, with_relative_paths
from safety_harness.extensions.assurance.certification import whose_fault
from safety_harness.extensions.assurance.commands.certify import certify, verify
from safety_harness.scenario.nodes import parse_tree, references_in
from tests.assurance.campaign.plans import PLAN, TEXT
from tests.cell.avoidance.test_onnx_names import columns

SMALL = re.sub(r"runs: \d+", "runs: 2", PLAN).replace("    violated in at most: 50 %\n", "")


@pytest.fixture(autouse=True)
def _no_causes(replayed_once: None, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    """The causes of violations take longer than all else here, and name no file."""
    monkeypatch.setattr(whose_fault, "attribute", lambda *_: ())


def plan_with_space_at(folder: Path, written: str) -> Path:
    """A plan in ``folder``/plans whose space lies in ``folder``/spaces, named as ``written``."""
    (folder / "plans").mkdir()
    (folder / "spaces").mkdir()
    (folder / "spaces" / "short.yaml").write_text(TEXT)
    plan = folder / "plans" / "plan.yaml"
    plan.write_text(SMALL.replace("space: short.yaml", f"space: {written}"))
    return plan


@pytest.mark.parametrize(
    "written",
    [
        "{}/spaces/short.yaml",
        '"{}/spaces/short.yaml"',
        "{}/plans/../spaces/short.yaml",
        "../spaces/short.yaml",
    ],
)
def test_an_honest_report_of_a_space_elsewhere_stands(
    tmp_path: Path, written: str, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, out = plan_with_space_at(tmp_path, written.format(tmp_path)), tmp_path / "report"
    certify(plan, out=out, workers=1)
    capsys.readouterr()
    assert verify(out, runs=1, seed=0) == AS_EXPECTED, capsys.readouterr().out
    packed = b"".join(path.read_bytes() for path in (out / "plan").rglob("*.yaml"))
    assert str(tmp_path).encode() not in packed


@pytest.mark.parametrize("named_in", ["plan", "space"])
def test_an_honest_report_of_an_onnx_file_with_a_layout_stands_elsewhere(
    tmp_path: Path, named_in: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """By absolute path, whatever names it: the report takes the file with it, and the layout stays."""
    there = tmp_path / "here"
    there.mkdir()
    plan, file = plan_with_space_at(there, "../spaces/short.yaml"), there / "mine.onnx"
    file.write_bytes(columns({"input": ["n", 6]}, {"output": 3}))
    reference, space = f'"{file}:input=hand,tcp,output=position"', there / "spaces" / "short.yaml"
    if named_in == "plan":
        plan.write_text(plan.read_text().replace("opposite pose", reference))
    else:
        plan.write_text(plan.read_text().replace("avoider: opposite pose\n", ""))
        space.write_text(TEXT.replace("opposite pose", reference))
    certify(plan, out=there / "report", workers=1)
    moved = (there / "report").rename(tmp_path / "moved")
    shutil.rmtree(there)
    capsys.readouterr()
    assert verify(moved, runs=1, seed=0, execute_programs=True) == AS_EXPECTED, capsys.readouterr().out
    evidence = (moved / "evidence.json").read_text()
    assert "mine.onnx:input=hand,tcp,output=position" in evidence
    assert str(file) not in evidence


def test_a_program_that_shares_no_folder_with_its_space_is_refused_before_any_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But one above every home, such as the root: traces name it alone, those of a copy by its folders."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "a").mkdir()
    (tmp_path / "mine.py").write_text("class Mine: ...\n")
    plan = plan_with_space_at(tmp_path / "a", "../spaces/short.yaml")
    plan.write_text(plan.read_text().replace("avoider: opposite pose\n", ""))
    space = tmp_path / "a" / "spaces" / "short.yaml"
    space.write_text(TEXT.replace("opposite pose", f"{tmp_path}/mine.py:Mine"))
    with pytest.raises(ScenarioError, match=r"mine\.py, which shares no folder"):
        read_packable(plan)


def test_a_recording_by_absolute_path_is_named_as_seen_from_the_space(tmp_path: Path) -> None:
    tree = parse_tree("hands: [{recording: /a/b/hand.csv}, {recording: hand.csv}]", None)
    assert list(references_in(with_relative_paths(tree, Path("/a/c")))) == ["../b/hand.csv", "hand.csv"]


def test_strict_ends_with_1_where_something_is_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a lodged seal something is; the first line has the word that heads the page."""
    plan, out = plan_with_space_at(tmp_path, "../spaces/short.yaml"), tmp_path / "report"
    certify(plan, out=out, workers=1)
    page = (out / "evidence.html").read_text()
    answer = re.findall(r'role="note"><p><strong>([^<]*)\.</strong>', page)[0].lower()
    assert capsys.readouterr().out.splitlines()[-1].endswith(f"evidence.html: {answer}")
    assert verify(out, runs=1, seed=0, strict=True) == DIFFERS
    assert (
        capsys.readouterr().out.splitlines()[0] == f"the report stands, except for the open points: {answer}"
    )


def test_a_plan_whose_copy_is_another_is_refused_before_any_run(tmp_path: Path) -> None:
    plan = plan_with_space_at(tmp_path, "../spaces/short.yaml")
    assert read_packable(plan).identity == read_plan(plan).identity
    absolute = (tmp_path / "spaces" / "short.yaml").as_posix()
    plan.write_text(plan.read_text().replace("../spaces/short.yaml", f'"\\x2f{absolute[1:]}"'))
    assert read_plan(plan).strata  # it can be run, and not be packed: its path is no text to be rewritten
    with pytest.raises(ScenarioError, match="relative paths"):
        read_packable(plan)


def test_validate_takes_every_shipped_plan() -> None:
    """Those with a shield: ``test_shipped_plans_with_a_shield.py``."""
    names = ("certify-in-a-minute", "mc-dropout", "quick")
    plans = [Path(__file__).parents[3] / "plans" / f"{name}.yaml" for name in names]
    assert validate(plans) == AS_EXPECTED
