"""Commands about networks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.cli.options import ModelFiles, Seed, end

commands = typer.Typer()


@commands.command()
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

    end(make_dataset(out, space=space, tcps=tcps, candidates=candidates, hands=hands, seed=seed))


@commands.command()
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

    end(train_recipe(recipe, data=data, seed=seed, out=out, resume=resume, device=device))


@commands.command()
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

    end(evaluate_models(models, samples=samples, seed=seed, out=out))


@commands.command(name="time")
def time_command(
    avoider: Annotated[
        str,
        typer.Argument(
            help="Any avoider: a shipped one by name, FILE.py:NAME, FILE.safetensors or FILE.onnx.",
            metavar="AVOIDER",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Also a profile for scenarios, to this file *.json.")
    ] = None,
    questions: Annotated[int, typer.Option(help="How many are asked.", min=100, max=1_000_000)] = 1_000,
    seed: Seed = 0,
) -> None:
    """Measure how long an avoider takes to answer on this machine: p50, p99, max.

    A scenario that names the profile (settings: {avoidance: {decision time: FILE.json}}) draws what each
    decision costs in simulated time from it.  A Python file is executed.
    Exit code 0; 2: bad input, or an avoider that does not answer; 130: interrupted.
    """
    from safety_harness.cli.decision_times import time_avoider

    end(time_avoider(avoider, out=out, questions=questions, seed=seed))


@commands.command()
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

    end(export_model(model, out=out, format=format, seed=seed))
