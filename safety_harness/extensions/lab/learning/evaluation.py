"""What a model is worth: its errors, its intervals and its doubt, on sets of independent decisions.

No TCP occurs in two rows of a set, so that rows are independent trials and shares of them have exact
intervals: two samples of one TCP would share the noise of its label.

The draws never coincide with those of a training or a calibration.  A data set's streams are leaves of
its own seed; a training's is the number that its user gave, a calibration's come from that with the spawn
key (7, k), and those here from the evaluation's own seed with (8, k): 64 bits that no other path gives.
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
from safety_harness.extensions.lab.learning.manifest import data_hash
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
_DECISIONS, _CHOICE = 0, 1  # below the branch and a set's number: seeds of its decisions, its choice of rows
FLOOR_TCPS = 10_000  # the first ones, at most: 7 s
SEEN_NAME, TEST_NAME = "seen, new TCPs", "seen, test part"
MOST_VIEWS = 20_000_000  # of a data set that is made again: TCPs times candidates; the paper's has a million


@dataclass(frozen=True, eq=False, kw_only=True)
class EvaluationSet:
    """Questions with their labels: rows (n, 3), base frame [m].

    ``labels_in_base`` are eq. 13's, ``noise_free_in_base`` those with the continuous optimum in place of
    the selected candidate; ``floor`` is what the noise of the labels leaves of any regressor's error on this
    set, by 1,000 redraws for each TCP; only of seen sets, for elsewhere errors have other reasons.
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
        """How many rows there are."""
        return len(self.hands_in_base)


Count = Annotated[int, Meta(ge=0)]


@dataclass(frozen=True)
class DataCard:
    """How a model's card says that its training data were made."""

    seed: Count
    tcps: Count
    candidates: Count
    hands: Count
    split: SplitKind
    sha256: str

    @classmethod
    def of(cls, card: Mapping[str, Any]) -> DataCard | None:
        """From the card of a model file; None if it does not say, or is no card of ours."""
        data = card.get("data")
        try:
            return (
                msgspec.convert(data, cls) if isinstance(data, dict) and data.get("space") == "seen" else None
            )
        except msgspec.ValidationError:
            return None


def leaf(seed: int, *path: int) -> int:
    """A 64-bit seed on the evaluation's own branch."""
    return seed_below(seed, BRANCH, *path)


def fresh_sets(
    settings: Settings,
    *,
    samples: int,
    seed: int,
    candidates: int,
    on_set: Callable[[str], object] = lambda name: None,
) -> list[EvaluationSet]:
    """New TCPs and hands of the seen space and of the three unseen ones, ``samples`` rows each.

    ``on_set`` is told the name of each before it is drawn.
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
        about = f"{samples} TCPs and as many hands, drawn afresh in the space {name!r}"
        sets.append(_set(called, about, drawn, pairs, is_seen=is_seen, seed=seed, number=number))
    return sets


def test_part(
    settings: Settings, card: DataCard, *, samples: int, seed: int
) -> tuple[EvaluationSet | None, str]:
    """The part that a model's own training held out for testing, made again; or None, and why.

    At most one row a TCP.  Of a random split over the samples every TCP was trained on as well: its
    label's noise may be remembered, and errors look smaller than on new TCPs.
    """
    if not (card.tcps >= 10 and 0 < card.tcps * card.candidates <= MOST_VIEWS and card.hands > 0):
        return None, f"its data set has {card.tcps} TCPs with {card.candidates} candidates each"
    dataset = generate(
        settings, seen(settings), seed=card.seed, tcps=card.tcps, candidates=card.candidates, hands=card.hands
    )
    if data_hash(dataset) != card.sha256:
        return None, "its training data cannot be made again from the card's numbers (another hash)"
    test = SPLITS[card.split](dataset, seed=card.seed).test
    rng = np.random.default_rng(leaf(seed, 0, _CHOICE))
    shuffled = rng.permutation(test)
    _, first = np.unique(shuffled // card.hands, return_index=True)
    rows = rng.permutation(shuffled[first])[:samples]
    about = (
        f"{len(rows)} samples of different TCPs from the test part of the training data, split {card.split}"
    )
    return _set(f"{TEST_NAME} {card.split}", about, dataset, rows, is_seen=True, seed=seed, number=0), ""


def _set(
    name: str,
    about: str,
    dataset: CompactDataset,
    rows: NDArray[np.int64],
    *,
    is_seen: bool,
    seed: int,
    number: int,
) -> EvaluationSet:
    inputs = dataset.inputs(rows)
    rng = np.random.default_rng(leaf(seed, number, _DECISIONS))
    return EvaluationSet(
        name=name,
        about=about,
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
    """The calibrated intervals, and what the calibration says of a decision's spread.

    ``covered``: rows whose label is within its interval on all three axes.  ``above_threshold``: rows whose
    largest spread is above the threshold, for which the gate falls back: false alarms on a seen set,
    detections on an unseen one; None for a model without any spread.
    """

    covered: Proportion
    coverage: IntervalCoverage
    above_threshold: Proportion | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Figures:
    """One model on one set; lengths in metres.

    ``errors`` are against the labels that the model was trained for, ``noise_free`` against eq. 13 with
    the continuous optimum.  ``curves``: the share of labels (levels, 3) within the central interval of
    each level of ``LEVELS``, by scale.  ``auroc`` is that of the largest spread as a detector of this set
    against the seen one: None on a seen set, or if the model has no spread.
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
    """Whether its spread can be anything but zero."""
    return model.dropout is not Dropout.NONE or model.members > 1


