"""One row of the table of ratios that the benchmarks share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Ratio:
    """A ratio formed within each turn of both sides: median, least and greatest.

    ``aim`` is the least median that is good enough, ``at_most`` turns that round; a row that could not be
    measured has a NaN and says why in ``note``.
    """

    what: str
    value: float
    least: float
    greatest: float
    aim: float | None = None
    at_most: bool = False
    note: str = ""

    @classmethod
    def of(
        cls,
        what: str,
        values: Sequence[float],
        *,
        aim: float | None = None,
        at_most: bool = False,
        note: str = "",
    ) -> Ratio:
        """From one value a turn; ValueError without any, or for what is no ratio."""
        if not values or not all(math.isfinite(v) and v > 0.0 for v in values):
            raise ValueError(f"{what}: expected finite ratios above 0, got {list(values)}")
        return cls(what, median(values), min(values), max(values), aim, at_most, note)

    @classmethod
    def missing(cls, what: str, why: str) -> Ratio:
        """One that could not be measured."""
        return cls(what, math.nan, math.nan, math.nan, note=why)

    @property
    def verdict(self) -> str:
        """Whether the aim is met; a NaN never does."""
        if math.isnan(self.value):
            return "not measured"
        if self.aim is None:
            return ""
        good = self.value <= self.aim if self.at_most else self.value >= self.aim
        return "met" if good else "NOT MET"

    @property
    def aimed(self) -> str:
        """The aim in words."""
        return "" if self.aim is None else f"{'at most' if self.at_most else 'at least'} {self.aim:g}"

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"{self.what}: {self.verdict}: {self.note}"
        spread = f"{shown(self.value)} ({shown(self.least)} to {shown(self.greatest)})"
        words = (f"{self.what}: {spread}", self.aimed, self.verdict, self.note)
        return "; ".join(word for word in words if word)


def shown(value: float) -> str:
    """Three digits, or whole numbers from 100 on."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def say(name: str, values: Sequence[float], unit: str) -> None:
    """A line: median (least to greatest)."""
    print(f"  {name:<44}{median(values):10.2f} ({min(values):.2f} to {max(values):.2f}) {unit}", flush=True)
