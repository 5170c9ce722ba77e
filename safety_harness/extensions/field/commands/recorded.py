"""Define the commands ``scenario from`` and ``compare-worlds``, which simulate the cell of a log."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option, Typer
from typer.core import TyperGroup

from safety_harness.base.exceptions import InputError, LogError
from safety_harness.base.settings import Vector3
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, document, explain_each, result, say
from safety_harness.cli.options import command

_NUMBER, _UNIT = re.compile(r"[+-]?[0-9.]+(e[+-]?[0-9]+)?"), re.compile(r"[a-z]{1,2}")


class _Quantities(TyperGroup):
    """A group of commands whose options accept a quantity without quotes, such as ``--around 100 mm``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join an option's number with the unit that follows it, then parse all arguments."""
        joined: list[str] = []
        for arg in args:
            number = len(joined) > 1 and joined[-2].startswith("--") and _NUMBER.fullmatch(joined[-1])
            if number and _UNIT.fullmatch(arg):
                joined[-1] += f" {arg}"
            else:
                joined.append(arg)
        return super().parse_args(ctx, joined)


_HELP = "Make a scenario, and a space around it, from the log of a cell."
of_scenarios = Typer(name="scenario", cls=_Quantities, no_args_is_help=True, help=_HELP, short_help=_HELP)
commands = Typer()
Log = Annotated[Path, Argument(help="The description of a log.", metavar="LOG.yaml")]
OfCell = Annotated[
    str | None,
    Option(
        "--scenario",
        help="A scenario of the cell (a file or shipped:NAME) with the values that logs lack: desired "
        "TCP, object, camera, hand sensor, avoider. Its hands and its start have no effect.",
        metavar="FILE",
    ),
]
Begin = Annotated[
    str | None,
    Option(
        "--from",
        help="Start of the part of the log to use, as time since the first sample, for example 1.5 s. "
        "Default: as LOG.yaml states.",
        metavar="TIME",
    ),
]
End = Annotated[
    str | None,
    Option(
        "--to",
        help="End of the part of the log to use, as time since the first sample. Default: as LOG.yaml "
        "states.",
        metavar="TIME",
    ),
]
ElbowTowards = Annotated[
    str | None,
    Option(
        help="The point towards which a forearm points if the log has no elbow, for example '1.6 m, "
        "-1.2 m, 0.3 m'. Default: the point in --scenario.",
        metavar="POINT",
    ),
]


@of_scenarios.callback()
def _group() -> None:
    """Keep ``from`` a subcommand of ``scenario``, although the group has no other command."""


@command(of_scenarios, "from")
def scenario_from(
    log: Log,
    scenario: OfCell = None,
    around: Annotated[
        str | None,
        Option(
            help="Largest shift of the hands along each axis in the space, for example 100 mm.",
            metavar="LENGTH",
        ),
    ] = None,
    speed: Annotated[
        str | None,
        Option(
            help="Smallest and largest factor of the hands' speed in the space, for example 0.8..1.25.",
            metavar="LOW..HIGH",
        ),
    ] = None,
    start: Begin = None,
    to: End = None,
    desired_tcp: Annotated[
        str | None,
        Option(
            help="The TCP position at the end of the task, only without --scenario, for example '700 mm, 0"
            " mm, 350 mm'. Default: the position at the end of the log.",
            metavar="POINT",
        ),
    ] = None,
    elbow_towards: ElbowTowards = None,
    out: Annotated[
        Path | None,
        Option(
            help="Folder for the files. Default: from-NAME, where NAME is the name of the log's file.",
            metavar="FOLDER",
        ),
    ] = None,
) -> int:
    """Make a scenario from a log, and a space around it.

    With this command, a recorded incident becomes a regression test and the
    start of a search. The command writes NAME.yaml and the recordings of the
    hands. With --around or --speed, it also writes NAME-around.yaml. You can
    pass these files to the commands run and fuzz, and to pytest. Comments in
    the files state the origin of each part. Without --scenario, the avoider is
    'opposite pose', and default values replace all other values that logs lack.
    The scenario expects every claim to hold. Therefore the command run ends
    with exit code 1 as long as the incident happens again.

    The recorded samples of the hands stay unchanged. The command rejects a log
    with a gap that is longer than LOG.yaml allows. In this case, choose another
    part of the log with --from and --to. The command executes no program and
    overwrites no file.

    Exit code 0: the files are written, and the scenario can run.
    Exit code 2: the scenario cannot be made or cannot run; the reason is
    printed.
    """
    from safety_harness.admission.admit import Checker
    from safety_harness.admission.avoiders import as_seen_from
    from safety_harness.admission.spaces import draw_admissible
    from safety_harness.base.interpreted import without_compiling
    from safety_harness.extensions.field.recorded.scenario import (
        USUAL,
        Around,
        scenario_text,
        space_text,
        usual_cell,
        write_all,
    )
    from safety_harness.extensions.field.recorded.scenario import scenario_from as make
    from safety_harness.scenario.files import display_path
    from safety_harness.scenario.read import read_scenario
    from safety_harness.space.read import read_space

    neighbourhood = Around(shift_m=_length(around), speeds=_speeds(speed))
    folder = out or Path(f"from-{log.stem}")
    if scenario is not None and desired_tcp is not None:
        raise LogError.of_option("--desired-tcp", "only --scenario, which has a desired TCP too", desired_tcp)
    given = None if scenario is None else _cell(scenario)
    cell_log, desired_m = _part(log, start, to), _point(desired_tcp, "--desired-tcp")
    if given is None:
        end = "as --desired-tcp says" if desired_m is not None else "where the log ends"
        named = f"the defaults (desired TCP {end}, avoider {USUAL})"
        given = usual_cell(cell_log, desired_m)
        say(f"note: without --scenario, it uses {named}")
    else:
        named = str(display_path(Path(str(scenario))))
    cell = as_seen_from(folder, given)
    made = make(cell_log, cell, elbow_towards_in_base_m=_point(elbow_towards))
    file, space = folder / f"{cell_log.name}.yaml", folder / f"{cell_log.name}-around.yaml"
    files = {folder / hand.name: hand.data for hand in made.hands}
    files[file] = scenario_text(made, named=named).encode()
    if neighbourhood:
        files[space] = space_text(made, neighbourhood, named=named).encode()
    write_all(files)
    result(*(f"wrote {display_path(path)}" for path in files))
    say(*(f"note: {note}" for note in made.notes))
    document(files=list(files), notes=made.notes)
    try:
        without_compiling(lambda: Checker().check(read_scenario(file)))
        if neighbourhood:
            draws = without_compiling(lambda: draw_admissible(read_space(space), seed=0, count=20))
            say(f"{display_path(space)}: {draws}")
    except InputError as error:
        say("the written files cannot run as they are:")
        explain_each([error])
        return BAD_INPUT
    say("next:", f"  safety-harness run {shlex.quote(str(display_path(file)))}")
    say(*[f"  safety-harness fuzz {shlex.quote(str(display_path(space)))}"] * bool(neighbourhood))
    return AS_EXPECTED


