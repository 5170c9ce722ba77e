"""Measure the errors, intervals and spreads of a model on sets of independent inputs.

Each TCP occurs in only one row of a set, because two samples of a TCP would share the noise of its label.
The rows are therefore independent trials, so a fraction of rows has an exact confidence interval.

The draws of an evaluation never coincide with those of a training or a calibration.  The random streams of a
data set derive from its own seed.  A training uses the user's seed.  A calibration derives seeds from the
training's seed with the spawn key (7, k).  An evaluation derives 64-bit seeds from its own seed with the
spawn key (8, k).
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

BRANCH = 8  # another branch of the seed than the calibration's, so that the draws differ
_DECISIONS, _CHOICE = 0, 1  # last keys after the branch and a set's number: decisions' seeds, choice of rows
FLOOR_TCPS = 10_000  # the floor uses at most so many TCPs of a set, the first ones, which takes 7 s
SEEN_NAME, TEST_NAME = "seen, new TCPs", "seen, test part"
# The largest product of TCPs and candidates in a data set to generate again; the paper's has a million.
MOST_VIEWS = 20_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class EvaluationSet:
    """A set of inputs with their labels; positions have the shape (n, 3), in the base frame [m].

    ``labels_in_base`` are the labels of eq. 13.  ``noise_free_in_base`` are the same labels, computed with
    the continuous optimum instead of the selected candidate.  ``floor`` is the least error that a regressor
    can have on this set because of the labels' noise, estimated with 1,000 random labels for each TCP.
    ``floor`` is None for unseen sets, on which errors have other causes.
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
        """Return the origin of the data according to ``card``.

        The result is None if the card states no data in the seen space.
        """
        data = card.get("data")
        try:
            return (
                msgspec.convert(data, cls) if isinstance(data, dict) and data.get("space") == "seen" else None
            )
        except msgspec.ValidationError:
            return None


def leaf(seed: int, *path: int) -> int:
    """Return a 64-bit seed for evaluations, which derives from ``seed`` and ``path``."""
    return seed_below(seed, BRANCH, *path)


def fresh_sets(
    settings: Settings,
    *,
    samples: int,
    seed: int,
    candidates: int,
    on_set: Callable[[str], object] = lambda name: None,
) -> list[EvaluationSet]:
    """Return four sets of new TCPs and hands, one for the seen space and one for each unseen space.

    Args:
        settings: The settings of the cell.
        samples: The number of rows in each set.
        seed: The root of all random numbers.
        candidates: The number of candidates for each TCP.
        on_set: A function that receives the name of each set before the set is drawn.

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
    """Generate the training data of a model again, and return its test part.

    If this is impossible, return None and the reason.

    The part has at most one row for each TCP.  If the split was by sample, the training has seen every TCP.
    The network may then have memorised the noise of a label, so its errors look smaller than on new TCPs.

    Args:
        settings: The settings of the cell.
        card: The origin of the data, from the model's card.
        samples: The largest number of rows.
        seed: The root of the random numbers that select the rows.

    """
    if not (card.tcps >= 10 and 0 < card.tcps * card.candidates <= MOST_VIEWS and card.hands > 0):
        return None, f"its data set has {card.tcps} TCPs with {card.candidates} candidates each"
    dataset = generate(
        settings, seen(settings), seed=card.seed, tcps=card.tcps, candidates=card.candidates, hands=card.hands
    )
    if not is_named_by(dataset, card.sha256):
        return None, "the card's numbers give other training data (another hash)"
    test = SPLITS[card.split](dataset, seed=card.seed).test
    # ``np.unique`` returns the first row of each TCP, so the shuffle before it chooses among a TCP's hands.
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
    """Return an evaluation set with the given rows of a data set.

    Only a set in the seen space has a floor.
    """
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


# The levels of the calibration curve; a choice.
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
PAPER_PRECISION_PER_MM2 = 1e-6  # tau in the paper, for a model whose card states none


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibratedIntervals:
    """The quality of the calibrated intervals and of the spread's threshold on one set.

    ``covered`` is the fraction of rows whose label lies within its interval on all three axes.
    ``above_threshold`` is the fraction of rows whose largest spread exceeds the threshold, so that the gate
    would use its fallback.  In a seen set such a row is a false alarm, and in an unseen set it is a correct
    detection.  ``above_threshold`` is None for a model without a spread.
    """

    covered: Proportion
    coverage: IntervalCoverage
    above_threshold: Proportion | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Figures:
    """The results of one model on one set, with lengths in metres.

    ``errors`` compares the answers with labels of the same kind as in the model's training.  ``noise_free``
    compares the answers with the labels of eq. 13 at the continuous optimum.  ``curves`` has an array of
    shape (levels, 3) for each interval scale, with the fraction of labels within the central interval of each
    level in ``LEVELS``.  ``auroc`` measures how well the largest spread distinguishes this set from the seen
    set.  ``auroc`` is None for a seen set, and for a model without a spread.
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
    """Return True if the training of ``model`` had the continuous optimum as its target."""
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
        sets: The sets, beginning with the seen set.  The AUROC of each unseen set is relative to this first
            set.
        settings: The settings of the cell.
        place: The place for error messages.
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
        # The first set is the seen set, to which the AUROC of each unseen set refers.
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
    """Return the recipe in the card of ``model``, or an empty mapping if the card has no recipe."""
    recipe = model.card.get("recipe")
    return recipe if isinstance(recipe, dict) else {}


def _residual_std(model: Model) -> Floats | None:
    """Return the residuals' standard deviation for each axis, shape (3,) [m].

    The result is None for a model without a calibration.
    """
    return None if model.calibration is None else np.array(model.calibration.residual_std_m)


def _picp(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, IntervalCoverage]:
    """Return the coverage for each interpretation of the paper's PICP.

    A model without a calibration lacks the interpretation that uses residuals.

    ``positions``, ``labels`` and ``spreads`` are (n, 3) [m].
    """
    per_mm2 = _recipe(model).get("precision_per_mm2")
    known = isinstance(per_mm2, int | float) and per_mm2 > 0.0
    precision_per_m2 = 1e6 * (float(per_mm2) if known else PAPER_PRECISION_PER_MM2)  # type: ignore[arg-type]
    return picp_variants(
        positions, labels, spreads, precision=precision_per_m2, residual_std=_residual_std(model)
    )


def _curves(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, Floats]:
    """Return a calibration curve for each interval scale.

    ``positions``, ``labels`` and ``spreads`` have the shape (n, 3) [m].
    """
    levels, residual_std = np.array(LEVELS), _residual_std(model)
    curves = {"spread": calibration_curve(positions, labels, spreads, levels)}
    if residual_std is not None:
        scale = interval_scale(spreads, residual_std)
        curves[RESIDUALS] = calibration_curve(positions, labels, scale, levels)
    return curves


def _intervals(
    model: Model, positions: Floats, labels: Floats, spreads: Floats
) -> CalibratedIntervals | None:
    """Return the quality of the calibrated intervals, or None for a model without a calibration.

    All arrays have the shape (n, 3) [m].
    """
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
