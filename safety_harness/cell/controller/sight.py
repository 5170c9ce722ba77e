"""What an avoider that sees more is shown of what the control stack has seen, when it is asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.controller.records import ObservationRecords
from safety_harness.cell.controller.seeing import SeenRecords, show
from safety_harness.seams.contract import OBJECT, PREDICTED_HANDS, Seen
from safety_harness.seams.rows import SeenLayout, seen_dtype


@dataclass(frozen=True, eq=False)
class Sight:
    """For one episode; ``layout`` knows the words that the avoider sees."""

    layout: SeenLayout
    period_s: float

    @classmethod
    def of(cls, sees: tuple[str, ...], hand_slots: int, joints: int, period_s: float) -> Sight | None:
        """None for an avoider that sees no more than it is asked."""
        return cls(SeenLayout(hand_slots, joints, sees), period_s) if sees else None

    def seen(self, r: ControllerRecords, observation: ObservationRecords) -> Seen:
        """Of now.  Hands of the last frame are placed by the sensor's pose of now."""
        layout = self.layout
        seen = SeenRecords(np.zeros(1, seen_dtype(layout.hand_slots, layout.joints)))
        wants = OBJECT in layout.sees, PREDICTED_HANDS in layout.sees
        show(r.parameters, r.filter_parameters, r.state, r.tracks, observation, seen, True, *wants)
        row = seen.view(np.float64)[: layout.wanted].copy()
        row.flags.writeable = False
        return Seen.of_row(float(row[0]), self.period_s, layout, row)
