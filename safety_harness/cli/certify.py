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
from safety_harness.certification.declaration import beside as declaration_file
from safety_harness.certification.declaration import declared_sha256, write_declaration
from safety_harness.certification.evidence import ClaimStatus, Evidence
from safety_harness.certification.folder import PAGE, PDF, read_manifest, write_folder, write_manifest
from safety_harness.certification.gather import HarnessTrials, gather
from safety_harness.certification.pdf import browser, write_pdf
from safety_harness.certification.results import refuse_hopeless
from safety_harness.certification.seal import beside as seal_file
from safety_harness.certification.seal import write_seal
from safety_harness.certification.searched import searches_of
from safety_harness.certification.tool_files import read_oracles, read_selftest
from safety_harness.certification.verdicts import percent
from safety_harness.certification.verify import MISS
from safety_harness.certification.verify import verify as verify_report
from safety_harness.certification.verify_files import check_files
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
from safety_harness.scenario.files import told
from safety_harness.trace.provenance import refuse_shared_modules


def certify(
    file: Path,
    *,
    out: Path | None = None,
    pdf: bool = False,
    workers: int | None = None,
    selftest: Path | None = None,
    oracles: Path | None = None,
    declared: Path | None = None,
) -> int:
    """Run or resume the plan, search, write the report; returns the exit code."""
    try:
        plan = read_plan(file)
        declaration_sha256 = declared_sha256(plan, declared)
        refuse_hopeless(plan)
        refuse_shared_modules()
        if pdf:
            browser()
        trials = HarnessTrials(
            selftest=None if selftest is None else read_selftest(selftest),
            oracles=() if oracles is None else read_oracles(oracles),
            oracles_with="" if oracles is None else f"as {oracles.name} has it",
        )
        command = _command(
            file, {"--out": out, "--selftest": selftest, "--oracles": oracles, "--declared": declared}, pdf
        )
        job = _Job(plan, out or Path("reports") / plan.name, trials, command, declaration_sha256)
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


def declare(file: Path, out: Path | None) -> int:
    """Write a plan's declaration and print its hash; returns the exit code."""
    try:
        plan = read_plan(file)
        refuse_hopeless(plan)
        path = out or declaration_file(file)
        result(write_declaration(plan, path).sha256)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    say(
        f"{path}: plan, seed {plan.seed}, avoider, targets and software. Lodge the hash where its day cannot "
        "be changed, before you run the plan: a signed git tag, a timestamping service, an e-mail to whoever "
        "will judge. Runs repeat themselves: let them name the seed, or they may ask if you had tried it."
    )
    return AS_EXPECTED


def seal_report(folder: Path) -> int:
    """Write a report's seal and print its hash, if its files are those that were written."""
    try:
        check = check_files(folder, read_manifest(folder))
        for line in check.faults:
            result(f"DIFF {line}")
        if not check.stands:
            return DIFFERS
        made = write_seal(folder)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    result(made.sha256)
    say(
        f"{seal_file(folder)}: the root over all rows, {made.rows[:16]}, the declaration and the hash of "
        "every file. Lodge the hash elsewhere (a signed git tag, a timestamping service, e-mail): verify "
        "--seal finds whatever is altered from now on."
    )
    return AS_EXPECTED


def _command(file: Path, options: dict[str, Path | None], pdf: bool) -> str:
    words = ["safety-harness", "certify", str(told(file))]
    for name, value in options.items():
        words += [name, str(told(value))] if value else []
    return shlex.join(words + (["--pdf"] if pdf else []))


@dataclass(frozen=True, eq=False)
class _Job:
    """One plan and the folder that its report goes to."""

    plan: Plan
    folder: Path
    trials: HarnessTrials
    command: str
    declaration_sha256: str = ""

    def run(self, workers: int | None, pdf: bool) -> int:
        """All of it; what is there already is not made again."""
        complete = self._campaign(workers) and self._search()
        with Ledger.open(self.folder / LEDGER) as ledger:
            gathered = gather(
                self.plan,
                ledger,
                self.folder,
                command=self.command,
                trials=self.trials,
                declaration=self.declaration_sha256,
            )
            evidence = write_folder(self.folder, gathered, ledger)
        if pdf:
            write_pdf(self.folder / PAGE, self.folder / PDF)
        write_manifest(self.folder, evidence.files)
        _tell(evidence, self.folder)
        if not complete:
            say("interrupted: the report says what is missing; the same command goes on from there")
            return INTERRUPTED
        return AS_EXPECTED if evidence.standing is ClaimStatus.SHOWN else DIFFERS

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
    """A line a claim, with what confidence, then where the report is."""
    for claim in evidence.claims:
        mark = {"holds": "ok  ", "violated": "NO  "}.get(STATE[claim.standing], "open")
        result(f"{mark} {claim.standing.value:<21} {claim.sentence}: {claim.why}")
    plan = evidence.plan
    result(f"all {plan.bounds} bounds of the report hold together with {percent(plan.confidence)} confidence")
    if evidence.fallback:
        result(evidence.fallback)
    result(f"{folder / PAGE}")


def verify(
    folder: Path,
    *,
    runs: int | None = None,
    miss: float = MISS,
    seed: int | None,
    execute_avoider: bool,
    seal: str | None = None,
    declared: str | None = None,
) -> int:
    """Does the report stand?  Returns the exit code."""
    seed = secrets.randbelow(2**31) if seed is None else seed
    stands, whole = True, True
    try:
        for check in verify_report(
            folder,
            runs=runs,
            miss=miss,
            seed=seed,
            execute_avoider=execute_avoider,
            seal=seal,
            declared=declared,
            on_progress=say,
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
