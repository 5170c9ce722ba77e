"""Define the commands about scenario files, spaces and traces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, verbatim
from safety_harness.cli.options import (
    AttributionOut,
    Confirm,
    Files,
    KeepGoing,
    OfAvoider,
    OfController,
    OfFilter,
    OfPredictor,
    OfReference,
    OfReplays,
    OfSpace,
    OfWorld,
    OfWorldAgain,
    Out,
    Seed,
    Verbose,
    Workers,
    command,
)

commands = Typer()


@command(commands)
def run(
    files: Files,
    out: Out = Path("reports/run"),
    avoider: OfAvoider = None,
    against: OfReference = None,
    world: OfWorld = None,
    keep_going: KeepGoing = False,
    controller: OfController = None,
    jobs: Workers = None,
    mcap: Annotated[
        bool,
        Option("--mcap", help="Write each run as MCAP too, into a folder beside its trace, as export does."),
    ] = False,
    verbose: Verbose = False,
) -> int:
    """Run scenario files in a world, judge claims, write a report.

    A single run prints its claims, worst first. Many runs print unexpected
    verdicts, undecided claims and a line of totals; --verbose prints each verdict
    with margin and worst moment, and how many runs tested each claim.

    The command executes a program that a file uses as avoider or controller, and
    reports it on standard error. It judges in every run whether the avoider
    answered. It skips and counts a scenario with a workspace that --avoider or
    --against cannot serve. Eight or more shipped runs use several processes
    (--jobs), with the same traces bit for bit.

    Exit code 0: every verdict as its file expects; with --against, no new or
    deeper violation and no lost verdict.
    Exit code 1: otherwise, or a failed run; without --against also a skipped
    scenario, or an expected verdict on a claim that no run tested.
    Exit code 2: bad input; with --keep-going the command runs the rest.
    Exit code 130: interrupted, with all finished runs.
    """
    from safety_harness.cell.simulation.worlds import world_named
    from safety_harness.cli.run import run as run_files

    return run_files(
        files,
        out,
        avoider,
        against,
        controller=controller,
        world=None if world is None else world_named(world, "--world"),
        keep_going=keep_going,
        jobs=jobs,
        mcap=mcap,
        verbose=verbose,
    )


@command(commands)
def validate(files: Files, avoider: OfAvoider = None, controller: OfController = None) -> int:
    """Check scenario files, spaces and plans without running them.

    The command executes no file: it parses a Python file, and reads the metadata of an ONNX file.
    A line "ok FILE: ..." goes to standard output for each runnable file. Mistakes go to standard error with
    file, line, expected and got.

    Exit code 0: all files can run.
    Exit code 2: a file cannot run.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of
    from safety_harness.cli.validate import validate as validate_files

    return validate_files(files, one_of(avoider, controller))


@command(commands, then="safety-harness validate {files}")
def fmt(
    files: Files,
    check: Annotated[bool, Option("--check", help="Change nothing; only say what would change.")] = False,
    modernise: Annotated[
        bool, Option("--modernise", help="Rewrite keys and claims of earlier releases in today's words.")
    ] = False,
) -> int:
    """Lay scenario files out in the standard layout.

    The layout sets the order of keys, indentation and quotes. Comments and your units stay, and so does the
    meaning of the file.

    Exit code 0: the files have the layout.
    Exit code 1: with --check, a file would change.
    Exit code 2: a file cannot be read; the command lays out the rest.
    """
    from safety_harness.cli.fmt import format_files

    return format_files(files, check=check, modernise=modernise)


