"""Define ``safety-harness selftest``, which seeds faults into a sound system and shows which are caught."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option, Typer

from safety_harness.base.exceptions import SettingsError
from safety_harness.cli.console import AS_EXPECTED, DIFFERS, INTERRUPTED, columns_of, document, result, say
from safety_harness.cli.options import OfAvoider, OfController, command

commands = Typer()


@command(commands)
def selftest(
    profile: Annotated[
        str,
        Option(
            help="The size of the test: quick takes some minutes, and nightly uses every scenario and many"
            " draws."
        ),
    ] = "quick",
    avoider: OfAvoider = None,
    controller: OfController = None,
    safety_filter: Annotated[
        str | None,
        Option(help="A safety filter for every scenario: FILE.py:NAME or a program.", metavar="FILTER"),
    ] = None,
    predictor: Annotated[
        str | None,
        Option(help="A predictor for every scenario: FILE.py:NAME or a program.", metavar="PREDICTOR"),
    ] = None,
    scenarios: Annotated[
        Path,
        Option(
            help="Folder with the scenario files in which to seed the faults, and with spaces in its "
            "subfolder spaces/."
        ),
    ] = Path("shipped:scenarios"),
    world: Annotated[
        str, Option(help="The world of the runs: kinematic, MuJoCo, or your simulator (exec:COMMAND).")
    ] = "kinematic",
    fault: Annotated[str | None, Option(help="Seed only faults whose name contains these words.")] = None,
    out: Annotated[Path, Option(help="Folder for selftest.html and selftest.json.")] = Path(
        "reports/selftest"
    ),
    jobs: Annotated[int, Option(help="Number of processes, each on one core.")] = 2,
) -> int:
    """Seed faults into a working system, and show which claims catch them.

    A claim catches a fault if, on the same scenario, the claim holds without
    the fault and is violated with the fault. For each fault, the table shows a
    claim that catches it, the number of episodes, and the smallest magnitude
    that was caught. The command also seeds harmless changes, which must raise
    no alarm.

    With --avoider or --controller, the command seeds the faults into your
    program. If your system has no avoider, no gate or no servo, the faults of
    this part do not apply, and the table says so. With --world exec:COMMAND,
    your simulator moves the arm in all runs. With --safety-filter, faults of a
    filter replace the faults of our shield. With --predictor, the faults of our
    Kalman filter do not apply.

    The command saves the results so far, whichever exit code it has.

    Exit code 0: claims catch all faults, except for stated limits.
    Exit code 1: a fault without a stated limit survives, or a harmless change
    raises a false alarm.
    Exit code 1 too: no fault applies to the system.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    import shlex
    import sys

    from safety_harness.admission.avoiders import one_of, option_of
    from safety_harness.base.compiling import Pace
    from safety_harness.base.output import where
    from safety_harness.base.whole_file import writing
    from safety_harness.cell.simulation.worlds import world_named
    from safety_harness.claims.properties.tally import table
    from safety_harness.cli.progress import paced_lines
    from safety_harness.extensions.assurance.certification.tools import FaultState
    from safety_harness.extensions.selftest.outcome import (
        HARMLESS_HEAD,
        HEAD,
        FaultOutcome,
        bad,
        harmless_row,
        in_table,
        row,
        summary,
        tally_of,
    )
    from safety_harness.extensions.selftest.session import DATA, PAGE, SelfTestSession, numbers_of
    from safety_harness.extensions.selftest.suite import SelfTestPlan, profile_named
    from safety_harness.scenario.files import display_path

    again = ["safety-harness", "selftest", "--profile", profile, "--scenarios", str(scenarios)]
    tested = one_of(avoider, controller)
    again += [option_of(tested), tested] if tested is not None else []
    again += ["--safety-filter", safety_filter] if safety_filter is not None else []
    again += ["--predictor", predictor] if predictor is not None else []
    again += ["--world", world] if world != "kinematic" else []
    again += ["--fault", fault] if fault is not None else []
    again += ["--out", str(display_path(out)), "--jobs", str(jobs)]
    try:
        chosen = world_named(world, "--world")
        plan = SelfTestPlan(profile_named(profile), scenarios, tested, safety_filter, predictor, chosen)
        if jobs < 1:
            raise SettingsError.of_option("--jobs", "a number of at least 1", str(jobs))
        numbers = numbers_of(fault)
        say("reading and trying the sound system")
        session = SelfTestSession(plan, numbers, out, shlex.join(again))
    except KeyboardInterrupt:
        say("interrupted before the first fault")
        return INTERRUPTED
    say(*session.remarks, f"{len(numbers)} faults and harmless changes to try")
    pace = Pace()

    def show_outcome(outcome: FaultOutcome) -> None:
        text, alarm, smallest = outcome.state.value, outcome.alarm, outcome.smallest
        if outcome.state is FaultState.CAUGHT and alarm and smallest:
            text = f"caught down to {smallest.words}, by {alarm.claim} in {alarm.scenario}"
        done, total = len(session.done), len(numbers)
        say_where(f"[{done}/{total}] {outcome.part}: {outcome.fault}: {text}{where(done, total, pace)}")

    with writing(out):
        with paced_lines() as say_where:
            session.run(jobs, show_outcome)
        faults, harmless = in_table(session.tried)
        tables = (HEAD, list(map(row, faults))), (HARMLESS_HEAD, list(map(harmless_row, harmless)))
        for head, rows in tables:
            result(*table(head, rows, columns_of(sys.stdout)), "")
        result(summary(tally_of(session.tried)))
        document(**session.document)
        session.write()
        session.write_page()
    say(f"page: {out / PAGE} (for programs: {DATA})")
    tried = f"{len(session.tried)} of {len(numbers)} done"
    if session.interrupted:
        say(f"interrupted: {tried}")
        return INTERRUPTED
    if session.broken:
        say(f"error: {session.broken}; {tried}")
        return DIFFERS
    if not any(outcome.applies for outcome in session.tried):
        say("error: these faults do not apply to such an avoider")
        return DIFFERS
    return DIFFERS if bad(session.tried) else AS_EXPECTED
