"""Run a declared plan and write its evidence: ``safety_harness.certify``, and its result."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.admission.avoiders import told_avoider
from safety_harness.base.exceptions import OutputError
from safety_harness.base.output import AS_EXPECTED, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import writing
from safety_harness.extensions.assurance.campaign.against import plan_with
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.certification.certify import Certification
from safety_harness.extensions.assurance.certification.delta import EarlierReport, EvidenceDelta, delta_of
from safety_harness.extensions.assurance.certification.delta_page import folder_of_delta, write_delta
from safety_harness.extensions.assurance.certification.evidence import ClaimEvidence, ClaimStatus, Evidence
from safety_harness.extensions.assurance.certification.folder import PAGE
from safety_harness.extensions.assurance.commands.progress import watching_campaign
from safety_harness.scenario.files import told
from safety_harness.scenario.model import Driver

__all__ = ["CertificationResult", "certify"]


def certify(
    plan: str | Path | Plan,
    *,
    controller: str | None = None,
    out: str | Path | None = None,
    pdf: bool = False,
    full: bool = False,
    workers: int | None = None,
    selftest: str | Path | None = None,
    oracles: str | Path | None = None,
    cells: Iterable[str | Path] = (),
    declared: str | Path | None = None,
    proof: str | Path | None = None,
    since: str | Path | None = None,
    output: Output = QUIET,
) -> CertificationResult:
    """Run what is missing of a plan's episodes and searches, and write the evidence to a folder.

    Args:
        plan: A plan or its file.
        controller: What drives the arm in place of what the plan names.
        out: The folder of the report; None: reports/NAME of the plan.  It keeps every finished run.
        pdf: Print the page too, with an installed Chromium.
        full: On paper have all of the page.
        workers: Processes; None: one for each core.
        selftest: The selftest.json to be part of the report.
        oracles: The file of independent oracles, likewise.
        cells: Files compare-worlds.json, likewise.
        declared: The declaration of the plan; None: the one beside it, if there is one.
        proof: A certificate of ``prove`` of the avoider's network.
        since: The folder of an earlier report, to say what changed.
        output: What hears of the progress.

    Ctrl-C keeps every finished run; the same call goes on.

    Raises:
        InputError: The plan or a file cannot be used, or the plan's runs cannot meet a target.

    """
    file = plan.file if isinstance(plan, Plan) else Path(plan)
    words = ["safety-harness", "certify", str(told(file))]
    if controller is not None:
        read, tested = read_plan(file), Driver(controller)
        file = plan_with(read.files, tested, Path("reports") / read.name).file
        words += ["--controller", told_avoider(tested)]
    given = {"out": out, "selftest": selftest, "oracles": oracles, "declared": declared, "proof": proof}
    paths = {name: None if one is None else Path(one) for name, one in (given | {"since": since}).items()}
    of_cells = [Path(one) for one in cells]
    for name, value in paths.items():
        words += [f"--{name}", str(told(value))] if value else []
    words += [word for one in of_cells for word in ("--cell", str(told(one)))]
    earlier = None if paths["since"] is None else EarlierReport.read(paths["since"])
    again = shlex.join(words + ["--pdf"] * pdf + ["--full"] * full)
    job = Certification.of(
        file,
        paths["out"],
        again,
        selftest=paths["selftest"],
        oracles=paths["oracles"],
        cells=of_cells,
        declared=paths["declared"],
        pdf=pdf,
        proof=paths["proof"],
    )
    # Results of the search are remarks: results are the verdicts.
    evidence, complete = job.run(workers, watching_campaign, replace(output, result=output.say))
    delta = None
    if complete and earlier is not None:
        delta = compare_reports(earlier, EarlierReport.read(job.folder), again)
    return CertificationResult(job.plan, evidence, job.folder, complete, delta)


def compare_reports(before: EarlierReport, after: EarlierReport, made_by: str) -> EvidenceDelta:
    """Return what changed between two reports, and write it beside the later one."""
    delta = delta_of(before, after)
    write_delta(folder_of_delta(after.folder), delta, command=made_by, generated_at=datetime.now(UTC))
    return delta


@dataclass(frozen=True, eq=False, repr=False)
class CertificationResult:
    """The evidence of a plan, which is no certificate.

    Args:
        plan: The plan that was run.
        evidence: What evidence.json holds.
        folder: The folder of the report.
        complete: All declared runs were made.
        delta: What changed since the earlier report, if one was given.

    """

    plan: Plan
    evidence: Evidence
    folder: Path
    complete: bool
    delta: EvidenceDelta | None = None

    @property
    def claims(self) -> tuple[ClaimEvidence, ...]:
        """Each claim with its ``standing``, and why."""
        return self.evidence.claims

    @property
    def page(self) -> Path:
        """The report's page."""
        return self.folder / PAGE

    @property
    def exit_code(self) -> int:
        """The command's exit code."""
        if not self.complete:
            return INTERRUPTED
        shown = (
            self.evidence.standing is ClaimStatus.SHOWN if self.delta is None else not self.delta.regressions
        )
        return AS_EXPECTED if shown and not self.evidence.unmade else DIFFERS

    def __repr__(self) -> str:
        counts = [claim.standing.value for claim in self.claims]
        words = ", ".join(f"{counts.count(one)} {one}" for one in dict.fromkeys(counts))
        return f"<{self.evidence.standing.value}: {self.plan.title}, claims: {words}. {self.evidence.basis}>"

    def write(self, folder: str | Path) -> CertificationResult:
        """Copy the report to another folder, which must not be there; OutputError if it cannot be written."""
        out = Path(folder)
        if out.resolve() == self.folder.resolve():
            return self
        if out.exists():
            raise OutputError.of_file(out, "a folder that is not there yet", "one that is")
        with writing(out):
            shutil.copytree(self.folder, out)
        return replace(self, folder=out)
