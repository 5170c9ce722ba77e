"""run, fuzz, campaign and replay notice an avoider that is no function of its question, and say so."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.replay import replay
from safety_harness.cli.run import run
from safety_harness.trace.store import load_trace
from tests.admission.remembering import NO_FUNCTIONS
from tests.admission.remembering import TEXT as MINE
from tests.kinds_of_files import VISIT
from tests.search.short_space import TEXT as SPACE

HARMLESS = "joint speeds within limits"


def in_a_folder_with_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE)
    Path("visit.yaml").write_text(VISIT)
    Path("short.yaml").write_text(SPACE)
    return tmp_path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return in_a_folder_with_files(tmp_path, monkeypatch)


@pytest.mark.parametrize(  # a search notices the other every day
    "name",
    [pytest.param(name, marks=pytest.mark.long) if name == "Batched" else name for name in NO_FUNCTIONS],
)
def test_run_and_replay_notice_it(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    avoider = f"mine.py:{name}"
    assert run([Path("visit.yaml")], Path("out"), avoider) == DIFFERS
    said = capsys.readouterr().err
    assert "error: the avoider " in said
    assert "mm elsewhere (question " in said
    told = json.loads(Path("out/report.json").read_text())["repeatability"]
    assert told["differing"] > 0
    assert told["words"] in said
    page = Path("out/report.html").read_text()
    assert told["words"] in page
    assert replay(Path("out/traces/visit.trace"), avoider) == DIFFERS
    found = capsys.readouterr().out
    assert "mm elsewhere (question " in found
    assert ("identical, but" in found) == (name != "Clocked")


def test_run_and_replay_say_how_often_a_function_was_asked(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Pure", verbose=True) == AS_EXPECTED
    told = json.loads(Path("out/report.json").read_text())["repeatability"]
    assert told["asked"] == told["questions"] > 0
    assert (told["differing"], told["words"], told["apart"]) == (0, "", True)
    line = f"{told['asked']} of {told['asked']} questions asked again"
    assert line in capsys.readouterr().out
    assert replay(Path("out/traces/visit.trace"), "mine.py:Pure") == AS_EXPECTED
    shown = capsys.readouterr()
    assert "identical: visit" in shown.out
    assert line in shown.err


@pytest.mark.parametrize(  # run and replay notice the others; a search asks again as they do
    "name",
    ["Batched", *(pytest.param(name, marks=pytest.mark.long) for name in NO_FUNCTIONS if name != "Batched")],
)
def test_fuzz_notices_it_though_nothing_is_violated(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    space, avoider = Path("short.yaml"), f"mine.py:{name}"
    assert fuzz(space, avoider=avoider, budget=16, out=Path("out"), claims=[HARMLESS]) == DIFFERS
    assert not list(Path("out").glob("*.yaml"))
    said = capsys.readouterr().err
    told = json.loads(Path("out/findings.json").read_text())["repeatability"]
    assert told["differing"] > 0
    assert f"error: {told['words']}" in said
    assert told["words"] in Path("out/fuzz.html").read_text()


@pytest.mark.parametrize("avoider", ["mine.py:Pure", "opposite pose"])
def test_fuzz_finds_nothing_wrong_with_a_function(avoider: str) -> None:
    space = Path("short.yaml")
    assert fuzz(space, avoider=avoider, budget=16, out=Path("out"), claims=[HARMLESS]) == AS_EXPECTED
    told = json.loads(Path("out/findings.json").read_text())["repeatability"]
    assert told["asked"] > 0
    assert (told["differing"], told["words"]) == (0, "")


def test_what_rounds_otherwise_in_a_batch_is_told_and_ends_no_command_with_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    space, avoider, out = Path("short.yaml"), "mine.py:Rounds", Path("out")
    assert fuzz(space, avoider=avoider, budget=16, out=out, claims=[HARMLESS]) == AS_EXPECTED
    said = capsys.readouterr().err
    assert "the avoider rounds otherwise when it is asked otherwise" in said
    assert "error:" not in said
    assert "rounds otherwise" in Path("out/fuzz.html").read_text()
    assert "are no evidence of other runs" not in Path("out/fuzz.html").read_text()


def test_a_reference_that_cannot_be_made_again_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    gone = MINE.replace(
        "class Pure:", "if os.path.exists('flag'): os._exit(5)\nopen('flag', 'w').close()\n\nclass Pure:"
    )
    gone = gone.replace("        chance =", "        os._exit(3)\n        chance =")
    Path("gone.py").write_text(f"import os\n{gone}")
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Pure", "gone.py:Pure") == DIFFERS
    assert "visit with gone.py:Pure could not be run to its end" in capsys.readouterr().err


def test_a_counterexample_of_such_an_avoider_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("safety_harness.search.session.SHRINKING_RUNS", 5)
    monkeypatch.setattr("safety_harness.search.session.MOST_SHRUNK", 1)
    assert fuzz(Path("short.yaml"), avoider="mine.py:Counts", budget=12, out=Path("out")) == DIFFERS
    (file, *_) = Path("out").glob("*.yaml")
    assert "# the avoider remembers: asked again alone" in file.read_text()


def test_the_documented_avoider_around_one_of_ours_is_used_asked_again_and_repeats(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (Path(__file__).parents[2] / "docs/how-to/avoider.md").read_text()
    found = re.search(r"### Around one of ours.*?```python\n(.*?)```", page, re.DOTALL)
    assert found is not None
    Path("mine.py").write_text(found[1])
    assert len([line for line in found[1].splitlines() if line]) <= 6  # an import, and five
    assert run([Path("visit.yaml")], Path("ours"), "mc-dropout") == AS_EXPECTED
    assert run([Path("visit.yaml")], Path("out"), "mine.py:higher", verbose=True) == AS_EXPECTED
    assert "a process of its own, alone and in another order" in capsys.readouterr().out
    ours, around = (load_trace(Path(f"{one}/traces/visit.trace")) for one in ("ours", "out"))
    first, higher = (one.decisions["proposed_position_in_base_m"][0] for one in (ours, around))
    assert higher - first == pytest.approx([0.0, 0.0, 0.02], abs=1e-12)
    for field in ("proposed_spread_m", "spread_threshold_m"):
        assert (ours.decisions[field][0] == around.decisions[field][0]).all()
