"""The kill table as rows of words, for terminal, page and docs."""

from __future__ import annotations

from collections.abc import Sequence

from safety_harness.certification.tools import FaultState
from safety_harness.report.words import count_words
from safety_harness.selftest.outcome import FaultOutcome, SelfTestTally
from safety_harness.selftest.trial import Geometry

HEAD = ("part", "fault", "caught by", "in", "episodes", "slightest caught", "survives", "PyBullet")
HARMLESS_HEAD = ("part", "change", "why it cannot matter", "episodes", "alarms", "hand distance by PyBullet")
NONE = "-"


def row(one: FaultOutcome) -> tuple[str, ...]:
    """A fault's row under HEAD."""
    smallest, alarm, survivor = one.smallest, one.alarm, one.survivor
    first = one.rungs[0] if one.rungs else None
    if smallest is None or alarm is None or first is None:
        tried = str(first.episodes) if first else "0"
        words = f"{one.state.value}: {one.limit}" if one.limit else one.state.value
        return (one.part, one.fault, words, NONE, tried, NONE, first.words if first else NONE, NONE)
    return (
        one.part,
        one.fault,
        alarm.claim,
        alarm.scenario,
        str(smallest.episodes),
        smallest.words,
        survivor.words if survivor else NONE,
        {True: "too", False: "not there", None: "not asked"}[one.confirmed],
    )


def harmless_row(one: FaultOutcome) -> tuple[str, ...]:
    """A harmless change's row under HARMLESS_HEAD."""
    alarms = [str(alarm) for rung in one.rungs for alarm in rung.alarms]
    episodes = sum(rung.episodes for rung in one.rungs)
    geometry = "; ".join(geometry_words(rung.geometry) for rung in one.rungs if rung.geometry) or NONE
    return (one.part, one.fault, one.harmless, str(episodes), "; ".join(alarms) or "none", geometry)


def geometry_words(found: Geometry) -> str:
    """How often it is kept and broken, and where our verdict is the opposite."""
    words = f"kept in {found.kept} of {found.runs}, broken in {found.broken}"
    return f"{words}, to the contrary in {', '.join(found.contradicted)}" if found.contradicted else words


def summary(tally: SelfTestTally) -> str:
    """One line."""
    words = f"{tally.caught} of {count_words(tally.faults, 'fault', 'faults')} caught ({tally.kill_rate:.0%})"
    words += f", {tally.rungs_caught} of {tally.rungs} magnitudes tried"
    if tally.limits:
        words += f"; {count_words(tally.limits, 'survivor', 'survivors')} by a stated limit"
    if tally.survivors:
        words += f"; {count_words(tally.survivors, 'survivor', 'survivors')}"
    words += f"; {count_words(tally.false_alarms, 'false alarm', 'false alarms')} on "
    words += count_words(tally.harmless, "harmless change", "harmless changes")
    if tally.true_alarms:
        words += f", {count_words(tally.true_alarms, 'true alarm', 'true alarms')}"
    if tally.geometry_runs:
        contradicted = tally.geometry_contradicted or "none"
        words += f"; PyBullet's geometry contradicts {contradicted} of {tally.geometry_runs} hand distances"
    if tally.unconfirmed:
        words += f"; {tally.unconfirmed} not seen in PyBullet"
    return words


def lines(head: Sequence[str], rows: Sequence[Sequence[str]], most: int = 60) -> list[str]:
    """Aligned columns for a terminal; long cells are cut.  None without rows."""
    if not rows:
        return []
    cells = [
        [cell if len(cell) <= most else cell[: most - 3] + "..." for cell in one] for one in (head, *rows)
    ]
    widths = [max(len(one[column]) for one in cells) for column in range(len(head))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(one, widths, strict=True)).rstrip()
        for one in cells
    ]


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The same for the docs."""
    written = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return written + ["| " + " | ".join(cell.replace("|", "\\|") for cell in one) + " |" for one in rows]


def in_table(outcomes: Sequence[FaultOutcome]) -> tuple[list[FaultOutcome], list[FaultOutcome]]:
    """Faults and harmless changes."""
    faults = [one for one in outcomes if not one.harmless]
    return faults, [one for one in outcomes if one.harmless]


def bad(outcomes: Sequence[FaultOutcome]) -> list[FaultOutcome]:
    """What speaks against the harness: survivors without a stated limit, and false alarms."""
    return [one for one in outcomes if one.state in (FaultState.SURVIVES, FaultState.FALSE_ALARM)]
