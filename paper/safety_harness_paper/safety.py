"""What the paper does not ask: does giving way lead away from the hand, and does the whole keep clear?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.spaces import draw_admissible
from safety_harness.admission.trial import run_trial
from safety_harness.base.settings import GateKind, Settings
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.extensions.lab.learning.dataset import seen
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.space.read import parse_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace
from safety_harness_paper.avoiders import BAYESIAN, DNN, NONE, OPPOSITE, with_networks
from safety_harness_paper.networks import avoider_in
from safety_harness_paper.work import Done, Json, Task

CLEAR_M = 0.050
DISTANCE, SEPARATION, OWN_SPEEDS = (
    "hand distance never below 50 mm",
    "protective separation kept",
    "protective separation kept from hands at their own speeds",
)
NEAREST = "nearest.trace"  # in a measurement's folder: the episode in which a hand came nearest
NOWHERE_M = 1e-6  # a critical distance that no hand ever comes within
_DRAW, _EPISODES = 4, 5

RIGHT_HAND = """\
  - hand: right hand
    starts at: [1300 mm, -1000 mm, 400 mm]
    elbow towards: [1700 mm, -1300 mm, 400 mm]
    moves:
      - wait: from 100 ms to 2 s
      - move to: {in: seen hand}
        speed: from 0.2 m/s to 1.6 m/s
      - wait: from 100 ms to 2 s
      - withdraw: from 0.2 m/s to 1.6 m/s
"""
# The draws are those of scenarios/spaces/nominal.yaml, which a test holds it to.  Its claims are not judged
# here, nor is the one that a space has to have.
NOMINAL = f"""\
scenario space: a hand comes near, stays and leaves, all within what was seen in training
about: the paper's nominal setting as a space
duration: 10 s
avoider: opposite pose
tcp start:
  offset: {{in: seen tcp}}
hands:
{RIGHT_HAND}claims:
  repulsive poses reachable: holds
