"""``safety-harness prove``: what is proven is told and written, and a certificate is checked."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.extensions.lab.commands.prove import prove
from safety_harness.extensions.lab.proof import session
from safety_harness.extensions.lab.proof.tree import BoxTree
from tests.lab.proof.regions import PLAN, plan_file

FALSE = "proof: wrong\navoider: student\nclaims: [{claim: steps at most 60 mm}]\n"
QUESTIONS = "distribution: {samples: 100, confidence: 95 %}\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_proven_is_told_written_and_confirmed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert prove(plan_file(folder), out=folder / "out", halvings=40) == AS_EXPECTED
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == str(folder / "out" / "proof.html")
    rows = [line.split() for line in said.splitlines()]
    assert [row[-4:] for row in rows if "mm" in row] == 2 * [["proven", "100.0000%", "0.0000%", "0.0000%"]]
    certificate = folder / "out" / "certificate.json"
    assert prove(certificate, check=True) == AS_EXPECTED
    assert capsys.readouterr().out.count("confirmed proven: ") == 2

    found = json.loads(certificate.read_text())
    found["claims"][0]["limit_m"] = 0.1
    certificate.write_text(json.dumps(found))
    assert prove(certificate, check=True) == DIFFERS
    said = capsys.readouterr()
    assert "not confirmed" in said.err
    assert said.out == ""


def test_a_false_claim_is_refuted_with_a_question_that_is_a_scenario(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        "safety_harness.extensions.lab.prove_job.write_question",
        lambda plan, proof, path, output: written.append((path.name, proof.planned.sentence)),
    )
    assert prove(plan_file(folder, FALSE + QUESTIONS), out=folder / "out", halvings=4) == DIFFERS
    *_, columns, row, _, _, _ = capsys.readouterr().out.splitlines()
    assert columns.split()[2:6] == ["wrong", "at", "most", "at"]
    assert float(row.split()[6]) > 0.9
    assert written == [("refuted-1.yaml", "steps at most 60 mm (seen)")]
    (claim,) = json.loads((folder / "out" / "certificate.json").read_text())["claims"]
    assert claim["verdict"] == "refuted"
    assert len(claim["question"]["hand_in_base_m"]) == 3
    assert prove(folder / "out" / "certificate.json", check=True) == AS_EXPECTED


def test_ctrl_c_leaves_a_certificate_that_is_gone_on_with(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, work, pressed = plan_file(folder), session.work, []

    def interrupted_work(tree: BoxTree, *args: object, **options: object) -> None:
        if not pressed:
            os.kill(os.getpid(), signal.SIGINT)
        pressed.append(1)
        work(tree, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(session, "work", interrupted_work)
    assert prove(plan, out=folder / "out", halvings=40) == INTERRUPTED
    assert prove(folder / "out" / "certificate.json", check=True) == AS_EXPECTED
    assert "confirmed undecided" in capsys.readouterr().out
    monkeypatch.setattr(session, "work", work)
    assert prove(plan, out=folder / "out", halvings=40, resume=True) == AS_EXPECTED


def test_mistakes_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert prove(folder / "none.yaml") == BAD_INPUT
    assert prove(plan_file(folder, PLAN.replace("student", "ensemble"))) == BAD_INPUT
    assert "relu perceptron" in capsys.readouterr().err
    assert prove(plan_file(folder), resume=True) == BAD_INPUT
    assert prove(plan_file(folder), check=True) == BAD_INPUT
    assert "certificate" in capsys.readouterr().err
    certificate = folder / "own.json"
    certificate.write_text('{"format": "safety-harness certificate 1", "avoider": "own.safetensors"}')
    assert prove(certificate, check=True) == BAD_INPUT
    assert "--model" in capsys.readouterr().err
    certificate.write_text('{"format": "safety-harness certificate 1", "avoider": "student"}')
    assert prove(certificate, check=True) == DIFFERS
