"""Define the command ``safety-harness monitor``, which evaluates claims on the live data of a cell."""

from __future__ import annotations

import json
import os
import selectors
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, explain, result, say
from safety_harness.cli.options import command

if TYPE_CHECKING:
    from safety_harness.extensions.field.monitoring.cell import WatchedCell
    from safety_harness.extensions.field.monitoring.monitor import Monitor, VerdictLine

commands = Typer()
OPTIONS = {"robot": "--robot", "log.hands": "--hand", "log.period": "--period"}  # by the field that each sets
REFUSED_TOLD = 5  # unusable lines that are explained; further ones are only counted
CHUNK = 65_536
MOST_WAIT_S = 10.0  # a choice


@command(commands, "monitor", json=False)
def monitor(
    cell: Annotated[
        Path | None,
        Argument(
            help="A LOG.yaml that states claims and the accuracy of the cell's data. The command does not "
            "open the recordings to which it refers.",
            metavar="LOG.yaml",
            show_default=False,
        ),
    ] = None,
    claim: Annotated[
        list[str] | None,
        Option(help="A formula that replaces the claims of LOG.yaml. May be repeated.", metavar="SENTENCE"),
    ] = None,
    robot: Annotated[
        str | None,
        Option(
            help="The arm: UR10, UR5, UR3 or the file of an arm. Only without a LOG.yaml.", metavar="ROBOT"
        ),
    ] = None,
    hand: Annotated[
        list[str] | None,
        Option(
            help="The name of a hand in the stream. Default: 'hand', if a claim contains this word. Only "
            "without a LOG.yaml. May be repeated.",
            metavar="NAME",
        ),
    ] = None,
    period: Annotated[
        str | None,
        Option(help="Time between two ticks. Default: '8 ms'. Only without a LOG.yaml.", metavar="TIME"),
    ] = None,
    wait: Annotated[
        str,
        Option(
            help="Time for which the monitor delays each line, so that a late line with an earlier time "
            "can still come first. At most 10 s.",
            metavar="TIME",
        ),
    ] = "0 ms",
    out: Annotated[
        Path | None,
        Option(
            help="Folder for the monitor's own log, in parts that the command judge can read. Without it, "
            "no log is written.",
            show_default=False,
        ),
    ] = None,
    part: Annotated[int, Option(help="Largest size of a part of the log, in MB.", min=1, metavar="MB")] = 100,
    keep: Annotated[
        int, Option(help="Number of parts of the log to keep; the oldest parts are deleted.", min=2)
    ] = 10,
    json_lines: Annotated[
        bool, Option("--json", help="Print one JSON object per line instead of lines for people.")
    ] = False,
) -> int:
    """Watch claims on a live cell. This is no safety function.

    The command prints a line whenever the verdict on a claim changes. It reads JSON lines from standard
    input, such as

    {"time_s": 1.008, "joint_position_rad": [0, -1.2, 1.9, -2.2, -1.5, 0], "hands": {"hand":
    {"hand_position_in_base_m": [0.9, 0.1, 0.3], "elbow_position_in_base_m": [1.2, 0.1, 0.4]}}}

    Joints and hands may arrive on separate lines. If a hand is null, this hand is lost, and claims on it are
    inconclusive at once. The verdicts equal the verdicts of the command judge on a log of the same data with
    the same LOG.yaml. A verdict is either inconclusive, or certain if the statements in LOG.yaml are true.

    robot_stream | safety-harness monitor --robot ur10 --claim "always hand distance > 50 mm"

    The log that --out writes remains, even if the command fails. The exit code describes the end of the
    stream.

    Exit code 0: every claim holds.
    Exit code 1: a claim is violated, inconclusive or not watched.
    Exit code 1 too: the last line of the stream is unusable.
    Exit code 2: bad input, or a stream without usable joints.
    Exit code 130: interrupted; the log remains.
    """
    from safety_harness.base.exceptions import Place, SettingsError
    from safety_harness.extensions.field.monitoring.cell import assumptions_of
    from safety_harness.extensions.field.monitoring.journal import Journal
    from safety_harness.extensions.field.monitoring.monitor import NO_SAFETY_FUNCTION, Monitor
    from safety_harness.scenario.units import TIME, parse_quantity

    wait_s = parse_quantity(wait, TIME, Place(field="--wait"))
    if not 0.0 <= wait_s <= MOST_WAIT_S:
        raise SettingsError.of_option("--wait", f"a time from 0 to {MOST_WAIT_S:g} s", wait)
    watched = _cell(cell, claim or [], robot, hand, period)
    own = Monitor(cell=watched, wait_s=wait_s, some=not claim)
    if out is not None:
        sentences = [item.sentence for item in watched.scenario.claims]
        own.journal = Journal(cell=watched, claims=sentences, folder=out, most_bytes=part * 10**6, keep=keep)
    say(NO_SAFETY_FUNCTION)
    if cell is None:
        assumed = "; ".join(assumptions_of([item.name for item in watched.hands]).splitlines())
        say(f"assumed without a LOG.yaml: {assumed}")
    for sentence, reason in own.unwatched.items():
        say(f"not watched, though judge may decide it on the log: {sentence} (expected {reason.expected})")
    interrupted, usable, patience_s = False, True, watched.joint_facts.longest_gap_s
    try:
        usable = follow(own, lines_of(sys.stdin.buffer, patience_s), patience_s, as_json=json_lines)
    except KeyboardInterrupt:
        interrupted = True
    code = _ended(own, as_json=json_lines, interrupted=interrupted)
    if code != AS_EXPECTED or (usable and not own.unwatched):
        return code
    say(
        "not 0, since "
        + ("claims were not watched" if usable else "the stream ends with a line that cannot be used")
    )
    return DIFFERS


