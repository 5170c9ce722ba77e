"""Many episodes in the kinematic world: all of them to their next decision, then the avoider once for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking_many import ask_many
from safety_harness.controller.controller import AvoidingServo
from safety_harness.scenario.model import Scenario
from safety_harness.simulation.kinematic_world import KinematicWorld, advance
from safety_harness.trace.provenance import provenance
from safety_harness.trace.records import TICK, TICK_COMPILED
from safety_harness.trace.trace import Trace


@dataclass(eq=False)
class Episode:
    """A scenario under way, with a world and a controller of its own."""

    scenario: Scenario
    world: KinematicWorld
    controller: AvoidingServo
    ticks: NDArray[np.void] = field(init=False)  # (n,) TICK
    deciding: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        self.ticks = np.zeros(self.scenario.ticks + 1, TICK)

    def advance(self) -> bool:
        """On to the next decision (True) or to the end (False)."""
        ticks = self.ticks.view(TICK_COMPILED)
        self.deciding = advance(self.world.records, self.controller.records, ticks, self.deciding)
        return self.deciding

    def trace(self) -> Trace:
        """What happened, when it has come to its end."""
        return Trace(
            scenario=self.scenario,
            ticks=self.ticks,
            decisions=self.controller.decisions,
            decision_latency_s=self.controller.decision_latencies_s,
            provenance=provenance(self.world.name, self.controller.name),
        )


def simulate_many(episodes: Sequence[Episode]) -> list[Trace]:
    """Run them all to their ends; each trace is that of ``simulate`` in the same world, bit for bit.

    But for their latency: that of decisions that are made together is NaN, not timed (``ask_many``).
    """
    under_way = list(episodes)
    while under_way:
        under_way = [episode for episode in under_way if episode.advance()]
        pilots = [episode.controller for episode in under_way]
        queries = [episode.controller.query(episode.world.records.observation) for episode in under_way]
        answers = ask_many([pilot.asked() for pilot in pilots], queries)
        for pilot, query, answer in zip(pilots, queries, answers, strict=True):
            pilot.decide(query, pilot.gate.rule_on(answer, query))
    return [episode.trace() for episode in episodes]
