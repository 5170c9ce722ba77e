"""The paper's other outlook, tried: with two hands, trigger by the distance of the TCP from a plane.

The paper says no more than "formulating a plane".  Two readings: the vertical plane through both predicted
hands, without end; and a wall, the part of it between the two hands' verticals.  While only one hand is
predicted, the distance from it triggers as always.  The trigger alone is exchanged: avoider, gate and control
stack are the system's own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.settings import Settings
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import Controller
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.cell.simulation.simulate import simulate
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.space.read import parse_space
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace
from safety_harness_paper.networks import avoider_in
from safety_harness_paper.safety import CLEAR_M, RIGHT_HAND
from safety_harness_paper.work import Done, Json, Task

EITHER, PLANE, WALL = "distance from the nearer hand", "distance from the plane", "distance from the wall"
TRIGGERS = (EITHER, PLANE, WALL)
ALWAYS_M, NEVER_M = 1e3, 0.0  # critical distances within which any hand is, or none
_DRAW = 7

SPACE = f"""\
scenario space: two hands of one person come near, stay and leave
about: both hands as in the nominal space, each on its own
duration: 10 s
avoider: opposite pose
tcp start:
  offset: {{in: seen tcp}}
hands:
{RIGHT_HAND}  - hand: left hand
    starts at: [1500 mm, -700 mm, 400 mm]
    elbow towards: [1900 mm, -1000 mm, 400 mm]
    moves:
      - wait: from 100 ms to 2 s
      - move to: {{in: seen hand}}
        speed: from 0.2 m/s to 1.6 m/s
      - wait: from 100 ms to 2 s
      - withdraw: from 0.2 m/s to 1.6 m/s
claims:
  repulsive poses reachable: holds
"""


def measurement(bayesian: Task, *, episodes: int, root: int, settings: Settings) -> Task:
    """The same draws with each trigger."""
    return Task(
        "two hands and a plane",
        measure,
        (("episodes", episodes), ("draw_seed", leaf(root, _DRAW)), ("settings", settings)),
        (bayesian,),
        seconds=5.0 + 1.5 * episodes,
    )


def measure(folder: Path, bayesian: Done, *, episodes: int, draw_seed: int, settings: Settings) -> Json:
    """{trigger: one entry an episode}."""
    avoider = avoider_in(bayesian)
    claim = HandDistance(minimum_m=CLEAR_M, near_m=settings.avoidance.critical_distance_m)
    found: dict[str, list[Json]] = {trigger: [] for trigger in TRIGGERS}
    for scenario in draw_admissible(parse_space(SPACE), draw_seed, episodes).scenarios:
        start = admit(replace(scenario, settings=settings), avoider=avoider)
        for trigger in TRIGGERS:
            trace = _run(start, trigger)
            found[trigger].append(_about(trace, claim))
    return {"triggers": found}


def _run(start: Admitted, trigger: str) -> Trace:
    controller: Controller = start.controller()
    if trigger != EITHER:
        controller = _PlaneTriggered(start, wall=trigger == WALL)
    with PyBulletWorld(start.scenario, start.arm, start.joint_position_rad) as world:
        return simulate(world, controller, start.scenario)


def _about(trace: Trace, claim: HandDistance) -> Json:
    judged = claim.evaluate(trace)
    modes, decisions = trace.ticks["mode"], trace.decisions
    first: Any = None if not len(decisions) else float(decisions["time_s"][0])
    return {
        "verdict": judged.verdict.value,
        "margin_m": judged.margin,
        "decisions": len(decisions),
        "first_decision_s": first,
        "share_stopped": float((modes == Mode.PROTECTIVE_STOP).mean()),
        "share_servoing": float((modes == Mode.SERVOING).mean()),
    }


class _PlaneTriggered(ControllerWrapper):
    """The system with its critical distance open while the TCP is near the plane, and shut while it is not.

    The hands are those predicted at the tick before, 8 ms ago.
    """

    def __init__(self, start: Admitted, *, wall: bool) -> None:
        super().__init__(start.servo())
        self._wall = wall
        self._critical_m = start.scenario.settings.avoidance.critical_distance_m

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Open or shut, then as always."""
        records = self.pilot.records
        state = records.state[0]
        hands = state["predicted_hand_in_base_m"][state["track_valid"] != 0]
        critical_m = self._critical_m
        if len(hands) >= 2:
            tcp = state["transform_tcp_to_base"][:3, 3]
            near = plane_distance(tcp, hands[0], hands[1], wall=self._wall) < self._critical_m
            critical_m = ALWAYS_M if near else NEVER_M
        records.parameters["critical_distance_m"] = critical_m
        return super().step(observation)


def plane_distance(
    point: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64], *, wall: bool
) -> float:
    """Distance [m] of a point (3,) from the vertical plane through two others, or from its part between them.

    Two hands above each other have no such plane: then it is their vertical's.
    """
    along = (second - first)[:2]
    length = float(np.linalg.norm(along))
    way = (point - first)[:2]
    if length == 0.0:
        return float(np.linalg.norm(way))
    part = float(way @ along) / length**2
    if wall:
        part = min(max(part, 0.0), 1.0)
    return float(np.linalg.norm(way - part * along))
