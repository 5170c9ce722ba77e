"""Define the commands about scenario files, spaces and traces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option, Typer

from safety_harness.cli.console import AS_EXPECTED, verbatim
from safety_harness.cli.options import (
    Files,
    KeepGoing,
    OfAvoider,
    OfController,
    OfFilter,
    OfPredictor,
    OfReference,
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
        Option(
            "--mcap",
            help="Also write each run as an MCAP file, into a folder beside its trace, as the command "
            "export does.",
        ),
    ] = False,
    verbose: Verbose = False,
) -> int:
    """Run scenario files, judge their claims, and write a report.

    For a single run, the command prints all claims, the worst first. For several runs, it prints the
    unexpected verdicts, the undecided claims and a line of totals. With --verbose, it prints each verdict
    with its margin and worst moment, and the number of runs that tested each claim.

    If a file uses a program as its avoider or controller, the command executes the program and reports this
    on standard error. In every run, the command also checks whether the avoider answered. If the avoider of
    --avoider or --against is unsuitable for the workspace of a scenario, the command skips the scenario and
    counts it. If at least eight runs execute no program of yours, the command distributes these runs over
    several processes (--jobs). The traces are the same, bit for bit, as in a single process.

    Exit code 0: every verdict is as its file expects; with --against, no violation is new or deeper, and no
    verdict is lost.
    Exit code 1: a run failed, or the avoider gave two different answers to the same question.
    Exit code 1 too: without --against: a verdict is not as expected, a scenario was skipped, or no run tested
    a claim with an expected verdict.
    Exit code 1 too: with --against: a violation is new or deeper, or a verdict is lost.
    Exit code 2: bad input; with --keep-going, the other inputs still run.
    Exit code 130: interrupted; the report has all finished runs.
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

    The command executes no file: it parses Python files, and it reads the metadata of ONNX files. For each
    file that can run, it prints a line "ok FILE: ..." on standard output. It prints each mistake on standard
    error, with the file, the line, the expected value and the actual value.

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
    check: Annotated[
        bool, Option("--check", help="Change no file; only print the files that would change.")
    ] = False,
    modernise: Annotated[
        bool,
        Option("--modernise", help="Also replace keys and claims of earlier releases by their present form."),
    ] = False,
) -> int:
    """Rewrite scenario files in the standard layout.

    The layout determines the order of the keys, the indentation and the quotes. The comments, the units and
    the meaning of the file stay the same.

    Exit code 0: all files have the standard layout.
    Exit code 1: with --check, a file would change.
    Exit code 2: a file cannot be read; the command still rewrites the other files.
    """
    from safety_harness.cli.fmt import format_files

    return format_files(files, check=check, modernise=modernise)


@command(commands)
def explain(
    key: Annotated[
        list[str] | None,
        Argument(
            help="A key (for example: critical distance), or the file of a plan. Without it, all keys are "
            "listed."
        ),
    ] = None,
) -> int:
    """Explain a key of scenario files, or a plan.

    For a key, the command prints its meaning, unit, bounds, default and an example. If the key occurs in
    several places, the command explains it for each place. A longer name such as "camera.rate" selects one
    place. Without a key, the command lists all keys.

    For a plan, the command prints the number of bounds that the plan shows. For each target, it also prints
    how many tested runs are necessary, and how many violations the planned runs allow. The command does not
    simulate any run.

    Exit code 0: the explanation is printed.
    Exit code 2: an unknown key, or a plan that cannot be used.
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
        list[str] | None,
        Argument(
            help="A claim, or some of its words (for example: hand distance). Without it, all claims are "
            "listed.",
            metavar="WORDS",
        ),
    ] = None,
) -> int:
    """List the claims about a run, or explain some of them.

    The explanation of a claim states the reason, the margin, the parameters, and the condition under which a
    run tests the claim. If you type a whole claim, with your own limit, the command explains the matching
    entry of the catalogue. Without words, the command lists all claims.

    Exit code 0: the claims are listed or explained.
    Exit code 2: no claim of the catalogue has these words.
    """
    from safety_harness.cli.explain import explain_claims

    return explain_claims(phrases or [])


@command(commands, json=False)
def schema(
    plans: Annotated[
        bool, Option("--plan", help="Print the schema of plans instead of the schema of scenario files.")
    ] = False,
) -> int:
    """Print the JSON Schema (draft 2020-12) of scenario files.

    An editor with this schema can check your files while you type. The repository contains the schemas of
    scenarios and plans in docs/schema.

    Exit code 0: the schema is printed.
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
    trace: Annotated[Path, Argument(help="The .trace file of an earlier run.", metavar="TRACE")],
    avoider: OfAvoider = None,
    controller: OfController = None,
    safety_filter: OfFilter = None,
    predictor: OfPredictor = None,
    world: OfWorldAgain = None,
) -> int:
    """Repeat a recorded run, and compare it bit by bit.

    The command prints "identical", or the first step that differs. If the run used a program of yours, pass
    the program again by --avoider, --controller, --safety-filter, --predictor or --world, because the replay
    executes it. The command rejects a program whose hash differs from the hash in the trace.

    Exit code 0: the runs are identical, or differ only in their last bits because of another machine or
    version.
    Exit code 1: the runs differ, or the avoider gave two different answers to the same question.
    Exit code 2: the trace cannot be read, or a program is missing or has changed.
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
            help="A claim to judge instead of the claims in the files. It is a sentence of the catalogue, "
            "or a formula such as 'always hand distance > 30 mm', and it is expected to hold. May be "
            "repeated.",
            metavar="SENTENCE",
        ),
    ] = None,
    keep_going: KeepGoing = False,
    out: Annotated[
        Path | None,
        Option(
            help="Folder for report.html, report.json and the traces of logs. Without it, no file is written."
        ),
    ] = None,
    verbose: Verbose = False,
) -> int:
    """Judge stored traces, or logs of a real cell, without a simulation.

    The command judges the claims in the files, or the claims of --claim instead.

    Exit code 0: every verdict is as expected.
    Exit code 1: a verdict is not as expected, or no claim of a run applies to its controller.
    Exit code 2: bad input; with --keep-going, the other inputs are still judged.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.replay import judge_again

    return judge_again(traces, claim or (), keep_going=keep_going, out=out, verbose=verbose)


@command(
    commands,
    interrupted="interrupted: the files that were written are kept",
    then="safety-harness run {out}",
)
def sample(
    space: OfSpace,
    out: Annotated[Path, Option(help="Folder for the scenario files.")] = Path("reports/sample"),
    count: Annotated[int, Option(help="Number of admissible scenarios to draw, from 1 to 100,000.")] = 10,
    seed: Seed = 0,
) -> int:
    """Draw independent scenarios from a space, and write each to a file.

    The command run accepts the files. If a draw is inadmissible, for example because the arm cannot reach its
    start, the command draws again, and it prints the number of such draws.

    Exit code 0: all scenarios are drawn.
    Exit code 2: bad input, or a space with almost no admissible draw.
    Exit code 130: interrupted.
    """
    from safety_harness.cli.sample import sample as sample_space

    return sample_space(space, out=out, count=count, seed=seed)
