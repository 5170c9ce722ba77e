"""The quality of a model: its errors, its intervals and its doubt, on sets of independent decisions.

Each TCP occurs in only one row of a set, because two samples of a TCP would share the noise of its label.
So the rows are independent trials, and shares of rows have exact intervals.

The draws of an evaluation never coincide with those of a training or a calibration.  The streams of a data
set are leaves of its own seed.  A training uses the seed that its user gave.  A calibration derives seeds
from that seed with the spawn key (7, k).  An evaluation derives 64-bit seeds from its own seed with the spawn
key (8, k).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from safety_harness.base.exceptions import ModelError, Place
from safety_harness.base.proportions import Proportion
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Dropout, Model
from safety_harness.cell.controller.desired import reachable
from safety_harness.extensions.lab.learning.dataset import (
    SPACES,
    SPLITS,
    CompactDataset,
    LabelFloor,
    fresh_pairs,
    generate,
    label_floor,
    seed_below,
    seen,
    space_named,
)
from safety_harness.extensions.lab.learning.manifest import is_named_by
from safety_harness.extensions.lab.learning.metrics import (
    RESIDUALS,
    Errors,
    IntervalCoverage,
    auroc,
    calibration_curve,
    coverage,
    errors,
    largest_spread,
    picp_variants,
)
from safety_harness.extensions.lab.learning.recipes import SplitKind
from safety_harness.extensions.lab.learning.trained_model import interval_scale
from safety_harness.scenario.robots import AnyRobot, Robot

Floats = NDArray[np.float64]

BRANCH = 8
_DECISIONS, _CHOICE = 0, 1  # last keys after the branch and a set's number: decisions' seeds, choice of rows
FLOOR_TCPS = 10_000  # the floor uses at most so many TCPs of a set, the first ones, which takes 7 s
SEEN_NAME, TEST_NAME = "seen, new TCPs", "seen, test part"
# The largest product of TCPs and candidates in a data set to generate again; the paper's has a million.
MOST_VIEWS = 20_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class EvaluationSet:
    """Questions with their labels, as rows (n, 3) in the base frame [m].

    ``labels_in_base`` are the labels of eq. 13.  ``noise_free_in_base`` are the labels with the continuous
    optimum instead of the selected candidate.  ``floor`` is the least error that any regressor has on this
    set because of the labels' noise.  It comes from 1,000 redraws for each TCP.  It is None for unseen sets,
    where errors have other causes.
    """

    name: str
    about: str
    seen: bool
    hands_in_base: Floats
    tcps_in_base: Floats
    labels_in_base: Floats
    noise_free_in_base: Floats
    decision_seeds: NDArray[np.uint64]  # (n,)
    floor: LabelFloor | None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.hands_in_base)


Count = Annotated[int, Meta(ge=0)]


@dataclass(frozen=True)
class DataCard:
    """The origin of the training data, as a model's card states it."""

    seed: Count
    tcps: Count
    candidates: Count
    hands: Count
    split: SplitKind
    sha256: str

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> DataCard | None:
        """Return the origin of the data that ``card`` states; None if it states no data in the seen space."""
        data = card.get("data")
        try:
            return (
                msgspec.convert(data, cls) if isinstance(data, dict) and data.get("space") == "seen" else None
            )
        except msgspec.ValidationError:
            return None


def leaf(seed: int, *path: int) -> int:
    """Return a 64-bit seed below ``seed``, at ``path`` on the evaluation's own branch."""
    return seed_below(seed, BRANCH, *path)


def fresh_sets(
    settings: Settings,
    *,
    samples: int,
    seed: int,
    candidates: int,
    on_set: Callable[[str], object] = lambda name: None,
) -> list[EvaluationSet]:
    """Return sets of new TCPs and hands, in the seen space and in the three unseen spaces.

    Args:
        settings: The settings of the cell.
        samples: The number of rows in each set.
        seed: The root of all random numbers.
        candidates: The number of candidates for each TCP.
        on_set: Receives the name of each set before its draw.

    """
    sets = []
    for number, name in enumerate(SPACES, start=1):
        on_set(name)
        space = space_named(name, settings)
        drawn, pairs = fresh_pairs(
            settings, space, seed=leaf(seed, number), samples=samples, candidates=candidates
        )
        is_seen = name == "seen"
        called = SEEN_NAME if is_seen else name
        description = f"{samples} TCPs and as many hands, drawn afresh in the space {name!r}"
        sets.append(_set(called, description, drawn, pairs, is_seen=is_seen, seed=seed, number=number))
    return sets


