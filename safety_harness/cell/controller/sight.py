"""Give an avoider with ``sees`` its view.

The view is a part of the control stack's perception at the time of the question.
"""

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
    """The view of an avoider in an episode.

    ``layout`` contains the names of the quantities that the avoider sees.
    """

    layout: SeenLayout
    period_s: float

    @classmethod
    def from_words(cls, sees: tuple[str, ...], hand_slots: int, joints: int, period_s: float) -> Sight | None:
        """Return the ``Sight`` of an avoider that sees the quantities ``sees``.

        Return None if ``sees`` is empty.
        """
        return cls(SeenLayout(hand_slots, joints, sees), period_s) if sees else None

    def seen(self, r: ControllerRecords, observation: ObservationRecords) -> Seen:
        """Return the present view.

        The positions of the hands come from the last frame and the sensor's present pose.
        """
        layout = self.layout
        seen = SeenRecords(np.zeros(1, seen_dtype(layout.hand_slots, layout.joints)))
        wants = OBJECT in layout.sees, PREDICTED_HANDS in layout.sees
        show(r.parameters, r.filter_parameters, r.state, r.tracks, observation, seen, True, *wants)
        row = seen.view(np.float64)[: layout.wanted].copy()
        row.flags.writeable = False
        return Seen.of_row(float(row[0]), self.period_s, layout, row)
