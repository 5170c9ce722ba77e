"""State the measured quantities of a trace with their sources and uncertainties, as words and as data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from safety_harness.claims.properties.base import Evaluation
from safety_harness.report.words import setting_words
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, OF_DECISIONS, Gap, Measurement, Source
from safety_harness.trace.trace import Trace

MOST_GAPS = 3  # gaps of one column that are listed
ALL_OF_DECISIONS = frozenset(name for name in COLUMNS_OF_A_TRACE if name.startswith(OF_DECISIONS))


@dataclass(frozen=True)
class MeasuredRow:
    """Columns of a trace that have the same source, uncertainty and gaps."""

    columns: tuple[str, ...]
    source: str
    within: str
    gaps: str

    @property
    def summary(self) -> str:
        """Return the row as one line, which may be long."""
        how = f"{self.source}, within {self.within}" if self.within else self.source
        gaps = f"; not measured {self.gaps}" if self.gaps else ""
        return f"{how}: {', '.join(self.columns)}{gaps}"


def measured_rows(trace: Trace) -> list[MeasuredRow]:
    """Return a row for each source of measurement. If the whole trace is simulated truth, return no row.

    The row of the unmeasured columns comes last.
    """
    if trace.known.simulated:
        return []
    groups: dict[tuple[bool, str, str, str], list[str]] = {}
    for name in COLUMNS_OF_A_TRACE:
        fact = trace.known.column(name)
        key = (fact.source is Source.NONE, fact.source.value, _accuracy(name, fact), _gaps(trace, fact.gaps))
        groups.setdefault(key, []).append(name)
    rest = (Source.SIMULATED.value, "", "")
    return [
        MeasuredRow(("all else",) if key[1:] == rest else _short(names), *key[1:])
        for key, names in sorted(groups.items(), key=lambda item: (item[0][0], item[0][1:] == rest))
    ]


def measured_lines(trace: Trace) -> list[str]:
    """Return the rows of ``measured_rows`` as lines, under the name of the run.

    There is no line if the whole trace is simulated truth.
    """
    rows = measured_rows(trace)
    head = [f"what was measured of {trace.scenario.name}:"] if rows else []
    return head + [f"  {row.summary}" for row in rows]


def known_data(trace: Trace) -> dict[str, Any]:
    """Return the source, uncertainty [SI] and gaps [ticks] of each column that is not simulated, for JSON."""
    return {
        name: {
            "source": fact.source.value,
            "uncertainty_si": fact.uncertainty,
            "gaps": [
                {"first_tick": gap.first, "after_tick": gap.after, "hand": gap.hand} for gap in fact.gaps
            ],
        }
        for name, fact in trace.known.columns.items()
        if fact != Measurement()
    }


def unmeasured_words(evaluations: Iterable[Evaluation]) -> str:
    """Return a text that states how many evaluations lacked measurements and how many were never exercised.

    The text is empty if no evaluation lacks measurements.
    """
    every = list(evaluations)
    unmeasured = sum(bool(item.unmeasured) for item in every)
    idle = sum(item.reason.startswith("never exercised") for item in every)
    counts = ((unmeasured, "not measured"), (idle, "never exercised"))
    return ", ".join(f"{count} {reason}" for count, reason in counts if count) if unmeasured else ""


def _short(names: list[str]) -> tuple[str, ...]:
    """Return the column names, but replace the names of all decision columns by one common name."""
    if not ALL_OF_DECISIONS.issubset(names):
        return tuple(names)
    return (*(name for name in names if name not in ALL_OF_DECISIONS), "all of decisions")


def _accuracy(name: str, fact: Measurement) -> str:
    if fact.uncertainty == 0.0:
        return ""
    return setting_words("position_m" if name.startswith("transform") else name, fact.uncertainty)


def _gaps(trace: Trace, gaps: tuple[Gap, ...]) -> str:
    """Return a text that lists the times of the gaps.

    If a gap concerns only one hand, the text states the name of this hand.
    """
    hands, period_s = trace.scenario.hands, trace.scenario.settings.clock.control_period_s
    times = []
    for gap in gaps[:MOST_GAPS]:
        owner = "" if gap.hand is None else f" of hand {gap.hand + 1}"
        if gap.hand is not None and gap.hand < len(hands):
            owner = f" of {hands[gap.hand].name}"
        end_s = min(gap.after, len(trace.ticks)) * period_s
        times.append(f"from {gap.first * period_s:.3f} to {end_s:.3f} s{owner}")
    return ", ".join(times) + (f" and in {len(gaps) - MOST_GAPS} other gaps" if len(gaps) > MOST_GAPS else "")