def test_part(
    settings: Settings, card: DataCard, *, samples: int, seed: int
) -> tuple[EvaluationSet | None, str]:
    """Return the test part of a model's training data, generated again; or return None and the reason.

    The part has at most one row for each TCP.  After a random split of samples, the training has seen every
    TCP.  Then the network may remember the noise of a label, and errors look smaller than on new TCPs.

    Args:
        settings: The settings of the cell.
        card: The origin of the data, from the model's card.
        samples: The largest number of rows.
        seed: The root of the choice of rows.

    """
    if not (card.tcps >= 10 and 0 < card.tcps * card.candidates <= MOST_VIEWS and card.hands > 0):
        return None, f"its data set has {card.tcps} TCPs with {card.candidates} candidates each"
    dataset = generate(
        settings, seen(settings), seed=card.seed, tcps=card.tcps, candidates=card.candidates, hands=card.hands
    )
    if not is_named_by(dataset, card.sha256):
        return None, "the card's numbers give other training data (another hash)"
    test = SPLITS[card.split](dataset, seed=card.seed).test
    rng = np.random.default_rng(leaf(seed, 0, _CHOICE))
    shuffled = rng.permutation(test)
    _, first = np.unique(shuffled // card.hands, return_index=True)
    rows = rng.permutation(shuffled[first])[:samples]
    text = (
        f"{len(rows)} samples of different TCPs from the test part of the training data, split {card.split}"
    )
    return _set(f"{TEST_NAME} {card.split}", text, dataset, rows, is_seen=True, seed=seed, number=0), ""


def _set(
    name: str,
    description: str,
    dataset: CompactDataset,
    rows: NDArray[np.int64],
    *,
    is_seen: bool,
    seed: int,
    number: int,
) -> EvaluationSet:
    """Return an evaluation set with the ``rows`` of a data set; only a seen set has a floor."""
    inputs = dataset.inputs(rows)
    rng = np.random.default_rng(leaf(seed, number, _DECISIONS))
    return EvaluationSet(
        name=name,
        about=description,
        seen=is_seen,
        hands_in_base=inputs[:, :3],
        tcps_in_base=inputs[:, 3:],
        labels_in_base=dataset.targets(rows),
        noise_free_in_base=dataset.without_noise().targets(rows),
        decision_seeds=rng.integers(0, 2**64, len(rows), dtype=np.uint64),
        floor=label_floor(dataset.settings, inputs[:FLOOR_TCPS, 3:], seed=leaf(seed, number))
        if is_seen
        else None,
    )


LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
PAPER_PRECISION_PER_MM2 = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibratedIntervals:
    """The quality of the calibrated intervals and of the spread's threshold on one set.

    ``covered`` is the share of rows whose label lies within its interval on all three axes.
    ``above_threshold`` is the share of rows whose largest spread exceeds the threshold, so that the gate
    falls back.  On a seen set these rows are false alarms; on an unseen set they are detections.  The share
    is None for a model without a spread.
    """

    covered: Proportion
    coverage: IntervalCoverage
    above_threshold: Proportion | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Figures:
    """The figures of one model on one set; lengths in metres.

    ``errors`` compares the answers with the labels of the training's target.  ``noise_free`` compares them
    with eq. 13 at the continuous optimum.  ``curves`` has an array (levels, 3) for each scale: the share of
    labels within the central interval of each level in ``LEVELS``.  ``auroc`` rates how well the largest
    spread distinguishes this set from the seen set.  It is None on a seen set, or without a spread.
    """

    model: str
    set: EvaluationSet
    errors: Errors
    noise_free: Errors
    picp: Mapping[str, IntervalCoverage]
    curves: Mapping[str, Floats]
    median_largest_spread_m: float
    intervals: CalibratedIntervals | None
    auroc: float | None
    unreachable: Proportion


def has_spread(model: Model) -> bool:
    """Return whether the spread of ``model`` can differ from zero."""
    return model.dropout is not Dropout.NONE or model.members > 1


def learns_noise_free(model: Model) -> bool:
    """Return whether the card of ``model`` names the continuous optimum as the training's target."""
    return _recipe(model).get("target") == "continuous"


def evaluate_model(
    label: str,
    model: Model,
    sets: list[EvaluationSet],
    settings: Settings,
    *,
    place: Place,
    robot: AnyRobot = Robot.UR10,
) -> list[Figures]:
    """Return the figures of a model on each set.

    Args:
        label: The model's name in tables.
        model: The model.
        sets: The sets; the first is the seen set, from which the AUROC distinguishes the unseen sets.
        settings: The settings of the cell.
        place: The place that an error names.
        robot: The arm.

    Raises:
        ModelError: An answer is not finite.

    """
    avoider = LearnedAvoider.from_model(model)
    seen_spread: Floats | None = None
    figures = []
    for rows in sets:
        positions, spreads = avoider.propose_many(rows.hands_in_base, rows.tcps_in_base, rows.decision_seeds)
        bad = np.flatnonzero(~np.isfinite(positions + spreads).all(axis=1))
        if len(bad):
            hand, tcp = rows.hands_in_base[bad[0]].tolist(), rows.tcps_in_base[bad[0]].tolist()
            raise ModelError(
                place=place,
                expected=f"finite answers on the set {rows.name!r}",
                got=f"{positions[bad[0]].tolist()} for hand {hand} and TCP {tcp}",
            )
        largest = largest_spread(spreads)
        if seen_spread is None:
            seen_spread = largest
        is_unseen = not rows.seen and has_spread(model)
        labels = rows.noise_free_in_base if learns_noise_free(model) else rows.labels_in_base
        figures.append(
            Figures(
                model=label,
                set=rows,
                errors=errors(positions, labels),
                noise_free=errors(positions, rows.noise_free_in_base),
                picp=_picp(model, positions, labels, spreads),
                curves=_curves(model, positions, labels, spreads),
                median_largest_spread_m=float(np.median(largest)),
                intervals=_intervals(model, positions, labels, spreads),
                auroc=auroc(seen_spread, largest) if is_unseen else None,
                unreachable=Proportion.from_rows(~reachable(positions, settings, robot)),
            )
        )
    return figures


def _recipe(model: Model) -> Mapping[str, Any]:
    """Return the recipe in the card of ``model``; empty if the card has none."""
    recipe = model.card.get("recipe")
    return recipe if isinstance(recipe, dict) else {}


def _residual_std(model: Model) -> Floats | None:
    """Return the residuals' standard deviations (3,) [m] by axis; None without a calibration."""
    return None if model.calibration is None else np.array(model.calibration.residual_std_m)


def _picp(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, IntervalCoverage]:
    """Return the coverage for each reading of the paper's PICP; one reading needs a calibration.

    ``positions``, ``labels`` and ``spreads`` are (n, 3) [m].
    """
    per_mm2 = _recipe(model).get("precision_per_mm2")
    known = isinstance(per_mm2, int | float) and per_mm2 > 0.0
    precision_per_m2 = 1e6 * (float(per_mm2) if known else PAPER_PRECISION_PER_MM2)  # type: ignore[arg-type]
    return picp_variants(
        positions, labels, spreads, precision=precision_per_m2, residual_std=_residual_std(model)
    )


def _curves(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, Floats]:
    """Return a calibration curve for each scale; ``positions``, ``labels``, ``spreads`` are (n, 3) [m]."""
    levels, residual_std = np.array(LEVELS), _residual_std(model)
    curves = {"spread": calibration_curve(positions, labels, spreads, levels)}
    if residual_std is not None:
        scale = interval_scale(spreads, residual_std)
        curves[RESIDUALS] = calibration_curve(positions, labels, scale, levels)
    return curves


def _intervals(
    model: Model, positions: Floats, labels: Floats, spreads: Floats
) -> CalibratedIntervals | None:
    """Return the quality of the calibrated intervals on (n, 3) [m] arrays; None without a calibration."""
    calibration = model.calibration
    if calibration is None:
        return None
    scale = interval_scale(spreads, np.array(calibration.residual_std_m))
    half_widths = calibration.interval_multiplier * scale
    above = np.asarray(largest_spread(spreads) > calibration.spread_threshold_m)
    inside: NDArray[np.bool_] = np.all(np.abs(positions - labels) <= half_widths, axis=-1)
    return CalibratedIntervals(
        covered=Proportion.from_rows(inside),
        coverage=coverage(positions, labels, half_widths),
        above_threshold=Proportion.from_rows(above) if has_spread(model) else None,
    )
