"""The figures of an evaluation as plain tables: one row a set and model, lengths in millimetres."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from safety_harness.base.proportions import Proportion
from safety_harness.claims.properties.tally import table
from safety_harness.cli.console import columns_of
from safety_harness.extensions.lab.learning.dataset import LabelFloor
from safety_harness.extensions.lab.learning.evaluation import LEVELS, Figures
from safety_harness.extensions.lab.learning.metrics import RESIDUALS, Errors, IntervalCoverage

NONE = "-"
VARIANTS = {  # of the PICP: the name in the figures, and in the table
    "spread": "spread",
    RESIDUALS: "and residuals",
    "spread and 1/tau": "and 1/tau",
    "eq. 11 as printed": "eq. 11",
}
Row = tuple[str, ...]


def tables(figures: Sequence[Figures]) -> Iterator[str]:
    """The lines of four tables: errors, 95 % intervals, doubt, calibration curve."""
    order = list(dict.fromkeys(one.set.name for one in figures))
    by_set = sorted(figures, key=lambda one: order.index(one.set.name))
    yield from titled(
        "Errors [mm]; noise-free: RMSE against the continuous optimum; floor: what the labels' noise leaves",
        ("set", "model", "RMSE x", "y", "z", "all", "MAE x", "y", "z", "all", "noise-free", "unreachable"),
        _error_rows(by_set),
    )
    yield from titled(
        "95 % intervals: labels within the calibrated ones on all axes at once, [exact 95 % limits], "
        "mean whole width [mm]; PICP (mean of axes) of +- 1.96 times ...",
        ("set", "model", "covered", "", "width x", "y", "z", *VARIANTS.values()),
        (_interval_row(one) for one in by_set),
    )
    yield from titled(
        "Doubt: a decision's largest spread [mm], as a detector of the unseen (AUROC), and above the "
        "threshold: false fallbacks if seen, detections if not",
        ("set", "model", "median spread", "AUROC", "above threshold", ""),
        (_doubt_row(one) for one in by_set),
    )
    yield from titled(
        "Calibration curve: share of labels (mean of axes) in the central interval of each level",
        ("set", "model", "scale", *(f"{level:.0%}" for level in LEVELS)),
        (row for one in by_set for row in _curve_rows(one)),
    )


def _error_rows(by_set: Sequence[Figures]) -> Iterator[Row]:
    """A set's floor stands before its models."""
    before = None
    for one in by_set:
        if one.set.name != before and one.set.floor is not None:
            yield one.set.name, "(floor)", *_floor(one.set.floor), NONE, NONE
        before = one.set.name
        yield (
            one.set.name,
            one.model,
            *_both(one.errors),
            _mm(one.noise_free.overall_rmse),
            _percent(one.unreachable.share),
        )


def _floor(floor: LabelFloor) -> Row:
    rmse, mae = np.array(floor.rmse_m), np.array(floor.mae_m)
    overall = float(np.sqrt((rmse**2).mean()))
    return *map(_mm, floor.rmse_m), _mm(overall), *map(_mm, floor.mae_m), _mm(float(mae.mean()))


def _both(found: Errors) -> Row:
    rmse, mae = map(_mm, found.rmse.tolist()), map(_mm, found.mae.tolist())
    return *rmse, _mm(found.overall_rmse), *mae, _mm(found.overall_mae)


def _interval_row(one: Figures) -> Row:
    picp = tuple(_mean_picp(one.picp.get(name)) for name in VARIANTS)
    if one.intervals is None:
        return one.set.name, one.model, NONE, NONE, NONE, NONE, NONE, *picp
    widths = map(_mm, one.intervals.coverage.mean_width.tolist())
    return one.set.name, one.model, *_with_limits(one.intervals.covered), *widths, *picp


def _doubt_row(one: Figures) -> Row:
    above = None if one.intervals is None else one.intervals.above_threshold
    return (
        one.set.name,
        one.model,
        _mm(one.median_largest_spread_m),
        NONE if one.auroc is None else f"{one.auroc:.3f}",
        *((NONE, NONE) if above is None else _with_limits(above)),
    )


def _curve_rows(one: Figures) -> Iterator[Row]:
    for name, curve in one.curves.items():
        yield one.set.name, one.model, VARIANTS[name], *map(_percent, curve.mean(axis=1).tolist())


def _mean_picp(found: IntervalCoverage | None) -> str:
    return NONE if found is None else _percent(float(found.picp.mean()))


def _with_limits(found: Proportion) -> tuple[str, str]:
    return _percent(found.share), f"[{100 * found.low:.1f}, {100 * found.high:.1f}]"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}%"


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.2f}"


def titled(title: str, header: Row, rows: Iterable[Row]) -> Iterator[str]:
    """A table below its title."""
    yield from ("", title, *table(header, rows, columns_of(sys.stdout), right=range(2, len(header))))
