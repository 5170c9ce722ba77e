"""Commands about networks: their data, training, evaluation and export, and their answer times."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import ControllerError, InadmissibleError, ModelError, NoAnswerError
from safety_harness.base.extension_points import ExtensionPoint, names_of, part_named
from safety_harness.base.extras import LEARNING, ONNX
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, document, next_step, result, say
from safety_harness.cli.options import OfController, Seed, command

if TYPE_CHECKING:
    from safety_harness.extensions.lab.learning.checkpoint import Epoch
    from safety_harness.extensions.lab.learning.recipes import Recipe

MODEL = "model.safetensors"
Cell = Annotated[
    str | None,
    Option(
        "--robot",
        help="A scenario that states the cell, the arm and the settings: a file, or shipped:NAME. "
        "Default: the cell of the UR10.",
        metavar="SCENARIO",
    ),
]
commands = Typer()


@command(
    commands,
    interrupted="interrupted: no data set was written",
    then="safety-harness train mc-dropout --data {out}",
)
def dataset(
    out: Annotated[Path, Argument(help="Folder for arrays.npz and manifest.json.", metavar="FOLDER")],
    space: Annotated[
        str,
        Option(
            help="The regions of the TCPs and hands: 'seen', 'unseen hand', 'unseen tcp' or 'unseen both'."
        ),
    ] = "seen",
    tcps: Annotated[int, Option(help="Number of TCP positions.")] = 10_000,
    candidates: Annotated[int, Option(help="Number of repulsive candidates for each TCP.")] = 100,
    hands: Annotated[int, Option(help="Number of hand positions. Each is combined with every TCP.")] = 500,
    robot: Cell = None,
    seed: Seed = 0,
) -> int:
    """Make a data set of TCPs and hands, labelled by eq. 13 of the paper.

    The default data set has the paper's 5,000,000 samples. The command
    generates it in a few seconds.

    Exit code 0: the data set is written.
    Exit code 2: bad input.
    Exit code 130: interrupted; no file was written.
    """
    from safety_harness.cli.progress import counting
    from safety_harness.extensions.lab.learning.cell import training_cell
    from safety_harness.extensions.lab.learning.dataset import generate, space_named
    from safety_harness.extensions.lab.learning.manifest import data_hash, manifest_of, save_dataset

    cell = training_cell(robot)
    where = space_named(space, cell.settings)
    say(f"{where.name} space: {tcps} TCPs, {candidates} candidates each, {hands} hands")
    with counting(tcps, "TCPs") as show:
        made = generate(
            cell.settings,
            where,
            seed=seed,
            tcps=tcps,
            candidates=candidates,
            hands=hands,
            arm=cell.arm,
            on_progress=show,
        )
    save_dataset(made, out)
    views, away = made.tcps * made.candidates, made.views_without_object
    result(
        f"space       {made.space.name}, of the arm {made.arm}",
        f"samples     {len(made):,} = {made.tcps:,} TCPs x {made.hands:,} hands",
        f"candidates  {views:,}; object not wholly in view of {away:,} ({away / views:.2%}), "
        "which are not selected",
        f"blind TCPs  {made.tcps_without_view:,}, with no candidate in view: "
        "selected as if the image had no border",
        f"seed        {made.seed}",
        f"sha256      {data_hash(made)}",
    )
    document(**manifest_of(made), folder=out)
    say(f"data set: {out}")
    return AS_EXPECTED


@command(commands, then="safety-harness evaluate {out}/model.safetensors")
def train(
    recipe: Annotated[
        str,
        Argument(
            help="The kind of network and its training: mc-dropout, mc-dropout-full, deterministic or "
            "ensemble, each also with the prefix paper- or trial-; or optimum, student or "
            "student-ensemble."
        ),
    ] = "mc-dropout",
    robot: Cell = None,
    data: Annotated[
        Path | None,
        Option(help="Folder of a data set. Default: the command generates a data set."),
    ] = None,
    out: Annotated[Path, Option(help="Folder for model.safetensors and the checkpoint.")] = Path(
        "models/new"
    ),
    seed: Seed = 0,
    resume: Annotated[
        bool, Option("--resume", help="Continue from the checkpoint in the folder of --out.")
    ] = False,
    device: Annotated[
        str, Option(help="The device on which PyTorch computes, for example cpu or cuda.")
    ] = "cpu",
) -> int:
    """Train and calibrate a network for the cell of an arm.

    The recipe trial-mc-dropout takes less than a minute. Ctrl-C loses only the
    current epoch. With --resume, a later call continues from the last complete
    epoch and produces a bit-identical model. Training needs PyTorch; install
    this package with the extra "learning".

    Exit code 0: the model is written.
    Exit code 2: bad input.
    Exit code 130: interrupted; --resume continues the training.
    """
    import shlex

    from safety_harness.base.whole_file import writing
    from safety_harness.cell.avoidance.model_file import save_model
    from safety_harness.cli.progress import paced_lines
    from safety_harness.extensions.lab.learning.cell import training_cell
    from safety_harness.extensions.lab.learning.dataset import generate, seen
    from safety_harness.extensions.lab.learning.manifest import load_dataset
    from safety_harness.extensions.lab.learning.recipes import recipe_named
    from safety_harness.extensions.lab.learning.samples import samples_for
    from safety_harness.extensions.lab.learning.trained_model import calibrate, model_of, split_for

    if robot and data:
        raise InadmissibleError.of_option("--robot", "no --data, since its data already have a cell", robot)
    again = ["safety-harness", "train", recipe, "--seed", str(seed), "--out", str(out)]
    again += ["--robot", robot] if robot else []
    again += ["--data", str(data)] if data else []
    again += ["--device", device] if device != "cpu" else []
    try:
        chosen = recipe_named(recipe)
        if data:
            dataset = load_dataset(data)
        else:
            cell = training_cell(robot)
            dataset = generate(cell.settings, seen(cell.settings), seed=seed, arm=cell.arm)
        split = split_for(chosen, dataset)
        with LEARNING.needed("train"):
            from safety_harness.extensions.lab.learning.training import CHECKPOINT  # brings PyTorch
            from safety_harness.extensions.lab.learning.training import train as train_networks
        if resume and not (out / CHECKPOINT).exists():
            say(f"{out} has no checkpoint to go on from: beginning from the start")
        say(f"training on {len(split.train):,} samples of the cell of a {dataset.arm}")
        with paced_lines() as report:
            trained = train_networks(
                chosen,
                samples_for(chosen, dataset),
                split.train,
                split.validation,
                seed=seed,
                out=out,
                resume=resume,
                device=device,
                on_epoch=_epoch_lines(chosen, report),
            )
        say("calibrating on seen TCPs and hands that are new")
        model = model_of(trained, dataset, split, shlex.join(again))
        model = calibrate(model, chosen, dataset, seed=seed)
        with writing(out / MODEL):
            save_model(model, out / MODEL)
    except KeyboardInterrupt:
        say(f"stopped; to go on from the last whole epoch: {shlex.join([*again, '--resume'])}")
        return INTERRUPTED
    assert model.calibration is not None
    multiplier, threshold_m = model.calibration.interval_multiplier, model.calibration.spread_threshold_m
    result(f"intervals of 95 % joint coverage: {multiplier:.3f} times sqrt(spread^2 + residual^2)")
    result(f"spread threshold: {1e3 * threshold_m:.2f} mm")
    low_m, high_m = model.seen.boxes["tcp"]
    result(f"made for the arm {model.made_for}, TCPs from {list(low_m)} to {list(high_m)} m")
    result(f"model: {out / MODEL}")
    document(
        model=out / MODEL, arm=model.made_for, interval_multiplier=multiplier, spread_threshold_m=threshold_m
    )
    return AS_EXPECTED


def _epoch_lines(recipe: Recipe, say: Callable[[str], None]) -> Callable[[Epoch], None]:
    """Return a function that prints the losses, the progress and the remaining time after each epoch."""
    begun_s, epochs = time.monotonic(), count(1)

    def report(epoch: Epoch) -> None:
        whole = recipe.members * recipe.epochs
        left = whole - epoch.member * recipe.epochs - epoch.number - 1
        left_s = left * (time.monotonic() - begun_s) / next(epochs)
        member = f"member {epoch.member + 1}/{recipe.members}, " if recipe.members > 1 else ""
        say(
            f"{member}epoch {epoch.number + 1}/{recipe.epochs}: loss {epoch.training_loss:.4f}, "
            f"validation {epoch.validation_loss:.4f}, RMSE {1e3 * epoch.validation_rmse_m:.2f} mm"
            f"{' (best)' if epoch.is_best else ''}, {100 * (1 - left / whole):.0f} %, {left_s:.0f} s left"
        )

    return report


@command(commands, interrupted="interrupted: no figures were written")
def metrics(
    models: Annotated[
        list[str],
        Argument(help="Model files (*.safetensors), or names of shipped models.", metavar="MODEL..."),
    ],
    robot: Cell = None,
    samples: Annotated[int, Option(help="Number of new pairs of a TCP and a hand in each set.")] = 10_000,
    seed: Seed = 0,
    out: Annotated[Path | None, Option(help="Also write all figures as JSON to this file.")] = None,
) -> int:
    """Compare networks on inputs from seen and unseen space.

    The tables show the errors relative to the labels of eq. 13, the intervals
    and their coverage, and how well the spread detects unseen inputs. All
    models answer the same inputs, which training and calibration did not use.
    To score an avoider that is not such a network, use the command evaluate.

    Exit code 0: the tables are printed.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    from safety_harness.cell.avoidance.learned import LearnedAvoider
    from safety_harness.cli.progress import paced_lines
    from safety_harness.extensions.lab.commands.evaluation_tables import tables
    from safety_harness.extensions.lab.learning.cell import training_cell
    from safety_harness.extensions.lab.learning.evaluation_file import (
        evaluation_data,
        figures_of,
        load_models,
        write_evaluation,
    )

    cell = training_cell(robot)
    loaded = load_models(models, cell.settings)
    with paced_lines() as report:
        figures, remarks = figures_of(loaded, samples, seed, report, cell)
    data = evaluation_data(loaded, figures, remarks, samples, seed)
    document(**data)
    if out is not None:
        write_evaluation(out, data)
    for model in loaded:
        result(f"{model.label}: {LearnedAvoider.from_model(model.model).name}, {model.path}")
    result(f"{samples} TCPs and hands a set, drawn from seed {seed}; every TCP is in one row only")
    result(*remarks, *tables(figures))
    if out is not None:
        say(f"figures: {out}")
    return AS_EXPECTED