@command(commands)
def explain(
    key: Annotated[
        list[str] | None, Argument(help="A key, such as: critical distance; or a plan's file.")
    ] = None,
) -> int:
    """Explain a key of scenario files, or a plan.

    For a key: its meaning, unit, bounds, default and an example. For a plan: the number of bounds that it
    shows, and for each target the tested runs that it takes and the violations that the planned runs allow.
    There are no runs.
    A key in several places has an explanation for each; "camera.rate" selects one place.
    Without a key, the command lists all keys.

    Exit code 0: explained.
    Exit code 2: an unknown key.
    """
    from safety_harness.base.shipped.contents import located
    from safety_harness.cli.explain import explain_key
    from safety_harness.scenario.kinds import added_input

    added = added_input(located(Path(key[0]))) if key and len(key) == 1 else None
    if key and added is not None and added.explain is not None:
        return added.explain(Path(key[0]))
    return explain_key(key or [])


@command(commands)
def claims(
    phrases: Annotated[
        list[str] | None, Argument(help="A claim, or words of it, such as: hand distance.", metavar="WORDS")
    ] = None,
) -> int:
    """List the claims about a run, or explain some of them.

    The explanation has the reason, margin, parameters, and the condition under which a run tests the claim.
    A whole claim is explained by the entry that understands it. Without words, the command lists all claims.

    Exit code 0: listed or explained.
    Exit code 2: the catalogue has no claim with these words.
    """
    from safety_harness.cli.explain import explain_claims

    return explain_claims(phrases or [])


@command(commands, json=False)
def schema(
    plans: Annotated[bool, Option("--plan", help="Of plans, in place of scenario files.")] = False,
) -> int:
    """Print the JSON Schema (draft 2020-12) of scenario files.

    Editors check your files by it while you type. The repository has both schemas in docs/schema.

    Exit code 0: printed.
    """
    import json

    from safety_harness.base.exceptions import ScenarioError
    from safety_harness.scenario.kinds import titled
    from safety_harness.scenario.schema import scenario_schema

    document = scenario_schema()
    if plans:
        if (of_plans := titled("plan").schema) is None:
            raise ScenarioError.of_option("--plan", "plans with a schema", "plans without one")
        document = of_plans()
    verbatim(json.dumps(document, indent=1, ensure_ascii=False))
    return AS_EXPECTED


@command(commands, then="safety-harness judge {trace}")
def replay(
    trace: Annotated[Path, Argument(help="A .trace file of an earlier run.", metavar="TRACE")],
    avoider: OfAvoider = None,
    controller: OfController = None,
    safety_filter: OfFilter = None,
    predictor: OfPredictor = None,
    world: OfWorldAgain = None,
) -> int:
    """Repeat a recorded run bit by bit.

    The answer is "identical", or the first step that differs.
    If a program of yours made the trace, name that program by --avoider, --controller, --safety-filter,
    --predictor or --world, because the replay executes it. A part with another hash is refused.

    Exit code 0: identical.
    Exit code 1: it differs.
    Exit code 2: the trace cannot be read.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of
    from safety_harness.cli.replay import replay as replay_trace

    beside = {"safety_filter": safety_filter, "predictor": predictor}
    return replay_trace(trace, one_of(avoider, controller), world, **beside)


@command(commands)
def judge(
    traces: Annotated[
        list[Path],
        Argument(help="Traces of earlier runs, or descriptions of logs (LOG.yaml).", metavar="TRACE..."),
    ],
    claim: Annotated[
        list[str] | None,
        Option(
            help="In place of the traces' own: a sentence of the catalogue or a formula, such as 'always "
            "hand distance > 30 mm', expected to hold. May be repeated.",
            metavar="SENTENCE",
        ),
    ] = None,
    keep_going: KeepGoing = False,
    out: Annotated[
        Path | None, Option(help="Folder for report.html, report.json and the traces of logs.")
    ] = None,
    verbose: Verbose = False,
) -> int:
    """Judge stored traces, or logs of a real cell, by their claims, or by others, without simulating.

    Exit codes as for run.
    """
    from safety_harness.cli.replay import judge_again

    return judge_again(traces, claim or (), keep_going=keep_going, out=out, verbose=verbose)


@command(commands, interrupted="interrupted: nothing was written")
def view(
    trace: Annotated[
        Path, Argument(help="A trace of an earlier run, or the description of a log.", metavar="TRACE")
    ],
    second: Annotated[
        Path | None, Argument(help="Another one, to be shown beside it in step.", metavar="TRACE")
    ] = None,
    out: Annotated[Path | None, Option(help="The page. Default: reports/view/NAME.html.")] = None,
    opens: Annotated[bool, Option("--open/--no-open", help="Open the page in the browser.")] = True,
) -> int:
    """Show a stored run in 3-D, or two side by side in step.

    The command writes one page and opens it. Useful pairs are an avoider and its reference, a run with a
    shield and a run without, or a simulated and a recorded run.
    The command only judges claims again, without simulation and without programs. For a log, the page omits
    the parts that were not measured, and names them.

    Exit code 0: the page is written.
    Exit code 2: the trace or log cannot be read.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.view import view as view_runs

    return view_runs([trace] if second is None else [trace, second], out, opens=opens)


