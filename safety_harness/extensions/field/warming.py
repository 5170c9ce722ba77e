"""Compile the code that a monitor needs in addition to the code for runs and their verdicts."""

from __future__ import annotations

from safety_harness.extensions.field.monitoring.cell import cell_taken
from safety_harness.extensions.field.monitoring.monitor import Monitor
from safety_harness.extensions.field.monitoring.sample import HandSample, Sample, line_of

WATCHED = (
    "always (within 80 ms hand distance > 50 mm)",
    "whenever hand distance < 300 mm then within 80 ms TCP speed < 100 mm/s",
)


def warm_monitor() -> None:
    """Run the monitor once, so that its code for operators with and without time windows is compiled."""
    own = Monitor(cell=cell_taken("UR10", ["hand"], "8 ms", WATCHED))
    places = HandSample((0.9, 0.2, 0.4), (1.2, 0.2, 0.5))
    for tick in range(60):
        hands: dict[str, HandSample | None] = {"hand": places} if tick % 4 == 0 else {}
        list(own.take(line_of(Sample(tick * 0.008, (0.0, -1.3, 2.0, -2.3, -1.6, 0.0), hands=hands))))
