"""Compare trained models on the same random inputs, and write all results to a JSON file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import DatasetError, ModelError, Place
from safety_harness.base.proportions import Proportion
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.base.whole_file import write_whole
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Model, load_model, writing_to
from safety_harness.cell.avoidance.shipped import model_file
from safety_harness.extensions.lab.learning.cell import UR10_CELL, TrainingCell
from safety_harness.extensions.lab.learning.dataset import seen
from safety_harness.extensions.lab.learning.evaluation import (
    LEVELS,
    DataCard,
    EvaluationSet,
    Figures,
    evaluate_model,
    fresh_sets,
    learns_noise_free,
    test_part,
)
from safety_harness.extensions.lab.learning.metrics import IntervalCoverage
from safety_harness.scenario.typed_json import plain

SCHEMA = "safety-harness evaluation 1"
FEWEST, MOST = 10, 1_000_000  # samples of a set
SAME_PLACE_M = 1e-9


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A model, its label in tables, and the path and the hash of its file."""

    path: Path
    label: str
    model: Model
    sha256: str

    @property
    def candidates(self) -> int:
        """The number of candidates per TCP in the training data, which determines the noise of the labels."""
        card = DataCard.from_card(self.model.card)
        return card.candidates if card and card.candidates else DEFAULTS.avoidance.candidate_count


def load_models(models: Sequence[str | Path], settings: Settings = DEFAULTS) -> list[LoadedModel]:
    """Load models from files, or shipped models by their names.

    Args:
        models: The paths of files, or the names of shipped models.
        settings: The settings of the cell.

    Raises:
        ModelError: ``models`` is empty, or the seen space of a model differs from the cell's.

    """
    if not models:
        raise ModelError(place=Place(field="MODEL"), expected="at least one model", got="none")
    loaded: list[LoadedModel] = []
    for reference in models:
        path = model_file(str(reference))
        model = load_model(path)
        _refuse_another_space(model, path, settings)
        name = path.parent.name if path.stem == "model" and path.parent.name else path.stem
        same = sum(entry.label.partition(" #")[0] == name for entry in loaded)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        loaded.append(LoadedModel(path, f"{name} #{same + 1}" if same else name, model, digest))
    return loaded


def _refuse_another_space(model: Model, path: Path, settings: Settings) -> None:
    """Raise ModelError unless the model and the cell have the same seen space."""
    space = seen(settings)
    for name, ours in (("hand", space.hand.outer), ("tcp", space.tcp.outer)):
        corners, theirs = np.array([ours.low_m, ours.high_m]), model.seen.boxes[name]
        if not np.abs(corners - np.array(theirs)).max() <= SAME_PLACE_M:
            raise ModelError(
                place=Place(file=path, field=f"seen.{name}_low_m to seen.{name}_high_m"),
                expected=f"the seen space of the cell, {corners[0].tolist()} to {corners[1].tolist()}",
                got=f"{list(theirs[0])} to {list(theirs[1])}, of the arm {model.made_for}",
                hint="--robot SCENARIO states the cell of its training",
            )


