"""Format the figures of an evaluation as text tables.

A table has one row for each pair of a model and an evaluation set. Lengths are in millimetres.
"""

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
VARIANTS = {  # variants of the PICP: the name in the figures, and the name in the table
    "spread": "spread",
    RESIDUALS: "and residuals",
    "spread and 1/tau": "and 1/tau",
    "eq. 11 as printed": "eq. 11",
}
Row = tuple[str, ...]


def tables(figures: Sequence[Figures]) -> Iterator[str]:
    """Yield the lines of four tables: errors, 95 % intervals, spreads and calibration curves."""
    order = list(dict.fromkeys(item.set.name for item in figures))
    by_set = sorted(figures, key=lambda item: order.index(item.set.name))
    yield from titled(
        "Errors [mm]; noise-free: RMSE against the continuous optimum; floor: error by the labels' noise",
        ("set", "model", "RMSE x", "y", "z", "all", "MAE x", "y", "z", "all", "noise-free", "unreachable"),
        _error_rows(by_set),
    )
    yield from titled(
        "95 % intervals: labels within the calibrated ones on all axes at once, [exact 95 % limits], "
        "mean whole width [mm]; PICP (mean of axes) of +- 1.96 times ...",
        ("set", "model", "covered", "", "width x", "y", "z", *VARIANTS.values()),
        (_interval_row(item) for item in by_set),
    )
    yield from titled(
        "Doubt: a decision's largest spread [mm], its AUROC as a detector of the unseen, and the share "
        "above the threshold (false fallbacks if seen, detections if unseen)",
        ("set", "model", "median spread", "AUROC", "above threshold", ""),
        (_doubt_row(item) for item in by_set),
    )
    yield from titled(
        "Calibration curve: share of labels (mean of axes) in the central interval of each level",
        ("set", "model", "scale", *(f"{level:.0%}" for level in LEVELS)),
        (row for item in by_set for row in _curve_rows(item)),
    )


def _error_rows(by_set: Sequence[Figures]) -> Iterator[Row]:
    """Yield the rows of the table of errors.

    For each set, the row of the least possible error (the floor) precedes the rows of the models.
    """
    last = None
    for item in by_set:
        if item.set.name != last and item.set.floor is not None:
            yield item.set.name, "(floor)", *_floor(item.set.floor), NONE, NONE
        last = item.set.name
        yield (
            item.set.name,
            item.model,
            *_both(item.errors),
            _mm(item.noise_free.overall_rmse),
            _percent(item.unreachable.share),
        )


def _floor(floor: LabelFloor) -> Row:
    """Return the table cells with the least possible RMSE and MAE on a set."""
    rmse, mae = np.array(floor.rmse_m), np.array(floor.mae_m)
    overall = float(np.sqrt((rmse**2).mean()))
    return *map(_mm, floor.rmse_m), _mm(overall), *map(_mm, floor.mae_m), _mm(float(mae.mean()))


def _both(errors: Errors) -> Row:
    """Return the table cells with the RMSE and MAE of a model."""
    rmse, mae = map(_mm, errors.rmse.tolist()), map(_mm, errors.mae.tolist())
    return *rmse, _mm(errors.overall_rmse), *mae, _mm(errors.overall_mae)


def _interval_row(item: Figures) -> Row:
    """Return the table row with the interval coverage of one model on one set."""
    picp = tuple(_mean_picp(item.picp.get(name)) for name in VARIANTS)
    if item.intervals is None:
        return item.set.name, item.model, NONE, NONE, NONE, NONE, NONE, *picp
    widths = map(_mm, item.intervals.coverage.mean_width.tolist())
    return item.set.name, item.model, *_with_limits(item.intervals.covered), *widths, *picp


def _doubt_row(item: Figures) -> Row:
    """Return the table row with the spread of one model on one set."""
    above = None if item.intervals is None else item.intervals.above_threshold
    return (
        item.set.name,
        item.model,
        _mm(item.median_largest_spread_m),
        NONE if item.auroc is None else f"{item.auroc:.3f}",
        *((NONE, NONE) if above is None else _with_limits(above)),
    )


def _curve_rows(item: Figures) -> Iterator[Row]:
    """Yield one row with the calibration curve for each interval scale."""
    for name, curve in item.curves.items():
        yield item.set.name, item.model, VARIANTS[name], *map(_percent, curve.mean(axis=1).tolist())


def _mean_picp(coverage: IntervalCoverage | None) -> str:
    return NONE if coverage is None else _percent(float(coverage.picp.mean()))


def _with_limits(share: Proportion) -> tuple[str, str]:
    return _percent(share.share), f"[{100 * share.low:.1f}, {100 * share.high:.1f}]"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}%"


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.2f}"


def titled(title: str, header: Row, rows: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of a table, preceded by its title.

    Args:
        title: The title.
        header: The names of the columns.
        rows: The rows.

    """
    yield from ("", title, *table(header, rows, columns_of(sys.stdout), right=range(2, len(header))))