@command(commands, "time", interrupted="interrupted: no file was written")
def time_answers(
    avoider: Annotated[
        str | None,
        Argument(
            help="The avoider: the name of a shipped avoider, FILE.py:NAME, FILE.safetensors or FILE.onnx.",
            metavar="AVOIDER",
            show_default=False,
        ),
    ] = None,
    controller: OfController = None,
    out: Annotated[
        Path | None, Option(help="Also write the times as a profile for scenarios to this file (*.json).")
    ] = None,
    questions: Annotated[
        int, Option(help="Smallest number of answers to measure.", min=100, max=1_000_000)
    ] = 1_000,
    seed: Seed = 0,
    scenario: Annotated[
        str, Option(help="The scenario in which the controller of --controller runs.", metavar="FILE")
    ] = "shipped:first-run",
) -> int:
    """Measure the answer times of an avoider or controller on this machine.

    The command prints the median, the 99th percentile and the maximum. With
    --out, it also writes a profile of the times. If a scenario uses the profile
    (settings: {avoidance: {decision time: FILE.json}}), its simulated answer
    times are random draws from the profile. If the avoider is a Python file,
    the command executes this file.

    Exit code 0: the times are printed.
    Exit code 2: bad input, or a program that does not answer.
    Exit code 130: interrupted.
    """
    from safety_harness.base.whole_file import write_text
    from safety_harness.extensions.lab.measured_times import measured_controller, measured_times
    from safety_harness.report.words import milliseconds_words
    from safety_harness.scenario.decision_times import profile_text
    from safety_harness.scenario.read import read_scenario

    if out is not None and out.suffix != ".json":
        raise InadmissibleError.of_option("--out", "a file *.json", out.name)
    if (avoider is None) == (controller is None):
        got = "neither" if avoider is None else "both"
        raise InadmissibleError.of_option("AVOIDER", "an avoider, or --controller", got)
    try:
        if controller is None:
            times = measured_times(str(avoider), questions, seed)
        else:
            times = measured_controller(controller, replace(read_scenario(scenario), seed=seed), questions)
    except (NoAnswerError, ControllerError) as error:
        say(f"error: {error}; no file was written")
        return BAD_INPUT
    if out is not None:
        write_text(out, profile_text(times.profile))
    quantiles_s = times.quantiles_s(0.5, 0.99, 1.0)
    p50, p99, most = map(milliseconds_words, quantiles_s)
    document(
        avoider=times.measured.avoider,
        **dict(zip(("p50_s", "p99_s", "max_s"), quantiles_s, strict=True)),
        questions=times.measured.questions,
        faults=times.faults,
        machine=times.measured.machine,
        profile=out,
    )
    who = times.measured.avoider + ("" if controller else f" ({times.avoider_name})")
    result(f"{who}: p50 {p50}, p99 {p99}, max {most}, of {times.measured.questions:,} answers")
    result(f"on {times.measured.machine}")
    if times.faults:
        say(f"note: {times.faults} of them were faults, no usable answers")
    if out is not None:
        say(f"profile: {out}; in a scenario: settings: {{avoidance: {{decision time: {out.name}}}}}")
    if avoider is not None:
        next_step(f"safety-harness evaluate {shlex.quote(avoider)}")
    return AS_EXPECTED


