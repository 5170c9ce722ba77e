"""Prove claims about all answers of a network: the function ``safety_harness.prove`` and its result."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.pool import pool
from safety_harness.base.whole_file import write_text
from safety_harness.cell.avoidance.shipped import SHIPPED
from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
from safety_harness.extensions.lab.pages.proof_page import ProofEvidence, render
from safety_harness.extensions.lab.proof.certificate import Proof, taken_up, write_certificate
from safety_harness.extensions.lab.proof.claims import ClaimKind
from safety_harness.extensions.lab.proof.onnx_file import OnnxFunction
from safety_harness.extensions.lab.proof.plan import ProofPlan, read_proof_plan
from safety_harness.extensions.lab.proof.session import Effort, continue_proofs, fresh
from safety_harness.extensions.lab.proof.together import JointBound, joint_bounds
from safety_harness.extensions.lab.scoring.question_file import question_file
from safety_harness.scenario.files import display_path

__all__ = ["ProofResult", "prove"]
CERTIFICATE, PAGE = "certificate.json", "proof.html"


def prove(
    plan: str | Path | ProofPlan,
    *,
    minutes: float = 5.0,
    halvings: int = 40,
    jobs: int = 1,
    resume: str | Path | None = None,
    output: Output = QUIET,
) -> ProofResult:
    """Prove claims about a small network's answers to all inputs in a region, within a time limit.

    If Ctrl-C interrupts the function, it returns the proofs in their current state.

    Args:
        plan: A plan of proofs, or the path of its file.
        minutes: The time limit for all claims together.
        halvings: The largest number of times to halve a box.
        jobs: The number of processes.
        resume: A folder with a certificate whose proofs the function continues.  None means to start anew.
        output: The receiver of progress messages.

    Returns:
        The proven, refuted and undecided part of each claim.

    Raises:
        InputError: The plan cannot be used, or the certificate belongs to another plan.

    """
    read = plan if isinstance(plan, ProofPlan) else read_proof_plan(Path(plan))
    begun = fresh(read) if resume is None else taken_up(Path(resume) / CERTIFICATE, read)
    # After an interruption, claims without new work keep their earlier proofs.
    proofs = list(begun)
    with ExitStack() as closing:
        stopped = closing.enter_context(one_more_ctrl_c(output.say, "interrupted: finishing the batch"))
        on_step = closing.enter_context(output.steps())
        mapping = map if jobs == 1 else closing.enter_context(pool(jobs)).map
        effort = Effort(
            seconds=60.0 * minutes,
            halvings=halvings,
            over=mapping,
            at_once=jobs,
            stopped=stopped,
            show=on_step,
        )
        for number, proof in enumerate(continue_proofs(read, begun, effort)):
            proofs[number] = proof
        interrupted = stopped()
    options = ("--minutes", f"{minutes:g}", "--halvings", str(halvings))
    file = Path(f"{read.title}.yaml") if isinstance(plan, ProofPlan) else Path(plan)
    return ProofResult(read, tuple(proofs), interrupted=interrupted, file=file, options=options)


@dataclass(frozen=True, eq=False, repr=False)
class ProofResult:
    """The proven, refuted and undecided part of each claim.

    Args:
        plan: The plan.
        proofs: The proof of each claim in its region; a proof has a ``verdict`` and ``least_shares``.
        interrupted: Whether Ctrl-C interrupted the work.
        file: The file of the plan.
        options: The options of the command line that repeats the proofs.
        claims: The entry of each claim in the certificate.  The tuple is empty before a call of ``write``.

    """

    plan: ProofPlan
    proofs: tuple[Proof, ...]
    interrupted: bool
    file: Path
    options: tuple[str, ...] = ()
    claims: tuple[dict[str, Any], ...] = ()

    @cached_property
    def bounds(self) -> tuple[JointBound, ...]:
        """The bounds on the probability of wrong answers, if the plan has a distribution of inputs."""
        return tuple(joint_bounds(self.plan, list(self.proofs)))

    @property
    def exit_code(self) -> int:
        """The exit code of the command ``prove`` for this result."""
        if self.interrupted:
            return INTERRUPTED
        return AS_EXPECTED if all(proof.verdict == "proven" for proof in self.proofs) else DIFFERS

    def __repr__(self) -> str:
        each = ", ".join(f"{proof.planned.sentence}: {proof.verdict}" for proof in self.proofs)
        return f"<{self.plan.avoider}, {each}. {BASIS_OF_ANSWERS}>"

    def data(self, folder: Path) -> dict[str, object]:
        """Return the result as data for other programs, including the paths of the files in ``folder``."""
        return {
            "page": folder / PAGE,
            "basis": BASIS_OF_ANSWERS,
            "certificate": folder / CERTIFICATE,
            "claims": [{k: v for k, v in entry.items() if k != "tree"} for entry in self.claims],
            "together": [asdict(entry) for entry in self.bounds],
        }

    def write(self, folder: str | Path, output: Output = QUIET) -> ProofResult:
        """Write certificate.json and proof.html, and write each question that refutes a claim as a scenario.

        Args:
            folder: The folder.
            output: The receiver of messages about the written files.

        Returns:
            A copy of the result that contains the entries of the certificate in ``claims``.

        Raises:
            OutputError: The folder cannot be written.

        """
        out = Path(folder)
        written = write_certificate(out / CERTIFICATE, self.plan, list(self.proofs))
        files = [
            write_question(self.plan, proof, out / f"refuted-{k}.yaml", output) if proof.question else None
            for k, proof in enumerate(self.proofs, 1)
        ]
        parts = [
            "safety-harness",
            "prove",
            str(display_path(self.file)),
            "--out",
            str(display_path(out)),
            *self.options,
        ]
        evidence = ProofEvidence(
            plan=self.plan,
            proofs=self.proofs,
            bounds=self.bounds,
            files=tuple(files),
            command=shlex.join(parts),
            generated_at=datetime.now(UTC),
            interrupted=self.interrupted,
        )
        write_text(out / PAGE, render(evidence))
        made = replace(self, claims=tuple(written["claims"]))
        made.__dict__["bounds"] = self.bounds  # computing them again takes long
        return made


def write_question(plan: ProofPlan, proof: Proof, path: Path, output: Output) -> str | None:
    """Write a scenario whose run begins with the question that refutes a claim.

    Args:
        plan: The plan.
        proof: A proof with such a question.
        path: The file.
        output: The receiver of a message about the written file.

    Returns:
        The name of the file, or None if no run can begin with the question.

    """
    assert proof.question is not None
    claim = {
        ClaimKind.AWAY: "proposals lead away to within 10 mm",
        ClaimKind.OPTIMUM: "proposals within 60 mm of the optimum",
    }.get(proof.planned.claim.kind, "trace finite and monotone")
    made = question_file(
        path,
        plan.avoider if plan.avoider in SHIPPED else str(plan.model_file),
        plan.asked.avoider if isinstance(plan.asked, OnnxFunction) else plan.asked,
        np.array(proof.question.hand_in_base_m),
        np.array(proof.question.tcp_in_base_m),
        0,
        title=f"answered wrongly: {proof.planned.claim.sentence}",
        description=f"A question to {plan.avoider} that refutes: {proof.planned.sentence}.",
        claims=(claim,),
    )
    if made.path is None:
        output.say(f"{proof.planned.sentence}: its question is in the certificate alone, {made.remark}")
        return None
    write_text(made.path, made.text)
    output.say(f"{proof.planned.sentence}: refuted by {made.path}")
    return made.path.name