def follow(own: Monitor, stream: Iterable[bytes | None], patience_s: float, *, as_json: bool) -> bool:
    """Feed every line of ``stream`` to the monitor, and return True if the last line was usable.

    If the program that writes the stream dies, its last line may be cut. If no line with joint positions
    arrives for ``patience_s``, the monitor treats the stream as silent. Lines without joint positions make no
    difference.

    Args:
        own: The monitor.
        stream: The lines, and one None each time ``patience_s`` passes without a line.
        patience_s: The longest time without joints [s].
        as_json: True to print JSON lines.

    """
    from safety_harness.base.exceptions import StreamError

    refused, ticks, since_s, usable = 0, 0, time.monotonic(), True
    for line in stream:
        usable = usable or line is not None
        try:
            for change in own.take(line) if line is not None else ():
                _say(change, as_json)
        except StreamError as error:
            refused, usable = refused + 1, False
            if refused <= REFUSED_TOLD:
                explain(error)
            if refused == REFUSED_TOLD:
                say("further unusable lines are only counted")
        if own.counts.ticks != ticks:
            ticks, since_s = own.counts.ticks, time.monotonic()
        elif line is None or time.monotonic() - since_s > patience_s:
            for change in own.silent():
                _say(change, as_json)
    return usable


def _cell(
    file: Path | None, claims: list[str], robot: str | None, hands: list[str] | None, period: str | None
) -> WatchedCell:
    """Return the cell that ``file`` describes, or the cell that the options describe if ``file`` is None."""
    from safety_harness.base.exceptions import InputError, SettingsError
    from safety_harness.extensions.field.monitoring.cell import cell_taken, read_cell
    from safety_harness.scenario.robots import Robot

    if file is not None:
        for option, value in (("--robot", robot), ("--hand", hands), ("--period", period)):
            if value is not None:
                raise SettingsError.of_option(option, "only LOG.yaml, which has it too", str(value))
        watched = read_cell(file, claims)
    else:
        if robot is None:
            hint = "safety-harness monitor --robot ur10 --claim 'always hand distance > 50 mm'"
            raise SettingsError.of_option("monitor", "a LOG.yaml, or --robot", "neither", hint)
        name = next((entry.value for entry in Robot if entry.value.lower() == robot.lower()), robot)
        named = hands or (["hand"] if any("hand" in claim for claim in claims) else [])
        try:
            watched = cell_taken(name, named, period or "8 ms", claims)
        except InputError as error:  # an error in the text that is made from the options
            field = error.place.field or ""
            option_name = next((option for key, option in OPTIONS.items() if field.startswith(key)), None)
            if option_name is None:
                raise
            raise type(error).of_option(option_name, error.expected, error.got, error.hint) from error
    if not watched.scenario.claims:
        hint = "--claim 'always hand distance > 50 mm'"
        raise SettingsError.of_option("--claim", "a claim at least, there or in LOG.yaml", "none", hint)
    return watched