@command(commands, interrupted="interrupted before the export")
def export(
    model: Annotated[
        str,
        Argument(
            help="A model file (*.safetensors), the name of a shipped model, or the trace of a run.",
            metavar="MODEL|TRACE",
        ),
    ],
    out: Annotated[Path, Option(help="The file to write: FILE.onnx for a model, or FILE.mcap for a trace.")],
    seed: Seed = 0,
) -> int:
    """Write a model as ONNX, or a run as MCAP.

    After the export of a model, the command compares the answers of the model
    with the answers of the ONNX file, for random inputs. This needs PyTorch;
    install this package with the extra "learning".

    The export of a trace to FILE.mcap needs the extra "logs". The MCAP file
    contains the joints, transforms, hands, decisions and verdicts, as ROS 2
    messages and in Foxglove's schemas. The command also writes a LOG.yaml, with
    which the command judge can read the MCAP file.

    Exit code 0: the file is written.
    Exit code 2: bad input, or the ONNX file and the model differ; no file is
    written.
    Exit code 130: interrupted.
    """
    from safety_harness.cell.avoidance.model_file import load_model
    from safety_harness.cell.avoidance.shipped import model_file

    if (form := out.suffix[1:]) in names_of(ExtensionPoint.RUN_FORMATS):
        from safety_harness.admission.trial import judge
        from safety_harness.trace.store import load_trace

        write = part_named(ExtensionPoint.RUN_FORMATS, form, FunctionType)
        trace = load_trace(model)
        written, *logs = write(trace, judge(trace, file=Path(model)), out)
        document(**{form: written} | ({"log": logs[0]} if logs else {}))
        result(f"{form}: {written}" + "".join(f", described by {log}" for log in logs))
        next_step(shlex.join(["safety-harness", *(("judge", *map(str, logs)) if logs else ("view", model))]))
        return AS_EXPECTED
    path = model_file(str(model))
    if seed < 0:
        raise ModelError.of_option("--seed", "a seed of at least 0", str(seed))
    loaded = load_model(path)
    with LEARNING.needed("export"), ONNX.needed("export"):  # PyTorch imports onnxscript late
        from safety_harness.extensions.lab.learning.export import write_export  # brings PyTorch

        difference_m = write_export(loaded, path.read_bytes(), out, seed=seed)
    document(onnx=out, model=path, max_difference_m=difference_m)
    result(f"onnx: {out}")
    result(f"differs from {path} by {1e3 * difference_m:.1e} mm at most")
    next_step(shlex.join(["safety-harness", "evaluate", str(out)]))
    return AS_EXPECTED
