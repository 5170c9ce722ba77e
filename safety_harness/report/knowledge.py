"""Return the sources and uncertainties of a trace's columns, as words and as data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from safety_harness.claims.properties.base import Evaluation
from safety_harness.report.words import setting_words
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, OF_DECISIONS, Gap, Measurement, Source
from safety_harness.trace.trace import Trace

MOST_GAPS = 3  # of one column that are told
ALL_OF_DECISIONS = frozenset(name for name in COLUMNS_OF_A_TRACE if name.startswith(OF_DECISIONS))


@dataclass(frozen=True)
class MeasuredRow:
    """Columns with the same source, uncertainty and gaps."""

    columns: tuple[str, ...]
    source: str
    within: str
    gaps: str

    @property
    def words(self) -> str:
        """One line, which may be long."""
        how = f"{self.source}, within {self.within}" if self.within else self.source
        gaps = f"; not measured {self.gaps}" if self.gaps else ""
        return f"{how}: {', '.join(self.columns)}{gaps}"


def measured_rows(trace: Trace) -> list[MeasuredRow]:
    """Return a row for each source, unmeasured columns last; empty if all is simulated truth."""
    if trace.known.simulated:
        return []
    groups: dict[tuple[bool, str, str, str], list[str]] = {}
    for name in COLUMNS_OF_A_TRACE:
        one = trace.known.of(name)
        key = (one.source is Source.NONE, one.source.value, _within(name, one), _gaps(trace, one.gaps))
        groups.setdefault(key, []).append(name)
    rest = (Source.SIMULATED.value, "", "")
    return [
        MeasuredRow(("all else",) if key[1:] == rest else _short(names), *key[1:])
        for key, names in sorted(groups.items(), key=lambda item: (item[0][0], item[0][1:] == rest))
    ]


def measured_lines(trace: Trace) -> list[str]:
    """Return the rows below the run's name; empty if all is simulated truth."""
    rows = measured_rows(trace)
    return (
        [f"what was measured of {trace.scenario.name}:", *(f"  {row.words}" for row in rows)] if rows else []
    )


def known_data(trace: Trace) -> dict[str, Any]:
    """Return source, uncertainty [SI] and gaps in ticks of each column that is not simulated truth."""
    return {
        name: {
            "source": one.source.value,
            "uncertainty_si": one.uncertainty,
            "gaps": [
                {"first_tick": gap.first, "after_tick": gap.after, "hand": gap.hand} for gap in one.gaps
            ],
        }
        for name, one in trace.known.columns.items()
        if one != Measurement()
    }


def unmeasured_words(evaluations: Iterable[Evaluation]) -> str:
    """Count inconclusive claims without measurements and without exercise in words; empty for none."""
    every = list(evaluations)
    unmeasured = sum(bool(one.unmeasured) for one in every)
    idle = sum(one.reason.startswith("never exercised") for one in every)
    words = ((unmeasured, "not measured"), (idle, "never exercised"))
    return ", ".join(f"{count} {what}" for count, what in words if count) if unmeasured else ""


def _short(names: list[str]) -> tuple[str, ...]:
    """All that is of decisions in one word."""
    if not ALL_OF_DECISIONS.issubset(names):
        return tuple(names)
    return (*(name for name in names if name not in ALL_OF_DECISIONS), "all of decisions")


def _within(name: str, one: Measurement) -> str:
    if one.uncertainty == 0.0:
        return ""
    return setting_words("position_m" if name.startswith("transform") else name, one.uncertainty)


def _gaps(trace: Trace, gaps: tuple[Gap, ...]) -> str:
    """When, and of which hand."""
    hands, period_s = trace.scenario.hands, trace.scenario.settings.clock.control_period_s
    found = []
    for gap in gaps[:MOST_GAPS]:
        whose = "" if gap.hand is None else f" of hand {gap.hand + 1}"
        if gap.hand is not None and gap.hand < len(hands):
            whose = f" of {hands[gap.hand].name}"
        after = min(gap.after, len(trace.ticks)) * period_s
        found.append(f"from {gap.first * period_s:.3f} to {after:.3f} s{whose}")
    return ", ".join(found) + (f" and in {len(gaps) - MOST_GAPS} other gaps" if len(gaps) > MOST_GAPS else "")
