"""Turn a declared plan into a report: run its campaign and its search, and write the folder of evidence."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from safety_harness.base.exceptions import InstallationError, Place, ScenarioError
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import Output
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_packable
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import LEDGER, processes, run_missing
from safety_harness.extensions.assurance.certification.argument_files import read_notes
from safety_harness.extensions.assurance.certification.counterexamples import Searched, searches_of
from safety_harness.extensions.assurance.certification.evidence import Evidence
from safety_harness.extensions.assurance.certification.folder import (
    PAGE,
    PDF,
    browser,
    write_folder,
    write_manifest,
    write_pdf,
)
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.lodged import declared_sha256
from safety_harness.extensions.assurance.certification.proofs import (
    CertifiedNetwork,
    read_certified,
    without_proof,
)
from safety_harness.extensions.assurance.certification.results import refuse_hopeless
from safety_harness.extensions.assurance.certification.tools import (
    HarnessTrials,
    read_cell,
    read_oracles,
    read_selftest,
)
from safety_harness.report.search_job import SearchResult, fuzz
from safety_harness.space.read import read_space
from safety_harness.trace.provenance import shared_modules

WatchCampaign = Callable[[Plan, Output], AbstractContextManager[Callable[[CampaignRunner], None]]]


@dataclass(frozen=True, eq=False)
class Certification:
    """A plan and the folder for its report.

    ``command`` is the command that makes the report again. ``declaration_sha256`` is empty without a
    declaration. ``certified`` is None without a proof.
    """

    plan: Plan
    folder: Path
    trials: HarnessTrials
    command: str
    declaration_sha256: str = ""
    pdf: bool = False
    certified: CertifiedNetwork | None = None

    @classmethod
    def prepare(
        cls,
        file: Path,
        folder: Path | None,
        command: str,
        *,
        selftest: Path | None,
        oracles: Path | None,
        cells: Sequence[Path],
        declared: Path | None,
        pdf: bool,
        proof: Path | None = None,
    ) -> Certification:
        """Return the certification of the plan in ``file``, after all checks that need no run.

        Args:
            file: The plan.
            folder: The folder of the report. The default is reports/NAME, where NAME is the name of the plan.
            command: The command that makes the report again.
            selftest: A file selftest.json, or None if there is no self-test.
            oracles: A file of independent oracles, or None if there are no oracles.
            cells: Files compare-worlds.json.
            declared: The declaration of the plan. The default is the file beside the plan, if it exists.
            pdf: Whether to print the page also as a PDF.
            proof: A certificate that ``prove`` wrote. The default is the certificate to which the plan
                refers, if any.

        Raises:
            InputError: The plan differs from its declaration, its runs cannot meet a target, or a file cannot
                be read. InputError is also raised if no browser can print the PDF, if the checker does not
                confirm the proof, or if the proof is of another network.
            InstallationError: The same module belongs to two packages.

        """
        plan = read_packable(file)
        _refuse_unnamed_world(plan)
        declaration_sha256 = declared_sha256(plan, declared)
        refuse_hopeless(plan)
        refuse_shared_modules()
        if pdf:
            browser()
        folder = folder or Path("reports") / plan.name
        read_notes(folder)  # refuse an unreadable file before any run
        certificate = proof or plan.proof
        certified = None if certificate is None else read_certified(certificate, plan)
        trials = HarnessTrials(
            selftest=None if selftest is None else read_selftest(selftest),
            oracles=() if oracles is None else read_oracles(oracles),
            oracles_with="" if oracles is None else f"as {oracles.name} has it",
            cells=tuple(map(read_cell, cells)),
        )
        return cls(plan, folder, trials, command, declaration_sha256, pdf, certified)

    def run(self, workers: int | None, watch: WatchCampaign, output: Output) -> tuple[Evidence, bool]:
        """Run the missing episodes and searches, and write the report.

        Args:
            workers: The number of processes. The default is one process per core.
            watch: A function that opens the display of the campaign's progress.
            output: Receives remarks.

        Returns:
            The evidence, and True if all declared runs and searches have finished.

        """
        remark = "running episodes finish and count; Ctrl-C again drops them"
        with one_more_ctrl_c(output.say, remark) as interrupted, watch(self.plan, output) as show:
            path, crew = self.folder / LEDGER, processes(workers)
            complete = run_missing(
                self.plan, path, crew, on_progress=show, enough=interrupted, say=output.say
            )
        guard = ReportGuard()
        complete = complete and self.search(output, guard)
        without_proof(self.folder)
        if self.certified is not None:
            guard.run("the copy of the proof", partial(self.certified.write, self.folder), None)
        with Ledger.open(self.folder / LEDGER) as ledger:
            gathered = gather(
                self.plan,
                ledger,
                self.folder,
                command=self.command,
                trials=self.trials,
                declaration=self.declaration_sha256,
                guard=guard,
            )
            evidence = write_folder(self.folder, gathered, ledger)
        try:
            if self.pdf:
                write_pdf(self.folder / PAGE, self.folder / PDF)
        finally:
            write_manifest(self.folder, evidence.files)
        return evidence, complete

    def search(self, output: Output, guard: ReportGuard) -> bool:
        """Search each stratum for counterexamples.

        An unfinished search starts again from its beginning. ``output`` receives remarks. If a search fails,
        ``guard`` records a finding.

        Returns:
            False if Ctrl-C interrupted a search. Otherwise True, even if a search failed.

        """
        for stratum, searched in zip(self.plan.strata, searches_of(self.plan, self.folder), strict=False):
            if searched.complete or stratum.space.file is None:
                continue
            output.say(f"searching {searched.stratum} for counterexamples, {searched.asked} runs")
            shutil.rmtree(searched.folder, ignore_errors=True)
            try:
                part = f"the search of {searched.stratum}"
                made = guard.run(part, partial(self._searched, stratum.space.file, searched, output), None)
            except KeyboardInterrupt:
                output.say("interrupted before the first run")
                return False
            if made is None:
                output.say(f"error: {guard.findings[-1].text}")
            elif made.interrupted and made.unwritable is None:
                return False
        return True

    def _searched(self, space: Path, searched: Searched, output: Output) -> SearchResult:
        """Search one stratum, and write the findings to the folder of ``searched``."""
        findings = fuzz(
            read_space(space),
            avoider=self.plan.avoider_here,
            budget=searched.asked,
            seed=self.plan.seed,
            claims=[claim.sentence for claim in self.plan.claims],
            explain="causes" if self.plan.world.program else "all",  # a simulator is slow
            world=self.plan.search_world,
            out=searched.folder,
            output=output,
        )
        return findings.kept(searched.folder, output)


def _refuse_unnamed_world(plan: Plan) -> None:
    """Raise ScenarioError if a plan does not state the world in which its runs are made."""
    if not plan.names_world:
        place, expected = Place(file=plan.file, field="world"), "a world, on which the report will rest"
        raise ScenarioError(place=place, expected=expected, got="none", hint=f"world: {plan.world.label}")


def refuse_shared_modules() -> None:
    """Raise InstallationError if the same module belongs to two installed packages.

    The error states the names of the packages. In this case, it is unknown from which package the module was
    imported.
    """
    for module, packages in shared_modules().items():
        expected = "one installed package that owns it"
        hint = "their files collide: uninstall all, then install the package that you need"
        raise InstallationError.of_option(f"the module {module}", expected, " and ".join(packages), hint)