def learns_noise_free(model: Model) -> bool:
    """Whether its card says that it was trained for the continuous optimum."""
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
    """The figures of ``model`` on each set; the first set is the seen one that others are told from.

    ModelError with ``place`` if an answer is not finite.
    """
    avoider = LearnedAvoider.from_model(model)
    seen_spread: Floats | None = None
    figures = []
    for one in sets:
        positions, spreads = avoider.propose_many(one.hands_in_base, one.tcps_in_base, one.decision_seeds)
        bad = np.flatnonzero(~np.isfinite(positions + spreads).all(axis=1))
        if len(bad):
            hand, tcp = one.hands_in_base[bad[0]].tolist(), one.tcps_in_base[bad[0]].tolist()
            raise ModelError(
                place=place,
                expected=f"finite answers on the set {one.name!r}",
                got=f"{positions[bad[0]].tolist()} for hand {hand} and TCP {tcp}",
            )
        largest = largest_spread(spreads)
        if seen_spread is None:
            seen_spread = largest
        told = not one.seen and has_spread(model)
        labels = one.noise_free_in_base if learns_noise_free(model) else one.labels_in_base
        figures.append(
            Figures(
                model=label,
                set=one,
                errors=errors(positions, labels),
                noise_free=errors(positions, one.noise_free_in_base),
                picp=_picp(model, positions, labels, spreads),
                curves=_curves(model, positions, labels, spreads),
                median_largest_spread_m=float(np.median(largest)),
                intervals=_intervals(model, positions, labels, spreads),
                auroc=auroc(seen_spread, largest) if told else None,
                unreachable=Proportion.of(~reachable(positions, settings, robot)),
            )
        )
    return figures


def _recipe(model: Model) -> Mapping[str, Any]:
    """What the card says of the training; empty for a card that is not ours."""
    recipe = model.card.get("recipe")
    return recipe if isinstance(recipe, dict) else {}


def _residual_std(model: Model) -> Floats | None:
    return None if model.calibration is None else np.array(model.calibration.residual_std_m)


def _picp(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, IntervalCoverage]:
    """The readings of the paper's PICP; without a calibration the one with residuals is left out.

    ``positions``, ``labels`` and ``spreads`` are (n, 3) [m].
    """
    per_mm2 = _recipe(model).get("precision_per_mm2")
    known = isinstance(per_mm2, int | float) and per_mm2 > 0.0
    precision_per_m2 = 1e6 * (float(per_mm2) if known else PAPER_PRECISION_PER_MM2)  # type: ignore[arg-type]
    return picp_variants(
        positions, labels, spreads, precision=precision_per_m2, residual_std=_residual_std(model)
    )


def _curves(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, Floats]:
    """By scale, the calibration curve of ``positions``, ``labels`` and ``spreads`` (n, 3) [m]."""
    levels, residual_std = np.array(LEVELS), _residual_std(model)
    curves = {"spread": calibration_curve(positions, labels, spreads, levels)}
    if residual_std is not None:
        scale = interval_scale(spreads, residual_std)
        curves[RESIDUALS] = calibration_curve(positions, labels, scale, levels)
    return curves


def _intervals(
    model: Model, positions: Floats, labels: Floats, spreads: Floats
) -> CalibratedIntervals | None:
    """Of ``positions``, ``labels`` and ``spreads`` (n, 3) [m]; None for a model without a calibration."""
    calibration = model.calibration
    if calibration is None:
        return None
    scale = interval_scale(spreads, np.array(calibration.residual_std_m))
    half_widths = calibration.interval_multiplier * scale
    above = np.asarray(largest_spread(spreads) > calibration.spread_threshold_m)
    inside: NDArray[np.bool_] = np.all(np.abs(positions - labels) <= half_widths, axis=-1)
    return CalibratedIntervals(
        covered=Proportion.of(inside),
        coverage=coverage(positions, labels, half_widths),
        above_threshold=Proportion.of(above) if has_spread(model) else None,
    )
