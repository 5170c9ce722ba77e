"""The protective separation distance of ISO/TS 15066, term by term, of every pair of robot and human.

S_p = S_h + S_r + S_s + C + Z_d + Z_r: what the human covers until the robot stands (S_h), what the
robot covers in its reaction time (S_r) and while it brakes (S_s), how far a body reaches in before it
is noticed (C), and how uncertain the places of human (Z_d) and robot (Z_r) are.

A pair is one capsule of the arm and one body of one hand, its sphere or its forearm.  Each has its
own speeds, those of its two nearest points along the line between them: the robot's is the rate at
which the distance would shrink if the human stood still.  Receding counts as standing.
"""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.compiled import compiled

ASSUMED = (
    ("S_h", "the human goes on at this speed until the robot stands, v_h (T_r + T_s)"),
    ("S_r", "the robot goes on at its speed towards the human for the reaction time, v_r T_r"),
    ("S_s", "then it brakes uniformly, v_r T_s/2"),
    ("C", "none: the distance is measured from the true surfaces of hand and forearm"),
    ("Z_d", "the human is known at control ticks, and is that much elsewhere between two, |v| dt/2"),
    ("Z_r", "so is the robot; its capsules enclose its meshes"),
)


@dataclass(frozen=True, kw_only=True)
class Term:
    """One term of S_p [m] and what it takes for granted."""

    symbol: str
    length_m: float
    assumption: str


@dataclass(frozen=True, kw_only=True)
class Separation:
    """One pair at one tick: how far apart it is and has to be.

    ``robot_speed_mps`` and ``hand_speed_mps`` are those towards each other that the terms use;
    ``reaction_time_s`` and ``stop_time_s`` what is left of them.
    """

    tick: int
    hand: int
    capsule: int
    forearm: bool
    distance_m: float
    robot_speed_mps: float
    hand_speed_mps: float
    reaction_time_s: float
    stop_time_s: float
    terms: tuple[Term, ...]

    @property
    def required_m(self) -> float:
        """S_p."""
        return sum(term.length_m for term in self.terms)

    @property
    def margin_m(self) -> float:
        """How much farther apart the pair is than it has to be."""
        return self.distance_m - self.required_m


def separation_terms(
    *,
    hand_speed_mps: float,
    robot_speed_mps: float,
    reaction_time_s: float,
    stop_time_s: float,
    hand_moves_m: float = 0.0,
    robot_moves_m: float = 0.0,
) -> tuple[Term, ...]:
    """The six terms; the last two arguments are how far the nearest points move within half a tick."""
    found = lengths(
        hand_speed_mps, robot_speed_mps, reaction_time_s, stop_time_s, hand_moves_m, robot_moves_m
    )
    return tuple(
        Term(symbol=symbol, length_m=length, assumption=assumption)
        for (symbol, assumption), length in zip(ASSUMED, found, strict=True)
    )


@compiled
def lengths(
    hand_speed_mps: float,
    robot_speed_mps: float,
    reaction_time_s: float,
    stop_time_s: float,
    hand_moves_m: float,
    robot_moves_m: float,
) -> tuple[float, float, float, float, float, float]:
    """The six lengths [m], in the order of ``ASSUMED``."""
    return (
        hand_speed_mps * (reaction_time_s + stop_time_s),
        robot_speed_mps * reaction_time_s,
        0.5 * robot_speed_mps * stop_time_s,
        0.0,
        hand_moves_m,
        robot_moves_m,
    )
