"""``safety-harness evaluate``: any avoider is scored, its findings are said, and its worst questions run."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from safety_harness.base.exceptions import NoAnswerError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.main import app
from safety_harness.extensions.lab.commands.evaluate import evaluate
from safety_harness.extensions.lab.evaluate_job import DATA, PAGE
from safety_harness.extensions.lab.pages.score_document import SCHEMA
from safety_harness.extensions.lab.scoring import score as scoring
from safety_harness.extensions.lab.scoring import session as module
from safety_harness.extensions.lab.scoring.score import score

MINE = """
import numpy as np
from safety_harness.cell.avoidance.avoider import Proposal

class Towards:
    name = "towards <b>the</b> hand"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        way = hand_position_in_base_m - tcp_position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.1 * way / max(np.linalg.norm(way), 1e-9))

class Raises(Towards):
    def propose(self, **question):
        raise ValueError("no")
"""
FEW = {"questions": 60, "search": 0, "regions": ["seen"]}


@pytest.fixture(scope="module")
def towards(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Where the avoider that leads towards the hand was scored without a search, and what was printed."""
    folder = tmp_path_factory.mktemp("towards")
    (folder / "mine.py").write_text(MINE)
    options = [*("--questions", str(FEW["questions"]), "--search", "0", "--region", "seen", "--out", "out")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scoring, "LATER_S", 0.0)
        patch.chdir(folder)
        found = CliRunner().invoke(app, ["evaluate", "mine.py:Towards", *options])
    assert found.exit_code == DIFFERS, found.output
    return folder / "out", found.stdout


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(scoring, "LATER_S", 0.0)  # no avoider here drifts with the clock
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(out: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((out / DATA).read_text())
    return document


def test_a_shipped_network_has_no_finding_and_all_its_files(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(["mc-dropout"], out=Path("out"), **FEW) == AS_EXPECTED  # type: ignore[arg-type]
    printed = capsys.readouterr()
    document = written(folder / "out")
    (one,) = document["avoiders"]
    assert (document["schema"], document["seed"], document["finding_count"]) == (SCHEMA, 0, 0)
    assert len(one["sha256"]) == 64
    assert one["regions"][0]["off_m"]["p50"]["value"] > 0.0
    assert "times" not in one
    assert document["times"]["mc-dropout"]["median_s"] > 0.0
    assert "0 findings on mc-dropout" in printed.out
    assert "closed-form optimum" in printed.out
    page = (folder / "out" / PAGE).read_text()
    assert "no finding" in page
    shares = one["regions"][0]["leads_away"]
    away = shares["count"] / shares["trials"]
    towards = f"Towards the hand, most: {100 * (1.0 - away):.3g} % of its proposals in seen."
    assert 0.0 < away < 1.0
    assert towards in page
    assert towards in printed.out


def test_an_avoider_that_leads_towards_the_hand_is_a_finding(towards: tuple[Path, str]) -> None:
    out, printed = towards
    kinds = {finding["kind"] for finding in written(out)["avoiders"][0]["findings"]}
    assert "leads towards the hand" in kinds
    share = re.search(r"leads towards the hand \(seen\): (\S+) % .* where each yardstick leads away", printed)
    assert share is not None
    assert float(share[1]) > 80.0
    page = (out / PAGE).read_text()
    assert "towards &lt;b&gt;the&lt;/b&gt; hand" in page
    assert "<b>the</b>" not in page


def test_an_avoider_that_raises_is_a_finding_and_no_crash(folder: Path) -> None:
    few = FEW | {"questions": 20}
    assert evaluate(["mine.py:Raises"], out=Path("out"), **few) == DIFFERS  # type: ignore[arg-type]
    one = written(folder / "out")["avoiders"][0]
    assert "no answer" in {finding["kind"] for finding in one["findings"]}
    assert one["regions"][0]["answered"]["count"] == 0
    assert one["regions"][0]["off_m"] is None


def test_all_but_the_times_repeats_from_the_seed(folder: Path) -> None:
    def figures(out: str, seed: int) -> dict[str, Any]:
        options = FEW | {"search": 128}
        evaluate(["deterministic"], out=Path(out), seed=seed, **options)  # type: ignore[arg-type]
        document = written(folder / out)
        document.pop("times")
        return document

    first = figures("a", 1)
    assert first["avoiders"][0]["search"]["worst"] != []
    assert first == figures("b", 1)
    assert first != figures("c", 2)


def test_a_search_changes_no_figure_and_its_worst_questions_run_as_they_expect(
    folder: Path, towards: tuple[Path, str]
) -> None:
    options = FEW | {"search": 40}
    evaluate(["mine.py:Towards"], out=Path("with"), **options)  # type: ignore[arg-type]
    (one,), (other,) = written(towards[0])["avoiders"], written(folder / "with")["avoiders"]
    assert one["regions"] == other["regions"]
    assert one["findings"] == other["findings"]
    (ledger,) = other["search"]["regions"]
    assert ledger["asked"] == 40
    files = sorted((folder / "with").glob("*.yaml"))
    assert len(files) == len(other["search"]["worst"]) > 1
    found = CliRunner().invoke(app, ["run", str(files[0]), "--out", "run"])
    assert found.exit_code == AS_EXPECTED, found.output
    assert "violated" in files[0].read_text()


def test_against_a_reference_only_what_it_does_not_do_is_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "again.py").write_text(f"{MINE}# another version that answers alike\n")
    few = FEW | {"questions": 20, "against": "again.py:Towards"}
    assert evaluate(["mine.py:Towards"], out=Path("alike"), **few) == AS_EXPECTED  # type: ignore[arg-type]
    assert "gave the same answer to every question: is it a copy?" in capsys.readouterr().err
    few = FEW | {"questions": 20, "against": "opposite pose"}
    assert evaluate(["mine.py:Towards"], out=Path("worse"), **few) == DIFFERS  # type: ignore[arg-type]
    printed = capsys.readouterr()
    assert "is it a copy?" not in printed.err
    assert "on 20 questions where opposite pose does not" in printed.out


@pytest.mark.parametrize(
    "named",
    [
        *(pytest.param(one, marks=pytest.mark.long) for one in ("mine.py:Towards", "./mine.py:Towards")),
        *("copy.py:Towards", "opposite pose"),  # a copy is what the others are: the same bytes
    ],
)
def test_a_comparison_with_itself_is_refused(
    named: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "copy.py").write_text(MINE)
    scored = named if named == "opposite pose" else "mine.py:Towards"
    few = FEW | {"questions": 20, "against": named}
    assert evaluate([scored], out=Path("itself"), **few) == BAD_INPUT  # type: ignore[arg-type]
    assert "a comparison with itself has no findings" in capsys.readouterr().err
    assert not (folder / "itself").exists()


def test_several_avoiders_stand_side_by_side_and_one_that_hangs_costs_only_itself(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def hangs(subject: Any, *args: Any, **options: Any) -> object:
        if subject.reference == "optimum":
            raise NoAnswerError("optimum", 1.0)
        return score(subject, *args, **options)

    monkeypatch.setattr(module, "score", hangs)
    code = evaluate(["optimum", "opposite pose"], out=Path("out"), **FEW)  # type: ignore[arg-type]
    assert code == BAD_INPUT
    document = written(folder / "out")
    assert [one["reference"] for one in document["avoiders"]] == ["opposite pose"]
    assert "optimum" in document["failed"][0]
    assert "gave no answer" in capsys.readouterr().err


def test_ctrl_c_keeps_the_avoiders_that_were_finished(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(subject: Any, *args: Any, **options: Any) -> object:
        if subject.reference == "deterministic":
            raise KeyboardInterrupt
        return score(subject, *args, **options)

    monkeypatch.setattr(module, "score", interrupted)
    code = evaluate(["opposite pose", "deterministic"], out=Path("out"), **FEW)  # type: ignore[arg-type]
    assert code == INTERRUPTED
    document = written(folder / "out")
    assert document["interrupted"]
    assert [one["reference"] for one in document["avoiders"]] == ["opposite pose"]
    assert evaluate(["deterministic"], out=Path("none"), **FEW) == INTERRUPTED  # type: ignore[arg-type]
    assert not (folder / "none").exists()
    assert evaluate(["no such"], out=Path("out"), **FEW) == BAD_INPUT  # type: ignore[arg-type]
    assert written(folder / "out") == document
    assert evaluate(["deterministic"], out=Path("out"), **FEW) == INTERRUPTED  # type: ignore[arg-type]
    assert not (folder / "out" / DATA).exists()  # or who opens it reads the scores of another avoider
    assert not (folder / "out" / PAGE).exists()


def test_ctrl_c_keeps_the_regions_that_were_finished(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*args: Any, on_region: Any, **options: Any) -> object:
        def told(card: Any) -> None:
            on_region(card)
            raise KeyboardInterrupt

        return score(*args, on_region=told, **options)

    monkeypatch.setattr(module, "score", interrupted)
    few = FEW | {"regions": ["seen", "unseen tcp"], "search": 64, "questions": 20}
    assert evaluate(["mine.py:Towards"], out=Path("out"), **few) == INTERRUPTED  # type: ignore[arg-type]
    one = written(folder / "out")["avoiders"][0]
    assert [region["region"] for region in one["regions"]] == ["seen"]
    assert one["findings"] != []
    assert one["search"]["worst"] == []
    assert "Interrupted." in (folder / "out" / PAGE).read_text()
    assert "the finished scores are saved; the same command repeats all" in capsys.readouterr().err


def test_the_questions_of_a_space_are_a_region(folder: Path) -> None:
    space = Path(__file__).parents[3] / "scenarios" / "spaces" / "reaching-hands.yaml"
    few = FEW | {"regions": None, "spaces": [space]}
    assert evaluate(["mc-dropout"], out=Path("out"), **few) == AS_EXPECTED  # type: ignore[arg-type]
    (region,) = written(folder / "out")["avoiders"][0]["regions"]
    assert (region["region"], region["asked"]) == ("reaching-hands", 60)


def test_what_no_run_asks_is_named_and_not_searched(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = FEW | {"regions": ["far"], "search": 64}
    assert evaluate(["opposite pose"], out=Path("out"), **few) == DIFFERS  # type: ignore[arg-type]
    assert "far (no run asks)" in capsys.readouterr().out
    assert written(folder / "out")["avoiders"][0]["search"]["regions"] == []
    assert "No run can ask such a question" in (folder / "out" / PAGE).read_text()


def test_mistakes_are_explained_before_anything_is_asked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for avoiders, options, said in (
        (["mc-dropot"], {}, "did you mean"),
        (["mc-dropout", "none.onnx"], {}, "none.onnx"),
        (["mine.py:Nobody"], {}, "Nobody"),
        (["mc-dropout"], {"regions": ["elsewhere"]}, "--region"),
        (["mc-dropout"], {"against": "none.py:Mine"}, "--against"),
    ):
        few = FEW | options
        assert evaluate(avoiders, out=Path("out"), **few) == BAD_INPUT  # type: ignore[arg-type]
        printed = capsys.readouterr()
        assert said in printed.err
        assert printed.out == ""
    assert not (folder / "out").exists()


def test_a_place_that_cannot_be_written_is_bad_input(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(["opposite pose"], out=Path("mine.py"), **FEW) == BAD_INPUT  # type: ignore[arg-type]
    assert "can be written" in capsys.readouterr().err


def test_an_avoider_that_often_leads_towards_the_hand_is_never_green(folder: Path) -> None:
    """Where hand and TCP are unseen, mc-dropout does so in half of its proposals, as the yardsticks do."""
    for region, colour in (("unseen both", "doubt"), ("seen", "fine")):
        out = folder / region
        assert evaluate(["mc-dropout"], regions=[region], questions=200, search=0, out=out) == AS_EXPECTED
        page = (out / "evaluation.html").read_text()
        assert f'class="banner {colour}" role="note"><strong>mc-dropout: no finding.' in page
        assert ("are too many for green." in page) == (colour == "doubt")
        assert ("<h1>No finding beyond the yardsticks on mc-dropout" in page) == (colour == "doubt")


def test_a_mistyped_avoider_gets_the_nearest() -> None:
    found = CliRunner().invoke(app, ["evaluate", "optimm"])
    assert found.exit_code == BAD_INPUT
    assert 'did you mean "optimum"' in found.output
