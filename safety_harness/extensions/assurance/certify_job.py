"""Run a declared plan and write its evidence: the function ``safety_harness.certify`` and its result."""

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
from safety_harness.scenario.files import display_path
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
    """Run the missing episodes and searches of a plan, and write the evidence to a folder.

    After Ctrl-C, the folder keeps every finished run.  Repeat the same call to continue.

    Args:
        plan: A plan or its file.
        controller: A controller that drives the arm and replaces the plan's avoider.
        out: The folder of the report, which keeps every finished run. The default is reports/NAME, where NAME
            is the name of the plan.
        pdf: Whether to print the page also as a PDF. This needs an installed Chromium.
        full: Whether the PDF contains the whole page. The default is a PDF with only the most severe results
            of each kind.
        workers: The number of processes. The default is one process per core.
        selftest: A file selftest.json for the report. If there is no file, the report states that there is no
            self-test.
        oracles: A file of independent oracles for the report, or None if there are no oracles.
        cells: Files compare-worlds.json for the report.
        declared: The declaration of the plan. The default is the file beside the plan, if it exists.
        proof: A certificate that ``prove`` wrote for the avoider's network. The default is the plan's own
            certificate, if any.
        since: The folder of an earlier report with which the new report is compared. The default makes no
            comparison.
        output: The object that receives the progress.

    Returns:
        The plan, its evidence, the folder, and the comparison with the earlier report.

    Raises:
        InputError: The plan or a file cannot be used, or the plan's runs cannot meet a target.
        OutputError: A file of the report cannot be written.

    """
    file = plan.file if isinstance(plan, Plan) else Path(plan)
    argv = ["safety-harness", "certify", str(display_path(file))]
    if controller is not None:
        read, tested = read_plan(file), Driver(controller)
        file = plan_with(read.files, tested, Path("reports") / read.name).file
        argv += ["--controller", told_avoider(tested)]
    given = {"out": out, "selftest": selftest, "oracles": oracles, "declared": declared, "proof": proof}
    paths = {name: None if path is None else Path(path) for name, path in (given | {"since": since}).items()}
    of_cells = [Path(path) for path in cells]
    for name, value in paths.items():
        argv += [f"--{name}", str(display_path(value))] if value else []
    argv += [argument for path in of_cells for argument in ("--cell", str(display_path(path)))]
    earlier = None if paths["since"] is None else EarlierReport.read(paths["since"])
    again = shlex.join(argv + ["--pdf"] * pdf + ["--full"] * full)
    job = Certification.prepare(
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
    # Print the search's results as remarks, because the verdicts are the results.
    evidence, complete = job.run(workers, watching_campaign, replace(output, result=output.say))
    delta = None
    if complete and earlier is not None:
        delta = compare_reports(earlier, EarlierReport.read(job.folder), again)
    return CertificationResult(job.plan, evidence, job.folder, complete, delta)


def compare_reports(old: EarlierReport, new: EarlierReport, made_by: str) -> EvidenceDelta:
    """Compare two reports and write the comparison beside the later report.

    Args:
        old: The earlier report.
        new: The later report.
        made_by: The command that repeats the comparison. The page shows this command.

    Returns:
        All changes from the earlier report to the later report.

    Raises:
        InputError: A ledger cannot be read, or the two reports are in the wrong order.
        OutputError: The comparison cannot be written.

    """
    delta = delta_of(old, new)
    write_delta(folder_of_delta(new.folder), delta, command=made_by, generated_at=datetime.now(UTC))
    return delta


@dataclass(frozen=True, eq=False, repr=False)
class CertificationResult:
    """The evidence for the claims of a plan. The evidence is not a certificate.

    Args:
        plan: The plan of the runs.
        evidence: The content of evidence.json.
        folder: The folder of the report.
        complete: True if all declared runs and searches have finished.
        delta: The changes since the earlier report, or None without an earlier report.

    """

    plan: Plan
    evidence: Evidence
    folder: Path
    complete: bool
    delta: EvidenceDelta | None = None

    @property
    def claims(self) -> tuple[ClaimEvidence, ...]:
        """The evidence on each claim.

        The status of a claim is its ``standing``. The evidence also states the reason for the status.
        """
        return self.evidence.claims

    @property
    def page(self) -> Path:
        """The file of the report's page."""
        return self.folder / PAGE

    @property
    def exit_code(self) -> int:
        """The exit code of the command ``certify``: *as expected*, *different* or *interrupted*.

        The code of an incomplete report is *interrupted*. If there is an earlier report, the code depends on
        regressions. Otherwise, the code depends on the status of the claims. The code is also *different* if
        a part of the report failed.
        """
        if not self.complete:
            return INTERRUPTED
        shown = (
            self.evidence.standing is ClaimStatus.SHOWN if self.delta is None else not self.delta.regressions
        )
        return AS_EXPECTED if shown and not self.evidence.unmade else DIFFERS

    def __repr__(self) -> str:
        counts = [claim.standing.value for claim in self.claims]
        parts = ", ".join(f"{counts.count(status)} {status}" for status in dict.fromkeys(counts))
        return f"<{self.evidence.standing.value}: {self.plan.title}, claims: {parts}. {self.evidence.basis}>"

    def write(self, folder: str | Path) -> CertificationResult:
        """Copy the report to another folder.

        Args:
            folder: A folder that does not exist yet. If the folder is the report's own folder, the function
                copies no file.

        Returns:
            A copy of this result that refers to the new folder.

        Raises:
            OutputError: The folder exists already, or it cannot be written.

        """
        out = Path(folder)
        if out.resolve() == self.folder.resolve():
            return self
        if out.exists():
            raise OutputError.of_file(out, "a folder that is not there yet", "one that is")
        with writing(out):
            shutil.copytree(self.folder, out)
        return replace(self, folder=out)
