"""The commands of ``safety-harness`` and their options; each imports what it needs when it is called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer

from safety_harness.exceptions import SafetyHarnessError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Verify a hand-avoidance controller of a robot arm: run scenarios, judge them, report; "
    "make the data of a learned avoider, train, evaluate and export it.",
)

Files = Annotated[
    list[Path], typer.Argument(help="Scenario files, suites, or folders of *.yaml.", metavar="FILE...")
]
Out = Annotated[Path, typer.Option(help="Folder for report.html and traces/.")]
OfAvoider = Annotated[
    str | None,
    typer.Option(
        help="In place of what the files name: mc-dropout, mc-dropout-full, deterministic, ensemble, "
        "optimum, 'opposite pose', 'nearest candidate', FILE.py:NAME, FILE.safetensors or FILE.onnx.",
        metavar="AVOIDER",
    ),
]
TraceFile = Annotated[Path, typer.Argument(help="A .trace file of an earlier run.", metavar="TRACE")]
TraceFiles = Annotated[list[Path], typer.Argument(help="Trace files of earlier runs.", metavar="TRACE...")]
Seed = Annotated[int, typer.Option(help="Root of every random number.", min=0)]
ModelFiles = Annotated[
    list[str],
    typer.Argument(help="Model files (*.safetensors), or names of shipped models.", metavar="MODEL..."),
]


@app.command()
def run(files: Files, out: Out = Path("reports/run"), avoider: OfAvoider = None) -> None:
    """Run scenario files in PyBullet, judge their claims and write a report.

    One line a claim goes to standard output: verdict, margin, time of the worst moment.
    At the end a table says how often each claim was put to the test.
    Exit code 0: every verdict as its file expects; 1: any differs, a run failed, or a claim that was
    expected to tell something was never put to the test; 2: bad input, nothing was run; 130: interrupted,
    what was finished is kept.
    """
    from safety_harness.cli.run import run as run_files

    _end(run_files(files, out, avoider))


@app.command()
def validate(files: Files, avoider: OfAvoider = None) -> None:
    """Read and check scenario files without running them, and tell every mistake of every file.

    A line "ok FILE: ..." goes to standard output for each file that can be run; mistakes go to standard
    error with file, line, what was expected and what came.
    Exit code 0: all of them can be run; 2: some cannot; 130: interrupted.
    """
    from safety_harness.cli.validate import validate as validate_files

    _end(validate_files(files, avoider))


@app.command()
def fmt(
    files: Files,
    check: Annotated[
        bool, typer.Option("--check", help="Change nothing; only say what would change.")
    ] = False,
) -> None:
    """Lay scenario files out as the shipped ones are: order of keys, indentation, quotes.

    Comments stay, and so do the units that you wrote; the file means what it meant before.
    Exit code 0; 1: with --check, a file would change; 2: a file cannot be read, others are laid out.
    """
    from safety_harness.cli.fmt import format_files

    _end(format_files(files, check=check))


@app.command()
def explain(
    key: Annotated[list[str] | None, typer.Argument(help="A key, such as: critical distance.")] = None,
) -> None:
    """Say what a key of scenario files means: its unit, bounds, default and an example.

    A key that stands in several places is explained for each; "camera.rate" means one of them.
    Without a key, all are listed.
    Exit code 0; 2: there is no such key.
    """
    from safety_harness.cli.explain import explain_key

    _end(explain_key(key or []))


@app.command()
def claims(
    words: Annotated[
        list[str] | None, typer.Argument(help="A claim, or words of it, such as: hand distance.")
    ] = None,
) -> None:
    """Say what can be claimed of a run: why, margin, parameters, when it is put to the test.

    A whole claim is explained by the one that understands it. Without words, all are listed.
    Exit code 0; 2: nothing in the catalogue has these words.
    """
    from safety_harness.cli.claims import explain_claims

    _end(explain_claims(words or []))


@app.command()
def new(
    file: Annotated[Path, typer.Argument(help="The file to write.")] = Path("scenario.yaml"),
) -> None:
    """Write a scenario file with comments to start from; it runs as it is.

    Exit code 0; 2: there is such a file already, or it cannot be written.
    """
    from safety_harness.cli.new import new as new_file

    _end(new_file(file))


@app.command()
def schema() -> None:
    """Print the JSON Schema (draft 2020-12) of scenario files, for editors that check while you type.

    It is also docs/schema/scenario.schema.json. Exit code 0.
    """
    from safety_harness.cli.schema import print_schema

    _end(print_schema())


@app.command()
def replay(trace: TraceFile, avoider: OfAvoider = None) -> None:
    """Repeat a recorded run bit by bit: "identical", or the first step that differs.

    A trace that was made with a Python file of yours needs that file named by --avoider, as repeating
    the run executes it.
    Exit code 0: identical; 1: it differs; 2: not a trace that can be read; 130: interrupted.
    """
    from safety_harness.cli.replay import replay as replay_trace

    _end(replay_trace(trace, avoider))


@app.command()
def judge(
    traces: TraceFiles,
    claim: Annotated[
        list[str] | None,
        typer.Option(
            help="In place of the traces' own: a sentence of the catalogue or a formula, such as 'always "
            "hand distance > 30 mm', expected to hold. May be repeated.",
            metavar="SENTENCE",
        ),
    ] = None,
) -> None:
    """Judge stored traces again by their claims, or by others, without simulating.

    Exit codes as for run.
    """
    from safety_harness.cli.replay import judge_again

    _end(judge_again(traces, claim or ()))


@app.command()
def show(
    files: Annotated[list[Path], typer.Argument(help="Scenario files or spaces.", metavar="FILE...")],
    out: Annotated[Path, typer.Option(help="Folder for pictures, or the picture of one file.")] = Path(
        "reports/show"
    ),
    draws: Annotated[int, typer.Option(help="Draws of a space in its picture.", min=1)] = 200,
    seed: Seed = 0,
) -> None:
    """Draw what a file would try: hands, TCP start, regions, the camera's view; nothing is run.

    Exit code 0; 2: bad input; 130: interrupted.
    """
    from safety_harness.cli.show import show as show_files

    _end(show_files(files, out=out, draws=draws, seed=seed))


@app.command()
def sample(
    space: Annotated[Path, typer.Argument(help="A scenario space.", metavar="SPACE")],
    out: Annotated[Path, typer.Option(help="Folder for the scenario files.")] = Path("reports/sample"),
    count: Annotated[int, typer.Option(help="How many that can be tried.")] = 10,
    seed: Seed = 0,
) -> None:
    """Draw scenarios from a space, independently, each as a file that run takes.

    Draws that cannot be tried (a start out of reach, ...) are counted, drawn again, and said.
    Exit code 0; 2: bad input, or a space of which next to nothing can be tried; 130: interrupted.
    """
    from safety_harness.cli.show import sample as sample_space

    _end(sample_space(space, out=out, count=count, seed=seed))


@app.command()
def fuzz(
    space: Annotated[Path, typer.Argument(help="A scenario space.", metavar="SPACE")],
    avoider: OfAvoider = None,
    budget: Annotated[int, typer.Option(help="Runs to search with; shrinking has its own.")] = 1000,
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Folder for fuzz.html, counterexamples, findings.json.")] = Path(
        "reports/fuzz"
    ),
    searcher: Annotated[
        str,
        typer.Option(
            help="default, uniform, quasi-random, cma-es, hypothesis, or diverse, which fills holes."
        ),
    ] = "default",
    claim: Annotated[
        list[str] | None,
        typer.Option(help="Search for violations of this, in place of the space's claims; may be repeated."),
    ] = None,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Sample the space uniformly as well, with the same budget.")
    ] = False,
) -> None:
    """Search a space for violations, and write each distinct one as a scenario file that run takes.

    Counterexamples are shrunk, confirmed in PyBullet and explained, with a page, fuzz.html, about them and
    a map of what was covered, coverage.svg; Ctrl-C keeps what was found so far.
    Exit code 0: nothing found, which is no evidence of safety; 1: violations, or an avoider that gave no
    answer; 2: bad input, or a place that cannot be written; 130: interrupted.
    """
    from safety_harness.cli.fuzz import fuzz as fuzz_space

    _end(
        fuzz_space(
            space,
            out=out,
            avoider=avoider,
            budget=budget,
            seed=seed,
            searcher=searcher,
            claims=claim or (),
            baseline=baseline,
        )
    )


@app.command()
def dataset(
    out: Annotated[Path, typer.Argument(help="Folder for arrays.npz and manifest.json.", metavar="FOLDER")],
    space: Annotated[
        str, typer.Option(help="'seen', 'unseen hand', 'unseen tcp' or 'unseen both'.")
    ] = "seen",
    tcps: Annotated[int, typer.Option(help="TCP positions.")] = 10_000,
    candidates: Annotated[int, typer.Option(help="Repulsive candidates of each TCP.")] = 100,
    hands: Annotated[int, typer.Option(help="Hand positions, joined with every TCP.")] = 500,
    seed: Seed = 0,
) -> None:
    """Make the data that an avoider learns from: TCP x hand, with eq. 13's ground truth.

    The defaults are the paper's 5,000,000 samples, in a few seconds.
    Exit code 0; 2: bad input; 130: interrupted, nothing was written.
    """
    from safety_harness.cli.dataset import dataset as make_dataset

    _end(make_dataset(out, space=space, tcps=tcps, candidates=candidates, hands=hands, seed=seed))


@app.command()
def train(
    recipe: Annotated[
        str,
        typer.Argument(
            help="mc-dropout, mc-dropout-full, deterministic, ensemble or optimum; "
            "also with paper- or trial- before it."
        ),
    ],
    data: Annotated[
        Path | None, typer.Option(help="Folder of a data set; without it the paper's is made on the spot.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for model.safetensors and the checkpoint.")] = Path(
        "models/new"
    ),
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    device: Annotated[str, typer.Option(help="Where PyTorch computes: cpu, cuda, ...")] = "cpu",
) -> None:
    """Train and calibrate a network; "trial-mc-dropout" takes under a minute.

    Ctrl-C costs the epoch that was under way; --resume goes on from there, to the same bits.
    Needs PyTorch, the extra "learning" of this package.
    Exit code 0; 2: bad input; 130: interrupted.
    """
    from safety_harness.cli.train import train as train_recipe

    _end(train_recipe(recipe, data=data, seed=seed, out=out, resume=resume, device=device))


@app.command()
def evaluate(
    models: ModelFiles,
    samples: Annotated[int, typer.Option(help="Fresh pairs of TCP and hand in each set.")] = 10_000,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Also every figure, as JSON, to this file.")] = None,
) -> None:
    """Compare models on seen and unseen space: errors, intervals, coverage, doubt as a detector.

    Every model answers the same questions; no sample was used in training or calibration.
    Exit code 0; 2: bad input; 130: interrupted.
    """
    from safety_harness.cli.evaluate import evaluate as evaluate_models

    _end(evaluate_models(models, samples=samples, seed=seed, out=out))


@app.command()
def export(
    model: Annotated[
        str, typer.Argument(help="A model file (*.safetensors), or a shipped model's name.", metavar="MODEL")
    ],
    out: Annotated[Path, typer.Option(help="The file to write.")],
    format: Annotated[str, typer.Option(help="onnx or torchscript.")] = "onnx",
    seed: Seed = 0,
) -> None:
    """Write a model as ONNX or TorchScript, and try the file against the original on random questions.

    Needs PyTorch, the extra "learning" of this package.
    Exit code 0; 2: bad input, or the file answers otherwise (then it is not kept); 130: interrupted.
    """
    from safety_harness.cli.export import export as export_model

    _end(export_model(model, out=out, format=format, seed=seed))


@app.command()
def reproduce(
    what: Annotated[
        list[str],
        typer.Argument(
            help="all, table1 ... table5, figure5 ... figure8, timing, outlook, safety; or sensitivity, "
            "which is not part of all.",
            metavar="WHAT...",
        ),
    ],
    scale: Annotated[
        str, typer.Option(help="quick: minutes, to see it run; default: an hour or so; paper: days.")
    ] = "default",
    out: Annotated[
        Path, typer.Option(help="Folder for reproduction.html, reproduction.json and work/.")
    ] = Path("reports/reproduction"),
    seed: Seed = 0,
    jobs: Annotated[int, typer.Option(help="Processes at once, each on one core.")] = 2,
) -> None:
    """Measure the paper's tables and figures again: its numbers beside ours, and a verdict on each.

    table1: passes of the network; 2: places of dropout; 3: unseen space; 4: out of reach; 5: convergence.
    figure5: candidates; 6: intervals; 7: a whole trial; 8: two poses. timing: network against images.
    outlook: the paper's own, tried. safety: does the arm keep clear? sensitivity: what is left open.

    Several networks of each kind are trained, evaluated and tried in PyBullet. A line a verdict goes to
    standard output: reproduced, direction only, or not reproduced, and why; the page has all numbers.
    Ctrl-C keeps every finished step; the same command goes on from there.
    Needs PyTorch, the extra "learning" of this package.

    Examples: "reproduce all --scale quick" to see it run; "reproduce table4 table5 --jobs 4".
    Exit code 0; 1: a step failed, the page says which; 2: bad input; 130: interrupted.
    """
    from safety_harness.cli.reproduce import reproduce as reproduce_parts

    _end(reproduce_parts(what, scale=scale, out=out, seed=seed, jobs=jobs))


@app.command()
def certify(
    plan: Annotated[Path, typer.Argument(help="A plan: claims, strata, runs, confidence.", metavar="PLAN")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the report; without it reports/NAME of the plan.")
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Also print the page to evidence.pdf, with an installed Chromium.")
    ] = False,
    workers: Annotated[int | None, typer.Option(help="Processes; without it one a core.", min=1)] = None,
    selftest: Annotated[
        Path | None, typer.Option(help="selftest.json of safety-harness selftest, to be part of the report.")
    ] = None,
    oracles: Annotated[
        Path | None, typer.Option(help="Table of independent oracles (docs/oracles.json), likewise.")
    ] = None,
) -> None:
    """Run a declared plan and write its evidence: one page, JSON, JUnit XML, and all to re-run it.

    Bounds are made of the plan's own independent runs; what its search finds is shown and estimates nothing.
    A line a claim goes to standard output. Ctrl-C keeps every finished run; the same command goes on.
    It is no certificate, and says so.
    Exit code 0: every claim is shown; 1: any is not; 2: bad input, or a target that the plan's runs cannot
    meet; 130: interrupted.
    """
    from safety_harness.cli.certify import certify as certify_plan

    _end(certify_plan(plan, out=out, pdf=pdf, workers=workers, selftest=selftest, oracles=oracles))


@app.command()
def verify(
    report: Annotated[Path, typer.Argument(help="The folder of a report of certify.", metavar="FOLDER")],
    runs: Annotated[int, typer.Option(help="Runs to make again, drawn at random.", min=0)] = 20,
    seed: Annotated[
        int | None, typer.Option(help="Which runs: without it others each time, and it says which.", min=0)
    ] = None,
    execute_avoider: Annotated[
        bool,
        typer.Option("--execute-avoider", help="Allow the Python file in the report to be executed."),
    ] = False,
) -> None:
    """Check a report: hashes, its numbers from the ledger, stored traces judged again, some runs made again.

    What has changed since (source, versions, networks, platform) is named.
    Exit code 0: the report stands; 1: it does not, and why; 2: no report; 130: interrupted.
    """
    from safety_harness.cli.certify import verify as verify_folder

    _end(verify_folder(report, runs=runs, seed=seed, execute_avoider=execute_avoider))


_LedgerFile = Annotated[Path, typer.Argument(help="The ledger of a campaign.", metavar="LEDGER")]
_Workers = Annotated[int | None, typer.Option(help="Processes; without it, one for each core.", min=1)]
_Cluster = Annotated[
    str | None,
    typer.Option(
        help="Run on a Dask cluster: tcp://SCHEDULER:PORT or a scheduler file.", metavar="ADDRESS|FILE"
    ),
]
_Part = Annotated[str, typer.Option(help="Only the K-th of N parts, for 'merge'.", metavar="K/N")]
_campaign = typer.Typer(
    no_args_is_help=True,
    help="Run a declared plan, hundreds or millions of episodes, into a ledger that loses nothing.",
)
app.add_typer(_campaign, name="campaign")


@_campaign.command("run")
def campaign_run(
    plan: Annotated[Path, typer.Argument(help="A plan file.", metavar="PLAN")],
    ledger: Annotated[
        Path | None, typer.Option(help="The ledger; without it reports/PLAN/ledger.sqlite.")
    ] = None,
    workers: _Workers = None,
    cluster: _Cluster = None,
    part: _Part = "1/1",
) -> None:
    """Run a plan's episodes in many processes, or what is left of them if the ledger is there already.

    Ctrl-C keeps every finished episode, and so does whatever kills the program or the machine.
    Exit code 0: complete, or this part is; 1: complete, but episodes failed to run, or no worker is left;
    2: bad input, another plan's ledger, or a disk that takes no more; 130: interrupted.
    """
    from safety_harness.cli.campaign import run as run_plan

    _end(run_plan(plan, ledger=ledger, workers=workers, cluster=cluster, part=part))


@_campaign.command("resume")
def campaign_resume(
    ledger: _LedgerFile, workers: _Workers = None, cluster: _Cluster = None, part: _Part = "1/1"
) -> None:
    """Go on where a campaign was left, with the results that it would have had undisturbed.

    A plan, file or version that has changed since is named, and nothing is run.
    Exit codes as for run.
    """
    from safety_harness.cli.campaign import resume as resume_plan

    _end(resume_plan(ledger, workers=workers, cluster=cluster, part=part))


@_campaign.command("status")
def campaign_status(ledger: _LedgerFile) -> None:
    """Say how a campaign stands, also while it runs; once it is complete, with its bounds.

    Exit code 0; 2: no ledger that can be read.
    """
    from safety_harness.cli.campaign import status as tell_status

    _end(tell_status(ledger))


@_campaign.command("query")
def campaign_query(
    ledger: _LedgerFile,
    sql: Annotated[
        str | None,
        typer.Argument(help="A question in SQL, of the views results and episodes.", metavar="SQL"),
    ] = None,
    claim: Annotated[
        str | None, typer.Option(help="Only of this claim, or of the one with these words.")
    ] = None,
    stratum: Annotated[str | None, typer.Option(help="Only of this stratum.")] = None,
    outcome: Annotated[
        str | None, typer.Option(help="holds, violated, untested, inconclusive or failed.")
    ] = None,
    below: Annotated[
        str | None, typer.Option(help="Only margins below this, with its unit, such as '10 mm'.")
    ] = None,
) -> None:
    """Print results as CSV, the worst margins first; or ask in SQL, which can only read.

    Exit code 0; 2: a question that cannot be answered.
    """
    from safety_harness.cli.campaign import query as ask

    _end(ask(ledger, sql, claim=claim, stratum=stratum, outcome=outcome, below=below))


@_campaign.command("export")
def campaign_export(
    ledger: _LedgerFile,
    out: Annotated[Path | None, typer.Argument(help="A .csv or .parquet file.", metavar="OUT")] = None,
    traces: Annotated[
        Path | None, typer.Option(help="Also the stored traces, as files that replay takes, to this folder.")
    ] = None,
) -> None:
    """Write one line for each episode and claim, for other programs (Parquet: the extra "export").

    Exit code 0; 2: bad input, or it cannot be written.
    """
    from safety_harness.cli.campaign import export as export_ledger

    _end(export_ledger(ledger, out, traces))


@_campaign.command("compare")
def campaign_compare(
    first: Annotated[Path, typer.Argument(help="The ledger before.", metavar="A")],
    second: Annotated[Path, typer.Argument(help="The ledger after.", metavar="B")],
) -> None:
    """Say what got worse from A to B, two campaigns over the same episodes with different avoiders.

    For each claim and stratum the difference in the chance of a violation with exact bounds, paired by
    episode; then the episodes that only B violates, the largest loss of margin first.
    Exit code 0; 1: B is shown to be worse somewhere; 2: campaigns that cannot be compared.
    """
    from safety_harness.cli.campaign import compare as compare_campaigns

    _end(compare_campaigns(first, second))


@_campaign.command("merge")
def campaign_merge(
    into: Annotated[Path, typer.Argument(help="The ledger to make.", metavar="INTO")],
    ledgers: Annotated[list[Path], typer.Argument(help="Ledgers of parts of one plan.", metavar="LEDGER...")],
) -> None:
    """Make one ledger of those of several machines, each of which ran a part of the same plan.

    What two of them have must agree to the last bit.
    Exit code 0; 2: ledgers of different plans, or that disagree.
    """
    from safety_harness.cli.campaign import merge as merge_campaigns

    _end(merge_campaigns(into, ledgers))


@app.command()
def selftest(
    profile: Annotated[str, typer.Option(help="quick: some minutes; nightly: every scenario, and many draws.")] = "quick",
    avoider: OfAvoider = None,
    scenarios: Annotated[
        Path, typer.Option(help="Folder of scenario files, and of spaces/ in it, to try faults on.")
    ] = Path("scenarios"),
    fault: Annotated[str | None, typer.Option(help="Only faults with these words in their name.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for selftest.html and selftest.json.")] = Path(
        "reports/selftest"
    ),
    jobs: Annotated[int, typer.Option(help="Processes at once, each on one core.")] = 2,
) -> None:
    """Put the harness itself on trial: seed faults into a sound system, and tell what caught each.

    A fault is caught by a claim that is violated with it and holds without it on the same scenario. The
    table says which, after how many episodes, and the slightest magnitude that was caught. With --avoider
    the faults are seeded into yours. Harmless changes are tried as well, and must raise no alarm.
    Ctrl-C keeps what was tried.
    Exit code 0; 1: a fault survives that is no stated limit, or a harmless change raises an alarm; 2: bad
    input; 130: interrupted.
    """
    from safety_harness.cli.selftest import selftest as try_harness

    _end(try_harness(scenarios=scenarios, profile=profile, avoider=avoider, fault=fault, out=out, jobs=jobs))


def _end(code: int) -> NoReturn:
    raise typer.Exit(code)


def main() -> None:
    """Entry point: one of our own errors is explained, and never a traceback."""
    try:
        app()
    except SafetyHarnessError as error:
        from safety_harness.cli.console import BAD_INPUT, explain

        explain(error)
        raise SystemExit(BAD_INPUT) from None
