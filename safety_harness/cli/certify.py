"""``safety-harness certify`` and ``verify``: a plan's evidence as a report, and whether a report stands."""

from __future__ import annotations

import contextlib
import secrets
import shlex
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan, read_plan
from safety_harness.campaign.session import LEDGER, carry_on, processes
from safety_harness.certification.argument import STATE
from safety_harness.certification.evidence import Evidence, Standing
from safety_harness.certification.folder import PAGE, PDF, write_folder, write_manifest
from safety_harness.certification.gather import Trials, gather
from safety_harness.certification.pdf import browser, write_pdf
from safety_harness.certification.results import refuse_hopeless
from safety_harness.certification.searched import searches_of
from safety_harness.certification.tool_files import read_oracles, read_selftest
from safety_harness.certification.verify import verify as verify_report
from safety_harness.cli.campaign_lines import CampaignProgress
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    explain,
    one_more_ctrl_c,
    result,
    say,
)
from safety_harness.cli.fuzz import fuzz
from safety_harness.exceptions import InputError, SafetyHarnessError


def certify(
    file: Path,
    *,
    out: Path | None = None,
    pdf: bool = False,
    workers: int | None = None,
    selftest: Path | None = None,
    oracles: Path | None = None,
) -> int:
    """Run or resume the plan, search, write the report; returns the exit code."""
    try:
        plan = read_plan(file)
        refuse_hopeless(plan)
        if pdf:
            browser()
        trials = Trials(
            selftest=None if selftest is None else read_selftest(selftest),
            oracles=() if oracles is None else read_oracles(oracles),
            oracles_with="" if oracles is None else f"as {oracles.name} has it",
        )
        command = _command(file, out, pdf, selftest, oracles)
        job = _Job(plan, out or Path("reports") / plan.name, trials, command)
        return job.run(workers, pdf)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except SafetyHarnessError as error:
        explain(error)
        return DIFFERS
    except KeyboardInterrupt:
        say("interrupted: every finished run is kept, and the same command goes on from there")
        return INTERRUPTED


def _command(file: Path, out: Path | None, pdf: bool, selftest: Path | None, oracles: Path | None) -> str:
    words = ["safety-harness", "certify", str(file)]
    words += ["--out", str(out)] if out else []
    words += ["--selftest", str(selftest)] if selftest else []
    words += ["--oracles", str(oracles)] if oracles else []
    return shlex.join(words + (["--pdf"] if pdf else []))


@dataclass(frozen=True, eq=False)
class _Job:
    """One plan and the folder that its report goes to."""

    plan: Plan
    folder: Path
    trials: Trials
    command: str

    def run(self, workers: int | None, pdf: bool) -> int:
        """All of it; what is there already is not made again."""
        complete = self._campaign(workers) and self._search()
        with Ledger.open(self.folder / LEDGER) as ledger:
            gathered = gather(self.plan, ledger, self.folder, command=self.command, trials=self.trials)
            evidence = write_folder(self.folder, gathered, ledger)
        if pdf:
            write_pdf(self.folder / PAGE, self.folder / PDF)
        write_manifest(self.folder, evidence.files)
        _tell(evidence, self.folder)
        if not complete:
            say("interrupted: the report says what is missing; the same command goes on from there")
            return INTERRUPTED
        return AS_EXPECTED if evidence.standing is Standing.SHOWN else DIFFERS

    def _campaign(self, workers: int | None) -> bool:
        progress = CampaignProgress(self.plan)
        remark = "what is under way is finished and kept; Ctrl-C again drops it"
        with one_more_ctrl_c(remark) as interrupted, progress.running():
            return carry_on(
                self.plan,
                self.folder / LEDGER,
                processes(workers),
                on_progress=progress.show,
                enough=interrupted,
            )

    def _search(self) -> bool:
        """The plan's search, shared among its strata, with standard output kept for the verdicts.

        What was begun and not finished is begun anew.  False for Ctrl-C; what fails is said in the report.
        """
        for stratum, one in zip(self.plan.strata, searches_of(self.plan, self.folder), strict=False):
            if one.complete or stratum.space.file is None:
                continue
            say(f"searching {one.stratum} for counterexamples, {one.asked} runs")
            shutil.rmtree(one.folder, ignore_errors=True)
            try:
                with contextlib.redirect_stdout(sys.stderr):
                    code = fuzz(
                        stratum.space.file,
                        out=one.folder,
                        avoider=self.plan.avoider_here,
                        budget=one.asked,
                        seed=self.plan.seed,
                        claims=[claim.sentence for claim in self.plan.claims],
                    )
            except SafetyHarnessError as error:
                explain(error)
                continue
            if code == INTERRUPTED:
                return False
        return True


def _tell(evidence: Evidence, folder: Path) -> None:
    """A line a claim, then where the report is."""
    for claim in evidence.claims:
        mark = {"holds": "ok  ", "violated": "NO  "}.get(STATE[claim.standing], "open")
        result(f"{mark} {claim.standing.value:<21} {claim.sentence}: {claim.why}")
    result(f"{folder / PAGE}")


def verify(folder: Path, *, runs: int, seed: int | None, execute_avoider: bool) -> int:
    """Does the report stand?  Returns the exit code."""
    seed = secrets.randbelow(2**31) if seed is None else seed
    stands, whole = True, True
    try:
        for check in verify_report(
            folder, runs=runs, seed=seed, execute_avoider=execute_avoider, on_progress=say
        ):
            stands, whole = stands and check.stands, whole and not check.unchecked
            mark = "DIFF" if not check.stands else "open" if check.unchecked else "ok  "
            result(f"{mark} {check.looked_at}")
            for line in (*check.faults, *check.notes, *(f"not checked: {one}" for one in check.unchecked)):
                result(f"     {line}")
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except SafetyHarnessError as error:
        explain(error)
        return DIFFERS
    except KeyboardInterrupt:
        say("interrupted: what was not checked yet is not known to stand")
        return INTERRUPTED
    open_ones = "" if whole else ", but for what was not checked"
    result(f"the report stands{open_ones}" if stands else "the report does not stand")
    return AS_EXPECTED if stands else DIFFERS
