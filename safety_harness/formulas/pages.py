"""The signals as the documentation lists them."""

from __future__ import annotations

from collections.abc import Sequence

from safety_harness.formulas.signal import Signal
from safety_harness.formulas.signals import SIGNALS

_UNIT = "true or false"


def markdown_of_signals(signals: Sequence[Signal] = SIGNALS) -> str:
    """A row for each signal: its words and Python name, units, meaning, what is known between ticks."""
    rows = ["| words | in Python | units | what it is | between ticks |", "|---|---|---|---|---|"]
    for signal in signals:
        units = ", ".join(signal.dimension.units) or "a plain number" if signal.dimension else _UNIT
        cells = (
            f"`{signal.words}`",
            f"`{python_name(signal)}()`",
            units,
            signal.meaning,
            signal.between.value,
        )
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def python_name(signal: Signal) -> str:
    """What ``formulas.language`` calls it."""
    return signal.words.lower().replace(" ", "_")
