"""A declared plan made into a report: its campaign, its search, the folder with the evidence."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from safety_harness.base.exceptions import InstallationError
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import Output
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_packable
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.campaign.session import LEDGER, carry_on, processes
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
    """One plan and the folder that its report goes to; ``command`` is what makes it again."""

    plan: Plan
    folder: Path
    trials: HarnessTrials
    command: str
    declaration_sha256: str = ""
    pdf: bool = False
    certified: CertifiedNetwork | None = None

    @classmethod
    def of(
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
        """Everything that can be refused before anything is run; the folder is reports/NAME without one.

        InputError for a plan that is not as declared or whose targets its runs cannot meet, for files that
        cannot be read, for a proof that is not confirmed or not of its network, for two packages that own one
        module, and for a PDF that no browser can print.
        """
        plan = read_packable(file)
        declaration_sha256 = declared_sha256(plan, declared)
        refuse_hopeless(plan)
        refuse_shared_modules()
        if pdf:
            browser()
        folder = folder or Path("reports") / plan.name
        read_notes(folder)  # which may be none that can be read
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
        """All of it; what is there already is not made again.  The evidence, and whether it is complete."""
        remark = "what is under way is finished and kept; Ctrl-C again drops it"
        with one_more_ctrl_c(output.say, remark) as interrupted, watch(self.plan, output) as show:
            path, crew = self.folder / LEDGER, processes(workers)
            complete = carry_on(self.plan, path, crew, on_progress=show, enough=interrupted, say=output.say)
        guard = ReportGuard()
        complete = complete and self.search(output, guard)
        without_proof(self.folder)
        if self.certified is not None:
            guard.of("the copy of the proof", partial(self.certified.write, self.folder), None)
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
        """The plan's search, shared among its strata; what was begun and not finished is begun anew.

        False for Ctrl-C; what fails is said in the report.
        """
        for stratum, one in zip(self.plan.strata, searches_of(self.plan, self.folder), strict=False):
            if one.complete or stratum.space.file is None:
                continue
            output.say(f"searching {one.stratum} for counterexamples, {one.asked} runs")
            shutil.rmtree(one.folder, ignore_errors=True)
            try:
                what = f"the search of {one.stratum}"
                made = guard.of(what, partial(self._searched, stratum.space.file, one, output), None)
            except KeyboardInterrupt:
                output.say("interrupted before anything was tried")
                return False
            if made is None:
                output.say(f"error: {guard.findings[-1].text}")
            elif made.interrupted and made.unwritable is None:
                return False
        return True

    def _searched(self, space: Path, one: Searched, output: Output) -> SearchResult:
        found = fuzz(
            read_space(space),
            avoider=self.plan.avoider_here,
            budget=one.asked,
            seed=self.plan.seed,
            claims=[claim.sentence for claim in self.plan.claims],
            explain="all",
            out=one.folder,
            output=output,
        )
        return found.kept(one.folder, output)


def refuse_shared_modules() -> None:
    """InstallationError that names the packages: which of them ran is not told by what is installed."""
    for module, packages in shared_modules().items():
        expected = "one installed package that owns it"
        hint = "uninstall all of them, then install the one that is needed: they overwrite each other"
        raise InstallationError.of_option(f"the module {module}", expected, " and ".join(packages), hint)
