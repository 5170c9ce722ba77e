"""A certificate in a report: told in its checker's words apart from what is shown, and checked by verify."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cell.avoidance.random_models import random_perceptron

from safety_harness.base.exceptions import InputError
from safety_harness.cell.avoidance.model_file import save_model
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER, plan_of, processes, run_missing
from safety_harness.extensions.assurance.certification.certify import Certification
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.folder import (
    stored_files,
    write_folder,
    write_manifest,
)
from safety_harness.extensions.assurance.certification.gated import outside_words
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.extensions.assurance.certification.proofs import (
    CERTIFICATE,
    FOLDER,
    read_certified,
    stored_proof,
)
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.lab.proof.certificate import write_certificate
from safety_harness.extensions.lab.proof.plan import ProofRegion, read_proof_plan
from safety_harness.extensions.lab.proof.session import Effort, fresh
from safety_harness.extensions.lab.proof.session import continue_proofs as prove
from tests.assurance.campaign.plans import PLAN as PLAN_OF_RUNS
from tests.assurance.campaign.plans import plan_in
from tests.lab.proof.regions import PLAN, plan_file
from tests.search.short_space import TEXT

FEW = PLAN_OF_RUNS.replace("runs: 30", "runs: 2").replace("runs: 20", "runs: 1")
QUIET = FEW.replace("opposite pose", "student").replace(
    "hand distance never below 150 mm", "trace finite and monotone"
)


def certificate_in(folder: Path, text: str = PLAN) -> Path:
    plan = read_proof_plan(plan_file(folder, text))
    proofs = list(prove(plan, fresh(plan), Effort(seconds=1e6, halvings=9)))
    write_certificate(folder / "certificate.json", plan, proofs)
    return folder / "certificate.json"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a few runs of the student, with a proof."""
    folder = tmp_path_factory.mktemp("with-proof")
    plan, report = plan_in(folder, QUIET), folder / "report"
    assert run_missing(plan, report / LEDGER, processes(1))
    read_certified(certificate_in(folder), plan).write(report)
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    return report


@pytest.fixture
def report(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "report"))


def faults(report: Path) -> list[str]:
    return [line for check in verify(report, runs=0) for line in check.faults]


def altered(report: Path, **changes: Any) -> None:
    """The first claim of its certificate, and every hash anew."""
    file = report / CERTIFICATE
    found = json.loads(file.read_text())
    found["claims"][0] |= changes
    file.write_text(json.dumps(found))
    write_manifest(report, stored_files(report))


def test_what_the_checker_confirms_is_told_apart_from_what_is_shown(report: Path) -> None:
    found = read_evidence(report / "evidence.json").proven
    assert found is not None
    steps, near = found.claims
    assert steps.verdict == "undecided"
    assert near.region == "corner"
    assert steps.confirmed.startswith(f"{steps.verdict}: at most 0.15 m")
    assert len(steps.maps) == 8
    page = (report / "evidence.html").read_text()
    part = page[page.index('id="proven"') :]
    assert steps.confirmed in part
    assert steps.gates[0] in part
    assert "undecided, by the hand from above" in part
    assert "<em>Proven</em> differs from <em>shown</em>." in part


WITHIN = """
gate:
  questions within:
    hand: {from: [610 mm, -490 mm, -190 mm], to: [690 mm, -410 mm, -110 mm]}
    tcp: {from: [650 mm, -140 mm, 260 mm], to: [700 mm, -90 mm, 300 mm]}
"""


@pytest.mark.parametrize(
    ("gate", "told"),
    [
        ("", "no gate keeps to a region"),
        (WITHIN, "answers to questions of this region alone"),
        (WITHIN.replace("to: [700 mm", "to: [700.5 mm"), "beyond its boxes (TCP x by 0.5 mm)"),
        (WITHIN.replace("-490 mm", "-500.01 mm"), "beyond its boxes (hand y by 0.01 mm)"),
        (WITHIN.replace("610 mm", "from 610 mm to 620 mm"), "varies from run to run"),
    ],
)
def test_whether_the_gate_keeps_to_the_region_is_told_with_each_claim(
    made: Path, tmp_path: Path, gate: str, told: str
) -> None:
    found = stored_proof(made, plan_in(tmp_path, QUIET, TEXT + gate))
    assert found is not None
    (line,) = found.claims[1].gates
    assert line.startswith("near, nearer: ")
    assert told in line


def test_nor_are_pairs_that_are_not_as_far_apart_as_the_region_has_them(tmp_path: Path) -> None:
    gate = plan_in(tmp_path, QUIET, TEXT + WITHIN).strata[0].space.simplest.gate
    assert gate is not None
    assert gate.questions_within is not None
    region = ProofRegion(
        name="near",
        hand_low_m=(0.6, -0.5, -0.2),
        hand_high_m=(0.7, -0.4, -0.1),
        tcp_low_m=(0.65, -0.14, 0.26),
        tcp_high_m=(0.7, -0.09, 0.3),
        apart_m=(0.1, 0.6),
    )
    assert "hands 458 to 638.9 mm from the TCP" in outside_words(gate.questions_within, region)
    assert outside_words(gate.questions_within, replace(region, apart_m=(0.4, 0.7))) == ""


def test_it_stands_until_its_certificate_says_something_false(report: Path) -> None:
    checks = {check.name: check for check in verify(report, runs=0)}
    assert [line for check in checks.values() for line in check.faults] == []
    assert "independent of the prover" in checks["proof"].looked_at
    altered(report, limit_m=0.01)
    said = faults(report)
    assert any("a certificate that the checker confirms" in line for line in said), said


def test_nor_is_it_gone(report: Path) -> None:
    shutil.rmtree(report / FOLDER)
    write_manifest(report, stored_files(report))
    assert any("disagree about the proven claims" in line for line in faults(report))


def test_one_of_another_network_or_not_confirmed_is_refused(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, QUIET)
    save_model(random_perceptron(), tmp_path / "own.safetensors")
    other = certificate_in(tmp_path, PLAN.replace("avoider: student", "avoider: own.safetensors"))
    with pytest.raises(InputError, match="network of the plan's avoider"):
        read_certified(other, plan)
    own = certificate_in(tmp_path)
    own.write_text(own.read_text().replace('"limit_m": 0.15', '"limit_m": 0.02'))
    with pytest.raises(InputError, match="that the checker confirms"):
        read_certified(own, plan)
    with pytest.raises(InputError):
        read_certified(tmp_path / "plan.yaml", plan)


def test_a_plan_may_name_it_and_the_command_another(tmp_path: Path) -> None:
    enough = QUIET.replace("runs: 2", "runs: 30").replace("runs: 1", "runs: 20")
    file = plan_in(tmp_path, enough + "proof: certificate.json\n").file
    rest: dict[str, Any] = dict.fromkeys(("selftest", "oracles", "declared"), None)
    rest |= {"cells": (), "pdf": False}
    with pytest.raises(InputError, match=r"certificate\.json"):
        Certification.prepare(file, tmp_path / "report", "", **rest)
    own = certificate_in(tmp_path)
    found = Certification.prepare(file, tmp_path / "report", "", **rest)
    assert found.certified is not None
    assert found.certified.certificate == own.read_bytes()
    with pytest.raises(InputError):
        Certification.prepare(file, tmp_path / "report", "", proof=tmp_path / "another.json", **rest)
