"""``safety-harness certify`` and ``verify``: a plan's evidence as a report, and whether a report stands."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option, Typer
from typer.core import TyperGroup

from safety_harness.cli.console import AS_EXPECTED, DIFFERS, document, next_step, result, say
from safety_harness.cli.options import Executes, OfController, Workers, command

if TYPE_CHECKING:
    from safety_harness.extensions.assurance.campaign.plan import Plan
    from safety_harness.extensions.assurance.certification.delta import EvidenceDelta


class _PlanOrCommand(TyperGroup):
    """``certify PLAN`` beside ``certify declare PLAN``: what is no command's name is a plan or an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As if the command that needs no name had been named; not while a shell completes that name."""
        named = args[0] in self.commands if args else ctx.resilient_parsing
        return super().parse_args(ctx, args if named else ["plan", *args])

    def list_commands(self, ctx: Any) -> list[str]:
        """Those that have to be named."""
        return [name for name in super().list_commands(ctx) if name != "plan"]

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Without its name in what a user reads."""
        name, command, rest = super().resolve_command(ctx, args)
        return (None if name == "plan" else name), command, rest


commands = Typer()
_ABOUT = "Run a declared plan and write its evidence; declare, seal, delta."
of_certify = Typer(name="certify", cls=_PlanOrCommand, help=_ABOUT, short_help=_ABOUT)


@command(
    of_certify,
    "plan",
    interrupted="interrupted: every finished run is kept, and the same command goes on from there",
    failed=DIFFERS,
)
def certify(
    plan: Annotated[Path, Argument(help="A plan: claims, strata, runs, confidence.", metavar="PLAN")],
    out: Annotated[
        Path | None, Option(help="Folder for the report; without it reports/NAME of the plan.")
    ] = None,
    pdf: Annotated[
        bool, Option("--pdf", help="Also print the page to evidence.pdf, with an installed Chromium.")
    ] = False,
    full: Annotated[
        bool, Option("--full", help="On paper have all of the page, and not the gravest of each kind.")
    ] = False,
    workers: Workers = None,
    selftest: Annotated[
        Path | None, Option(help="selftest.json of safety-harness selftest, to be part of the report.")
    ] = None,
    oracles: Annotated[
        Path | None,
        Option(help="Independent oracles, likewise; of this version: shipped:plans/oracles.json."),
    ] = None,
    cell: Annotated[
        list[Path],
        Option(help="compare-worlds.json of safety-harness compare-worlds, likewise; may be given again."),
    ] = [],  # noqa: B006
    declared: Annotated[
        Path | None, Option(help="What certify declare wrote; without it PLAN.declared.json, if it is there.")
    ] = None,
    proof: Annotated[
        Path | None, Option(help="certificate.json of safety-harness prove, of the avoider's network.")
    ] = None,
    since: Annotated[
        Path | None,
        Option(
            help="An earlier report's folder: say what changed, and fail for what got worse.", metavar="OLD"
        ),
    ] = None,
    controller: OfController = None,
) -> int:
    """Run a declared plan and write its evidence: one page, JSON, JUnit XML, and all to re-run it.

    certify declare PLAN, before, and certify seal REPORT, after, print hashes to be lodged elsewhere.
    A plan that is not as it was declared is refused.
    Bounds are made of the plan's own independent runs; what its search finds is shown and estimates nothing.
    A line a claim goes to standard output. Ctrl-C keeps every finished run; the same command goes on.
    It is no certificate, and says so.
    With --since OLD the delta (REPORT.delta/delta.html, delta.json) is written too and decides the exit code.
    Exit code 0: every claim is shown, with --since: nothing got worse; 1: otherwise; 2: bad input, or a
    target that the plan's runs cannot meet; 130: interrupted.
    """
    from safety_harness.admission.claims import property_of
    from safety_harness.claims.properties.base import close_to, far_words
    from safety_harness.claims.properties.tried import UNTRIED
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.assurance.campaign.session import LEDGER
    from safety_harness.extensions.assurance.certification.argument import STATE
    from safety_harness.extensions.assurance.certification.verdicts import overruling_line, percent
    from safety_harness.extensions.assurance.certify_job import certify as certify_plan
    from safety_harness.extensions.assurance.commands.campaign_lines import tested_lines
    from safety_harness.scenario.typed_json import plain
    from safety_harness.trace.answer_times import UNHEEDED

    found = certify_plan(
        plan,
        controller=controller,
        out=out,
        pdf=pdf,
        full=full,
        workers=workers,
        selftest=selftest,
        oracles=oracles,
        cells=cell,
        declared=declared,
        proof=proof,
        since=since,
        output=TERMINAL,
    )
    evidence = found.evidence
    document(**plain(evidence), page=found.page)
    say(*(f"error: {text}" for text in evidence.unmade))
    result(*tested_lines(found.plan), *_shielded_lines(found.plan, found.folder / LEDGER))
    for claim in evidence.claims:
        mark = {"holds": "ok  ", "violated": "NO  "}.get(STATE[claim.standing], "open")
        result(f"{mark} {claim.standing.value:<21} {claim.sentence}: {claim.why}")
    simplest = found.plan.strata[0].space.simplest
    for planned, claim in zip(found.plan.claims, evidence.claims, strict=True):
        margins = [one.least_margin_si for one in claim.outcomes if one.least_margin_si is not None]
        far = far_words(close_to(property_of(planned.claim, simplest)), min(margins, default=None))
        say(*[f"note: {claim.sentence}: {far}"] * bool(far))
    result(*(overruling_line(one) for one in evidence.overruling if one.words))
    bounds, confidence = evidence.plan.bounds, percent(evidence.plan.confidence)
    if any(one.bound for claim in evidence.claims for one in claim.outcomes):
        result(f"all {bounds} bounds of the report hold together with {confidence} confidence")
    if evidence.fallback:
        result(evidence.fallback)
    say(
        *(
            f"note: {one.text}"
            for one in evidence.findings
            if f": {UNTRIED} " in one.text or UNHEEDED in one.text or one.place == "recorded-cells"
        )
    )
    result(evidence.basis, f"{found.page}: {evidence.standing.value}")
    if not found.complete:
        say("interrupted: the report says what is missing; the same command goes on from there")
    else:
        folder = shlex.quote(str(found.folder))
        next_step(f"safety-harness verify {folder}", "does the report stand?")
        next_step(f"safety-harness certify seal {folder}", "a hash to lodge where its day cannot be changed")
    if found.delta is not None:
        _tell_delta(found.delta, found.folder)
    return found.exit_code


def _shielded_lines(plan: Plan, ledger: Path) -> list[str]:
    """How much shields slowed the arm, in the random runs of each stratum whose traces are kept."""
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.certification.guard import ReportGuard
    from safety_harness.extensions.assurance.certification.stored import random_traces
    from safety_harness.report.shielding import shield_lines

    shielded = {k: one.name for k, one in enumerate(plan.strata) if one.space.simplest.shield is not None}
    if not shielded:
        return []  # stored traces are not read for nothing
    with Ledger.open(ledger, alone=True) as opened:
        stored, _ = random_traces(plan, opened)
    lines = []
    for k, name in shielded.items():
        traces = [one.trace for one in stored if one.stratum == k]
        words = ReportGuard().of("slowing", partial(shield_lines, traces), []) or [
            "how much it slowed is not known"
        ]
        lines.append(f"shield in {name}, {len(traces)} stored runs: {words[0]}")
    return lines


def _tell_delta(delta: EvidenceDelta, report: Path) -> None:
    """Print what changed since an earlier report."""
    from safety_harness.extensions.assurance.certification.delta_page import PAGE, folder_of_delta
    from safety_harness.scenario.typed_json import plain

    document(delta=plain(delta))
    result(*(f"WORSE {text}" for text in delta.regressions))
    result(*(f"closed {text}" for text in delta.closed))
    spaces = [one for one in delta.parts if one.part == "space"]
    result(*(f"another space, {one.name}: {one.before} before, {one.after} now" for one in spaces))
    again = [one.what for one in delta.carried if not one.carries]
    result(f"to be run again: {', '.join(again) or 'nothing'}", delta.line, *delta.bases)
    result(f"{folder_of_delta(report) / PAGE}")


@command(of_certify, "delta")
def tell_delta(
    old: Annotated[Path, Argument(help="The folder of the earlier report.", metavar="OLD")],
    new: Annotated[Path, Argument(help="The folder of the later one.", metavar="NEW")],
) -> int:
    """Say what changed between two reports, and what got worse; nothing is run.

    NEW.delta/delta.html and delta.json say it all: software, system, settings, spaces, claims, bounds,
    findings, and which of the earlier runs speak of the later system too.
    Exit code 0: nothing got worse; 1: something did; 2: no report, one that is not finished, or one whose
    files were altered.
    """
    from safety_harness.extensions.assurance.certification.delta import EarlierReport
    from safety_harness.extensions.assurance.certify_job import compare_reports
    from safety_harness.scenario.files import told

    before, after = EarlierReport.read(old), EarlierReport.read(new)
    made_by = shlex.join(["safety-harness", "certify", "delta", str(told(old)), str(told(new))])
    delta = compare_reports(before, after, made_by)
    _tell_delta(delta, after.folder)
    return DIFFERS if delta.regressions else AS_EXPECTED


@command(of_certify)
def declare(
    plan: Annotated[Path, Argument(help="A plan that has not been run yet.", metavar="PLAN")],
    out: Annotated[
        Path | None, Option(help="File to write; without it PLAN.declared.json beside the plan.")
    ] = None,
) -> int:
    """Print a hash over plan, seed, avoider, targets and software, to be lodged elsewhere before the runs.

    verify REPORT --declared HASH shows later that the report is of what was declared.
    Exit code 0; 2: bad input, or another declaration is there.
    """
    from safety_harness.extensions.assurance.campaign.plan import read_plan
    from safety_harness.extensions.assurance.certification.lodged import declaration_file, write_declaration
    from safety_harness.extensions.assurance.certification.results import refuse_hopeless

    read = read_plan(plan)
    refuse_hopeless(read)
    path = out or declaration_file(plan)
    made = write_declaration(read, path)
    result(made.sha256)
    document(sha256=made.sha256, declaration=path)
    say(
        f"{path}: plan, seed {read.seed}, avoider, targets and software. Lodge the hash where its day cannot "
        "be changed, before you run the plan: a signed git tag, a timestamping service, an e-mail to whoever "
        "will judge. Runs repeat themselves: let them name the seed, or they may ask if you had tried it."
    )
    return AS_EXPECTED


@command(of_certify, "seal")
def seal_report(
    report: Annotated[Path, Argument(help="The folder of a report of certify.", metavar="REPORT")],
) -> int:
    """Print a hash over a report's rows, declaration and files, to be lodged elsewhere.

    It is written to REPORT.seal.json. verify REPORT --seal HASH shows later that nothing was altered since.
    Exit code 0; 1: files of the report are not those that were written; 2: bad input, or another seal is
    there.
    """
    from safety_harness.extensions.assurance.certification.folder import read_manifest
    from safety_harness.extensions.assurance.certification.lodged import seal_file, write_seal
    from safety_harness.extensions.assurance.certification.verify_files import check_files

    check = check_files(report, read_manifest(report))
    result(*(f"DIFF {line}" for line in check.faults))
    document(faults=check.faults)
    if not check.stands:
        return DIFFERS
    made = write_seal(report)
    result(made.sha256)
    document(sha256=made.sha256, rows_sha256=made.rows, seal=seal_file(report))
    say(
        f"{seal_file(report)}: the root over all rows, {made.rows[:16]}, the declaration and the hash of "
        "every file. Lodge the hash elsewhere (a signed git tag, a timestamping service, e-mail): verify "
        "--seal finds whatever is altered from now on."
    )
    return AS_EXPECTED


def _chance(said: str | float) -> float:
    """A chance as per cent or a number."""
    text = str(said)
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1.0:
        raise BadParameter(f"{text!r} is no chance: expected 1% or 0.01, say")
    return value


@command(commands, interrupted="interrupted: what was not checked yet is not known to stand", failed=DIFFERS)
def verify(
    report: Annotated[Path, Argument(help="The folder of a report of certify.", metavar="FOLDER")],
    runs: Annotated[
        int | None,
        Option(help="Runs to make again, drawn at random; without it as --miss asks, 1000 at most.", min=0),
    ] = None,
    miss: Annotated[
        float,
        Option(
            parser=_chance, help="Chance of overlooking altered rows that turn a verdict.", metavar="CHANCE"
        ),
    ] = "1%",  # type: ignore[assignment]
    seal: Annotated[
        str | None, Option(help="Hash that certify seal printed, as it was lodged elsewhere, or its file.")
    ] = None,
    declared: Annotated[
        str | None, Option(help="Hash that certify declare printed, as it was lodged elsewhere, or its file.")
    ] = None,
    seed: Annotated[
        int | None,
        Option(
            help="To repeat an earlier draw of runs; without it others each time, and it says which.", min=0
        ),
    ] = None,
    execute_programs: Executes = False,
    strict: Annotated[bool, Option(help="Exit code 1 also where something is open.")] = False,
) -> int:
    """Check a report: files, plan, ledger, traces; compute numbers and page anew, make some runs again.

    What has changed since (source, versions, networks, platform) is named, and so is what was not checked.
    Without a lodged --seal altered rows are seen only as far as runs made again tell: it says how few would
    turn a verdict, and with what chance they were missed.
    Exit code 0: the report stands, and what was not checked is marked open; 1: it does not stand, and why,
    or something is open and --strict is given; 2: no report, or a program in it that may not be
    executed; 130: interrupted.
    """
    import secrets
    from dataclasses import asdict

    from safety_harness.cli.progress import paced_lines
    from safety_harness.extensions.assurance.certification.evidence import read_evidence
    from safety_harness.extensions.assurance.certification.folder import JSON
    from safety_harness.extensions.assurance.certification.verify import verify as verify_report

    checks = []
    with paced_lines() as tell:
        for check in verify_report(
            report,
            runs=runs,
            miss=_chance(miss),  # the default is as it is shown
            seed=secrets.randbelow(2**31) if seed is None else seed,
            execute_programs=execute_programs,
            seal=seal,
            declared=declared,
            on_progress=tell,
        ):
            checks.append(asdict(check) | {"stands": check.stands})
            mark = "DIFF" if not check.stands else "open" if check.unchecked else "ok  "
            result(f"{mark} {check.looked_at}")
            lines = (*check.faults, *check.notes, *(f"not checked: {one}" for one in check.unchecked))
            result(*(f"     {line}" for line in lines))
    stands, whole = all(one["stands"] for one in checks), not any(one["unchecked"] for one in checks)
    document(stands=stands, checks=checks)
    open_ones = "" if whole else ", but for what was not checked"
    if stands:
        evidence = read_evidence(report / JSON)
        result(evidence.basis, f"the report stands{open_ones}: {evidence.standing.value}")
    else:
        result("the report does not stand")
    return AS_EXPECTED if stands and (whole or not strict) else DIFFERS