def lines_of(stream: IO[bytes], patience_s: float) -> Iterator[bytes | None]:
    """Yield each line of ``stream`` as it arrives, and None each time ``patience_s`` [s] pass without data.

    Truncate a line that is longer than the largest usable length, and discard its rest.
    """
    from safety_harness.extensions.field.monitoring.sample import MOST_CHARACTERS

    try:
        source = stream.fileno()
        waiting = selectors.DefaultSelector()
        waiting.register(source, selectors.EVENT_READ)
    except (OSError, ValueError):  # the stream of a test, or a regular file, whose lines are all there
        yield from (line for line in stream if line.strip())
        return
    rest, cut = b"", False
    while True:
        if not waiting.select(patience_s):
            yield None
            continue
        chunk = os.read(source, CHUNK)
        if not chunk:
            break
        *whole, rest = (rest + chunk).split(b"\n")
        for line in whole:
            if not cut and line.strip():
                yield line
            cut = False
        if len(rest) > MOST_CHARACTERS:
            if not cut:
                yield rest
            rest, cut = b"", True
    if rest.strip() and not cut:
        yield rest


def _say(change: VerdictLine, as_json: bool) -> None:
    """Print the line of a changed verdict."""
    if as_json:
        result(json.dumps(change.as_dict))
        return
    now = "" if change.latest is change.verdict else f", now {change.latest.value}"
    margin = "" if change.margin is None else f"  {change.margin:+.4g} {change.unit}".rstrip()
    result(f"{change.time_s:.3f} s  {change.verdict.value}{now}  {change.claim}{margin}  ({change.reason})")


def _ended(own: Monitor, *, as_json: bool, interrupted: bool) -> int:
    """End the monitor ``own``, print its counts and final verdicts, and return the exit code."""
    from safety_harness.base.exceptions import StreamError
    from safety_harness.claims.properties.tally import UNWATCHED_IN_LOGS, basis
    from safety_harness.scenario.model import Verdict

    try:
        for change in own.end():
            _say(change, as_json)
    except StreamError as error:
        explain(error)
    counts = own.counts
    say(", ".join(f"{name.replace('_', ' ')} {number:,}" for name, number in vars(counts).items()))
    if own.journal is not None:
        own.journal.close()
        say(f"log: {own.journal.folder}, part {own.journal.part}: safety-harness judge {own.journal.latest}")
    if interrupted:
        say("interrupted: the log stays")
        return INTERRUPTED
    if not counts.ticks:
        say("error: the stream has no usable joints")
        return BAD_INPUT
    final = own.verdicts()
    if not as_json:
        say("at the end of the stream:")
    for change in final:
        say(f"  {change.verdict.value}  {change.claim}  ({change.reason})")
    exercised = [(int(line.verdict is not Verdict.INCONCLUSIVE), 1) for line in final]
    say(basis(["a stream of a cell"], exercised, UNWATCHED_IN_LOGS))
    return AS_EXPECTED if all(change.verdict is Verdict.HOLDS for change in final) else DIFFERS
