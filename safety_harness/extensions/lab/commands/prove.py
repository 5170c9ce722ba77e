"""The command ``prove``: prove claims about a network on a region of inputs, or check a certificate."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, DIFFERS, columns_of, document, result, say
from safety_harness.cli.options import command

if TYPE_CHECKING:
    from safety_harness.extensions.lab.prove_job import ProofResult

commands = Typer()


@command(commands)
def prove(
    file: Annotated[
        Path,
        Argument(
            help="A plan of proofs, a certificate (with --check), or a trace (with --decisions).",
            metavar="PLAN|CERTIFICATE|TRACE",
        ),
    ],
    check: Annotated[bool, Option("--check", help="Check a certificate with independent code.")] = False,
    model: Annotated[
        Path | None,
        Option(
            help="The network of the certificate for --check. Required if the network is not shipped.",
            metavar="FILE",
        ),
    ] = None,
    out: Annotated[
        Path, Option(help="Folder for the certificate, the page, and scenarios with wrong answers.")
    ] = Path("reports/prove"),
    minutes: Annotated[float, Option(help="Time limit for all claims together, in minutes.", min=0.0)] = 5.0,
    halvings: Annotated[
        int, Option(help="Largest number of times that the command halves a box.", min=1, max=60)
    ] = 40,
    jobs: Annotated[int, Option(help="Number of processes.", min=1)] = 1,
    decisions: Annotated[
        str | None,
        Option(
            help="Check for each decision in a trace whether it stays the same if the hand moves by up to "
            "this length along each axis. The command adds the results to a copy of the trace.",
            metavar="LENGTH",
        ),
    ] = None,
    resume: Annotated[
        bool, Option("--resume", help="Continue with the certificate in the folder of --out.")
    ] = False,
) -> int:
    """Prove claims about every answer of a small ReLU network.

    A claim concerns all inputs in a region. The bounds account for the rounding
    of the network's arithmetic. The command halves the region into boxes until
    each box is proven, or is refuted for all its inputs, or until the time
    ends. The remaining boxes are undecided. A single input with a wrong answer
    of the network also refutes a claim. If a simulated run can begin with this
    input, the command writes the input as a scenario.

    Exit code 0: all claims are proven, all decisions stay the same
    (--decisions), or the certificate is confirmed (--check).
    Exit code 1: a claim is not proven, a decision may change (--decisions), or
    the certificate is not confirmed (--check).
    Exit code 2: bad input.
    Exit code 130: interrupted; the certificate has the results until then.
    """
    if check:
        return _check(file, model)
    if decisions is not None:
        return _decisions(file, decisions, out)
    from safety_harness.claims.properties.tally import BASIS_OF_ANSWERS
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.lab.prove_job import CERTIFICATE, PAGE
    from safety_harness.extensions.lab.prove_job import prove as prove_plan

    proved = prove_plan(
        file,
        minutes=minutes,
        halvings=halvings,
        jobs=jobs,
        resume=out if resume else None,
        output=TERMINAL,
    )
    _print_shares(proved)
    proved = proved.write(out, TERMINAL)
    _print_bounds(proved)
    document(**proved.data(out))
    result("", BASIS_OF_ANSWERS, str(out / PAGE))
    say(f"certificate: {out / CERTIFICATE} (safety-harness prove --check {out / CERTIFICATE})")
    if proved.interrupted:
        say("interrupted: --resume goes on")
    return proved.exit_code


def _print_shares(proved: ProofResult) -> None:
    """Print the proven, refuted and undecided fractions of each claim's region."""
    from safety_harness.claims.properties.tally import table
    from safety_harness.extensions.lab.proof.certificate import outward

    rows = []
    for proof in proved.proofs:
        cells = outward(proof.least_shares)
        rows.append((proof.planned.claim.sentence, proof.planned.region.name, proof.verdict, *cells))
    columns = ("claim", "region", "verdict", "proven", "refuted", "undecided")
    result(f"{proved.plan.avoider}: by region the least proven and the most undecided share", "")
    result(*table(columns, rows, columns_of(sys.stdout), named_by=2, right=range(3, 6)))