def _part(log: Path, begin: str | None, end: str | None) -> Any:
    from safety_harness.extensions.field.recorded.scenario import read_part

    return read_part(log, begin, end)


def _cell(scenario: str | None) -> Any:
    from safety_harness.scenario.read import read_scenario

    if scenario is None:
        expected = "a scenario of the cell: where the task ends, its object, camera, hand sensor, avoider"
        hint = "logs lack these; for example, --scenario shipped:servoing-alone"
        raise LogError.of_option("--scenario", expected, "none", hint)
    return read_scenario(scenario)


def _length(text: str | None) -> float | None:
    from safety_harness.base.exceptions import Place
    from safety_harness.scenario.units import LENGTH, parse_quantity

    if text is None:
        return None
    length_m = parse_quantity(text, LENGTH, Place(field="--around"))
    if not 0.0 < length_m <= 2.0:
        raise LogError.of_option("--around", "a length above 0, and at most 2 m", text)
    return length_m


def _speeds(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = (float(factor) for factor in text.split(".."))
    except ValueError:
        low = high = -1.0
    if not 0.01 <= low < high <= 10.0:
        raise LogError.of_option("--speed", "two factors from 0.01 to 10, such as 0.8..1.25", text)
    return low, high


def _point(text: str | None, option: str = "--elbow-towards") -> Vector3 | None:
    from safety_harness.scenario.codec import POINT
    from safety_harness.scenario.fields import Field
    from safety_harness.scenario.nodes import Scalar, Sequence

    if text is None:
        return None
    items = Sequence(tuple(Scalar(number.strip(), 1) for number in text.split(",")), 1)
    return POINT.read(Field(items, None, path=option, line=1))


@command(
    commands,
    "compare-worlds",
    interrupted="interrupted: no file was written",
)
def compare_worlds(
    log: Log,
    scenario: OfCell = None,
    start: Begin = None,
    to: End = None,
    elbow_towards: ElbowTowards = None,
    out: Annotated[Path, Option(help="Folder for compare-worlds.json.")] = Path("reports/compare-worlds"),
) -> int:
    """Compare simulated runs with a recorded cell.

    The command runs the controller in every world, with the recorded hands. It
    makes the scenario of these runs in the same way and with the same options
    as "scenario from LOG.yaml"; the option --scenario is required. It compares
    the joints, the TCP and the hand distances with the log, and prints
    intervals for the differences. It also estimates a delay and the offsets of
    the joints. It judges the claims both on the log and on the runs. To include
    the result in a report, use certify PLAN --cell compare-worlds.json. The
    command executes any program to which the scenario refers.

    Exit code 0: no verdict on a run contradicts the verdict on the log.
    Exit code 1: a verdict on a run contradicts the verdict on the log.
    Exit code 2: bad input, or a world is not installed.
    Exit code 130: interrupted.
    """
    from safety_harness.base.whole_file import write_text
    from safety_harness.extensions.field.recorded.compare import FILE, FORMAT, as_json
    from safety_harness.extensions.field.recorded.compare import compare_worlds as compare
    from safety_harness.extensions.field.recorded.scenario import scenario_from as make
    from safety_harness.extensions.field.recorded.words import comparison_lines
    from safety_harness.scenario.files import display_path
    from safety_harness.scenario.typed_json import plain

    cell = _cell(scenario)
    made = make(_part(log, start, to), cell, elbow_towards_in_base_m=_point(elbow_towards))
    comparison = compare(made)
    result(*comparison_lines(comparison))
    say(*(f"note: {note}" for note in comparison.notes))
    write_text(out / FILE, as_json(comparison))
    document(format=FORMAT, **plain(comparison))
    say(f"{display_path(out / FILE)}: for safety-harness certify PLAN --cell")
    return DIFFERS if any(claim.differs for claim in comparison.claims) else AS_EXPECTED