def figures_of(
    loaded: list[LoadedModel],
    samples: int,
    seed: int,
    say: Callable[[str], None],
    cell: TrainingCell = UR10_CELL,
) -> tuple[list[Figures], list[str]]:
    """Return the results of every model on every set, and remarks on missing results.

    Args:
        loaded: The models.
        samples: The number of rows in each set.
        seed: The root of all random numbers.
        say: A function that receives lines of text about the progress.
        cell: The cell of the models.

    Raises:
        DatasetError: ``samples`` is out of range, or ``seed`` is negative.

    """
    if not FEWEST <= samples <= MOST:
        raise DatasetError(
            place=Place(field="--samples"), expected=f"a number from {FEWEST} to {MOST}", got=str(samples)
        )
    if seed < 0:
        raise DatasetError(place=Place(field="--seed"), expected="a seed of at least 0", got=str(seed))
    fresh: dict[int, list[EvaluationSet]] = {}
    parts: dict[DataCard, tuple[EvaluationSet | None, str]] = {}
    figures: list[Figures] = []
    remarks: list[str] = []
    for net in loaded:
        if net.candidates not in fresh:
            fresh[net.candidates] = fresh_sets(
                cell.settings,
                samples=samples,
                seed=seed,
                candidates=net.candidates,
                on_set=lambda name: say(f"drawing {samples} TCPs and hands: {name}"),
            )
        card = DataCard.from_card(net.model.card)
        if card is not None and card not in parts:
            say(f"{net.label}: making its training data again")
            parts[card] = test_part(cell.settings, card, samples=samples, seed=seed)
        part, why = (None, "it has no card with the numbers of its data") if card is None else parts[card]
        if part is None:
            remarks.append(f"{net.label}: no test part of the training data, since {why}")
        if net.model.calibration is None:
            remarks.append(f"{net.label}: not calibrated, so without intervals, threshold and residuals")
        if learns_noise_free(net.model):
            remarks.append(f"{net.label}: trained for labels without noise, and measured on such")
        say(f"{net.label}: evaluating")
        seen_set, *unseen = fresh[net.candidates]
        sets = [seen_set, *([part] if part is not None else []), *unseen]
        place = Place(file=net.path)
        figures += evaluate_model(net.label, net.model, sets, cell.settings, place=place, robot=cell.robot)
    return figures, remarks


def evaluation_data(
    loaded: list[LoadedModel], figures: list[Figures], remarks: list[str], samples: int, seed: int
) -> dict[str, Any]:
    """Return all results as data for JSON, with lengths in metres.

    Args:
        loaded: The models.
        figures: The figures of ``figures_of``.
        remarks: The remarks of ``figures_of``.
        samples: The number of rows in each set.
        seed: The root of all random numbers.

    """
    return {
        "schema": SCHEMA,
        "package_version": installed_version(),
        "source_hash": source_hash(),
        "seed": seed,
        "samples": samples,
        "levels": list(LEVELS),
        "remarks": remarks,
        "models": [
            {
                "label": entry.label,
                "file": str(entry.path),
                "sha256": entry.sha256,
                "name": LearnedAvoider.from_model(entry.model).name,
                "calibration": plain(entry.model.calibration),
                "sets": [_json_of(f) for f in figures if f.model == entry.label],
            }
            for entry in loaded
        ],
    }


def write_evaluation(out: Path, data: dict[str, Any]) -> None:
    """Write the data of ``evaluation_data`` to the file ``out``; raise OutputError if that fails."""
    with writing_to(out):
        write_whole(out, json.dumps(data, indent=1, allow_nan=False, default=np.ndarray.tolist) + "\n")


def _json_of(figures: Figures) -> dict[str, Any]:
    """Return the results of one model on one set as data for JSON."""
    rows, intervals = figures.set, figures.intervals
    return {
        "set": rows.name,
        "about": rows.about,
        "seen": rows.seen,
        "rows": len(rows),
        "label_floor_m": None if rows.floor is None else asdict(rows.floor),
        "errors_m": asdict(figures.errors),
        "errors_without_noise_m": asdict(figures.noise_free),
        "picp_95": {name: _coverage(value) for name, value in figures.picp.items()},
        "calibration_curves": figures.curves,
        "median_largest_spread_m": figures.median_largest_spread_m,
        "auroc_against_seen": figures.auroc,
        "unreachable": _proportion(figures.unreachable),
        "intervals_95": None
        if intervals is None
        else _coverage(intervals.coverage) | {"joint": _proportion(intervals.covered)},
        "above_spread_threshold": None
        if intervals is None or intervals.above_threshold is None
        else _proportion(intervals.above_threshold),
    }


def _coverage(coverage: IntervalCoverage) -> dict[str, Any]:
    """Return a coverage as data for JSON."""
    return {"picp": coverage.picp, "joint": coverage.joint, "mean_width_m": coverage.mean_width}


def _proportion(proportion: Proportion) -> dict[str, Any]:
    """Return a proportion as data for JSON, including the value of the fraction."""
    return asdict(proportion) | {"share": proportion.share}