@command(commands, interrupted="interrupted: this picture and those after it were not drawn")
def show(
    files: Annotated[list[Path], Argument(help="Scenario files or spaces.", metavar="FILE...")],
    out: Annotated[Path, Option(help="Folder for pictures (SVG), or the picture of one file.")] = Path(
        "reports/show"
    ),
    draws: Annotated[int, Option(help="Draws of a space in its picture.", min=1)] = 200,
    seed: Seed = 0,
) -> int:
    """Draw the scenarios of a file without running them.

    The picture has hands, TCP start, regions and the camera's view.

    Exit code 0: drawn.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.show import show as show_files

    return show_files(files, out=out, draws=draws, seed=seed)


@command(
    commands,
    interrupted="interrupted: the files that were written are kept",
    then="safety-harness run {out}",
)
def sample(
    space: OfSpace,
    out: Annotated[Path, Option(help="Folder for the scenario files.")] = Path("reports/sample"),
    count: Annotated[int, Option(help="How many that can be tried.")] = 10,
    seed: Seed = 0,
) -> int:
    """Draw independent scenarios from a space, each as a file.

    The command run takes these files. An inadmissible draw (a start out of reach, ...) is counted, reported
    and drawn again.

    Exit code 0: drawn.
    Exit code 2: bad input, or a space with almost no admissible draw.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.show import sample as sample_space

    return sample_space(space, out=out, count=count, seed=seed)


@command(commands, interrupted="interrupted before anything was attributed")
def attribute(
    runs: Annotated[
        list[Path],
        Argument(help="Scenario files, such as fuzz writes, traces, or folders of them.", metavar="RUN..."),
    ],
    avoider: OfAvoider = None,
    controller: OfController = None,
    safety_filter: OfFilter = None,
    predictor: OfPredictor = None,
    out: AttributionOut = None,
    confirm: Confirm = False,
    world: OfReplays = None,
) -> int:
    """Find the ingredient that caused each violation.

    The command repeats the run with one ingredient changed, then two. It changes the avoider, its deadline,
    perception, drives and brakes, the servoing camera, prediction, the gate, the fallback and the critical
    distance. Last it halves the speed of the hand. A violation that no arm could have avoided is unavoidable.
    For a trace the command attributes all its violations; for a scenario file, all that the unchanged replay
    violates. Replays run in the kinematic world, or in --world. Name the program that made a trace again.
    For a controller other than the visual servo, the command omits the ingredients that it does not have.

    Exit code 0: every violation has an answer.
    Exit code 1: the unchanged replay fails, or does not show a violation.
    Exit code 2: bad input, without a run.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.avoiders import one_of
    from safety_harness.cli.attribute import attribute_runs

    beside = {"safety_filter": safety_filter, "predictor": predictor}
    return attribute_runs(runs, one_of(avoider, controller), out, confirm, world, **beside)
