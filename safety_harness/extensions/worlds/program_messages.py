"""Define the messages between the harness and a user's simulator (docs/reference/world-protocol.md)."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from safety_harness.seams.isolation.messages import Failed, ProcessMessage, Refused

PROTOCOL = "safety-harness world 1"
MOST_BYTES = 65_536  # of a simulator's message

Numbers = list[float]


class WorldHello(ProcessMessage, tag="hello"):
    """The first message of the harness."""

    protocol: str = PROTOCOL


class WorldWelcome(ProcessMessage, tag="hello", forbid_unknown_fields=True):
    """A simulator's description of itself.

    ``joint_acceleration_radps2`` bounds the acceleration of each joint, with one number for each or one for
    all. Without this bound, and without a range of speeds in each state, claims about the time between ticks
    are inconclusive.
    """

    protocol: str
    name: str
    version: str
    joint_acceleration_radps2: Numbers | float | None = None


class WorldReset(ProcessMessage, tag="reset"):
    """The start of an episode: the cell, the arm at rest, and a seed as a text of digits."""

    urdf: str
    transform_seat: Any  # (4, 4), from the URDF's base link to the base frame
    last_link: str
    transform_tcp_to_last_link: Any  # (4, 4)
    table_height_m: float
    hand_radius_m: float
    forearm_radius_m: float
    joint_names: tuple[str, ...]
    joint_position_rad: Any  # (n,)
    period_s: float
    seed: str


class HandNow(Struct):
    """A hand and its forearm at a tick, in the base frame."""

    present: bool
    position_in_base_m: Any  # (3,)
    elbow_in_base_m: Any  # (3,)


class WorldStep(ProcessMessage, tag="step"):
    """The joints' set points until the next tick, after drives and brakes, and the hands at this tick."""

    tick: int
    joint_velocity_radps: Any  # (n,)
    braking: bool
    hands: list[HandNow]


class WorldState(ProcessMessage, tag="state", forbid_unknown_fields=True):
    """A simulator's state at a tick.

    ``joint_velocity_range_radps`` are the least and the largest speed of each joint since the previous tick.
    If the last two fields are given, the harness compares them with its own values.
    """

    tick: int
    time_s: float
    joint_position_rad: Numbers
    joint_velocity_radps: Numbers
    joint_velocity_range_radps: tuple[Numbers, Numbers] | None = None
    tcp_position_in_base_m: Numbers | None = None
    hand_distance_m: float | None = None


said_by_simulator: msgspec.json.Decoder[Any] = msgspec.json.Decoder(
    WorldWelcome | WorldState | Failed | Refused
)