def _print_bounds(proved: ProofResult) -> None:
    """Print bounds on the probability of wrong answers, if the plan has a distribution of inputs."""
    from safety_harness.claims.properties.tally import table

    if proved.plan.questions is None:
        return
    confidence = f"{proved.plan.questions.confidence:.7g}"
    rows = [
        (proof.planned.claim.sentence, proof.planned.region.name, *bound.cells)
        for proof, bound in zip(proved.proofs, proved.bounds, strict=True)
    ]
    columns = ("claim", "region", "wrong at most", "at least", "undecided", "of it asked", "wrong")
    heading = f"chance of a wrong answer to a question that the plan draws; all hold with {confidence}"
    result("", heading, "")
    result(*table(columns, rows, columns_of(sys.stdout), named_by=2, right=range(2, 7)))


def _decisions(file: Path, text: str, out: Path) -> int:
    """Certify the decisions in a trace, and write a copy of the trace that contains the certificates."""
    import hashlib
    from dataclasses import replace

    from safety_harness.base.exceptions import InputError, Place
    from safety_harness.base.whole_file import writing
    from safety_harness.cell.avoidance.model_file import load_model
    from safety_harness.cell.avoidance.shipped import network_file_of
    from safety_harness.claims.properties.tally import table
    from safety_harness.extensions.lab.proof.decisions import certified_decisions
    from safety_harness.scenario.typed_json import plain
    from safety_harness.scenario.units import LENGTH, parse_quantity
    from safety_harness.trace.certified import Sameness
    from safety_harness.trace.store import load_trace, save_trace
    from safety_harness.trace.unmeasured import refuse_not_simulated

    half_m, trace = parse_quantity(text, LENGTH, Place(field="--decisions")), load_trace(file)
    if not 0.0 <= half_m <= 1.0:
        raise InputError.of_option("--decisions", "a length from 0 m to 1 m", text, "")
    refuse_not_simulated(trace, file)
    network = None if trace.scenario.driven else network_file_of(trace.scenario)
    if network is None:
        expected = "a run of a network that ships, or of FILE.safetensors"
        raise InputError(place=Place(file=file), expected=expected, got=trace.scenario.under_test)
    model = load_model(network)
    certified = certified_decisions(trace, model, hashlib.sha256(network.read_bytes()).hexdigest(), half_m)
    path = out / file.name
    with writing(path):
        save_trace(replace(trace, certified=certified), path)
    rows = [
        (str(number), f"{time_s:.3f} s", decision.summary)
        for number, (decision, time_s) in enumerate(
            zip(certified.decisions, trace.decisions["time_s"], strict=True), 1
        )
    ]
    result(*table(("decision", "at", "every hand near"), rows, columns_of(sys.stdout), named_by=1))
    result("", certified.summary, str(path))
    say(f"safety-harness judge {path} --out {out} shows it in the report")
    document(trace=path, **plain(certified))
    same = bool(rows) and all(decision.whole is Sameness.SAME for decision in certified.decisions)
    return AS_EXPECTED if same else DIFFERS


def _check(file: Path, model: Path | None) -> int:
    """Check a certificate with independent code."""
    from safety_harness.base.exceptions import InputError, Place
    from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
    from safety_harness.extensions.lab.proof.certificate import FORMAT
    from safety_harness.extensions.lab.proof.check import check
    from safety_harness.scenario.files import read_bytes
    from safety_harness.scenario.typed_json import LARGEST_BYTES, of_format, read_json

    content = of_format(read_json(file, "a certificate of prove"), FORMAT, file)
    name = content.get("avoider")
    if model is None and name not in SHIPPED:
        raise InputError.of_option(
            "--model", "the network's file, since it is not shipped", "nothing", str(name)
        )
    network = model if model is not None else shipped_model(str(name))
    certificate, weights = (
        read_bytes(path, most=LARGEST_BYTES, place=Place(file=path), error=InputError)
        for path in (file, network)
    )
    try:
        lines = check(certificate, weights)
    except Exception as error:  # a foreign certificate may raise anything; then it is not confirmed
        say(f"not confirmed: {type(error).__name__}: {error}")
        document(confirmed=False, why=f"{type(error).__name__}: {error}", claims=[])
        return DIFFERS
    result(*(f"confirmed {line}" for line in lines))
    document(confirmed=True, why=None, claims=lines)
    return AS_EXPECTED