"""


def leading_away(models: tuple[Task, ...], *, pairs: int, root: int, k: int, settings: Settings) -> Task:
    """Hands and TCPs of the seen space, and where each system would go."""
    return Task(
        f"does giving way lead away, draw {k}",
        measure_ways,
        (("pairs", pairs), ("draw_seed", leaf(root, _DRAW, k)), ("settings", settings)),
        models,
        seconds=2.0 + 6e-4 * pairs,
    )


def measure_ways(folder: Path, *models: Done, pairs: int, draw_seed: int, settings: Settings) -> Json:
    """{system: {"all" and "near": counts}}; near are pairs within the critical distance."""
    space, rng = seen(settings), np.random.default_rng(draw_seed)
    tcps, hands = space.tcp.draw(rng, pairs), space.hand.draw(rng, pairs)
    before_m = np.linalg.norm(tcps - hands, axis=1)
    near = before_m < settings.avoidance.critical_distance_m
    found: dict[str, Any] = {}
    for name, avoider in with_networks(settings, *models).items():
        ends = _ends(avoider, hands, tcps)
        after_m = np.linalg.norm(ends - hands, axis=1)
        all_along = ((ends - tcps) * (tcps - hands)).sum(
            axis=1
        ) >= 0.0  # the distance is convex along the way
        found[name] = {
            which: {
                "pairs": int(np.count_nonzero(mask)),
                "farther": int(np.count_nonzero(after_m[mask] > before_m[mask])),
                "farther_all_along": int(np.count_nonzero(all_along[mask])),
                "under_250_mm": int(np.count_nonzero(after_m[mask] < 0.250)),
                "gained_m": float((after_m - before_m)[mask].mean()) if mask.any() else None,
            }
            for which, mask in (("all", np.ones(pairs, np.bool_)), ("near", near))
        }
    return found


def _ends(avoider: Avoider, hands: NDArray[np.float64], tcps: NDArray[np.float64]) -> NDArray[np.float64]:
    if isinstance(avoider, LearnedAvoider):
        return avoider.propose_many(hands, tcps, np.arange(len(hands), dtype=np.uint64))[0]
    return np.array(
        [
            avoider.propose(
                hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=number
            ).position_in_base_m
            for number, (hand, tcp) in enumerate(zip(hands, tcps, strict=True))
        ]
    )


SYSTEMS = (
    (f"{BAYESIAN}, full gate", BAYESIAN, GateKind.FULL),
    (f"{BAYESIAN}, reach gate", BAYESIAN, GateKind.REACH),
    (f"{DNN}, reach gate", DNN, GateKind.REACH),
    (f"{OPPOSITE}, full gate", OPPOSITE, GateKind.FULL),
    (NONE, NONE, GateKind.FULL),
)


def whole_behaviour(
    models: tuple[Task, ...], *, episodes: int, root: int, system: int, settings: Settings
) -> Task:
    """Episodes of the nominal hand space in PyBullet with one of ``SYSTEMS``, the same draws for each."""
    return Task(
        f"nominal hand space: {SYSTEMS[system][0]}",
        measure_episodes,
        (
            ("episodes", episodes),
            ("draw_seed", leaf(root, _EPISODES)),
            ("system", system),
            ("settings", settings),
        ),
        models,
        seconds=5.0 + 0.5 * episodes,
    )


def measure_episodes(
    folder: Path, dnn: Done, bayesian: Done, *, episodes: int, draw_seed: int, system: int, settings: Settings
) -> Json:
    """The margin and verdict of each episode, how its decisions ended, and where it came nearest.

    Of the episode in which a hand came nearest the trace is kept in ``folder``.
    """
    name, avoider_name, gate = SYSTEMS[system]
    avoiders: dict[str, Avoider] = {
        DNN: avoider_in(dnn),
        BAYESIAN: avoider_in(bayesian),
        OPPOSITE: OppositePose(settings.avoidance.radius_m),
        NONE: OppositePose(settings.avoidance.radius_m),
    }
    critical_m = NOWHERE_M if avoider_name == NONE else settings.avoidance.critical_distance_m
    own = replace(settings, avoidance=replace(settings.avoidance, gate=gate, critical_distance_m=critical_m))
    claims: dict[str, Property] = {
        DISTANCE: HandDistance(minimum_m=CLEAR_M, near_m=settings.avoidance.critical_distance_m),
        SEPARATION: ProtectiveSeparation(),
        OWN_SPEEDS: ProtectiveSeparation(own_speeds=True),
    }
    drawn = draw_admissible(nominal_space(), draw_seed, episodes)
    found: list[Json] = []
    least_m = np.inf
    for scenario in drawn.scenarios:
        trace = run_trial(admit(replace(scenario, settings=own), avoider=avoiders[avoider_name]))
        outcomes = trace.decisions["outcome"]
        found.append(
            {name: _judged(claim, trace) for name, claim in claims.items()}
            | {"decisions": [int(np.count_nonzero(outcomes == code)) for code in range(3)]}
        )
        margin_m = found[-1][DISTANCE]["margin_m"]
        if margin_m is not None and margin_m < least_m:
            least_m = margin_m
            claim = Claim(sentence=DISTANCE, expected=Verdict.HOLDS)
            kept = replace(trace, scenario=replace(trace.scenario, claims=(claim,)))
            save_trace(kept, folder / NEAREST)
    return {"system": name, "drawn": drawn.drawn, "episodes": found}


def _judged(claim: Property, trace: Trace) -> Json:
    judged = claim.evaluate(trace)
    margin = judged.margin if judged.margin is not None and np.isfinite(judged.margin) else None
    worst = None
    if judged.worst_time_s is not None:
        worst = float(
            trace.ticks["tcp_speed_mps"][int(np.argmin(np.abs(trace.time_s - judged.worst_time_s)))]
        )
    return {"verdict": judged.verdict.value, "margin_m": margin, "tcp_speed_at_worst_mps": worst}


def nominal_space() -> ScenarioSpace:
    """The paper's setting as a space."""
    return parse_space(NOMINAL)
