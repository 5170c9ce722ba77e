"""The whole system on one page: a world and a controller, tick by tick, into a trace."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safety_harness.controller.controller import Controller
from safety_harness.scenario.model import Scenario
from safety_harness.simulation.world import World
from safety_harness.trace.provenance import provenance
from safety_harness.trace.records import TICK, Limit
from safety_harness.trace.trace import Trace

INTERRUPTED = "interrupted by the user"


def simulate(
    world: World,
    controller: Controller,
    scenario: Scenario,
    *,
    on_tick: Callable[[int], None] | None = None,
) -> Trace:
    """Run ``scenario`` to its end; both ends of its duration are recorded.

    ``on_tick`` is told the number of ticks done, for progress.  Ctrl-C between ticks ends the run
    early: the trace then says that it was interrupted, and no property takes it for a safe one.
    """
    ticks = np.zeros(scenario.ticks + 1, TICK)
    done, ended = 0, "complete"
    try:
        for k in range(len(ticks)):
            tick = ticks[k : k + 1]
            world.true_state(tick)
            command = controller.step(world.observe())
            controller.report(tick)
            if k < scenario.ticks and world.step(command):
                tick["limits"] |= int(Limit.BRAKING)
            tick["faults"] |= world.acted_faults
            done = k + 1
            if on_tick is not None:
                on_tick(done)
    except KeyboardInterrupt:
        ended = INTERRUPTED
    decisions = controller.decisions
    decisions = decisions[decisions["tick"] < done]  # not one of a tick that Ctrl-C cut short
    return Trace(
        scenario=scenario,
        ticks=ticks[:done],  # no copy: that would fill the padding between fields with anything
        decisions=decisions,
        decision_latency_s=controller.decision_latencies_s[: len(decisions)],
        provenance=provenance(world.name, controller.name),
        ended=ended,
    )
