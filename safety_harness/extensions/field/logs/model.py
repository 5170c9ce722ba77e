"""The log of a real cell as data: what was recorded, on which clocks, and what its owner says of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.extensions.field.logs.streams import NS, LogSamples
from safety_harness.extensions.field.logs.told import Told
from safety_harness.scenario.fields import Field
from safety_harness.scenario.robots import AnyRobot

JOINTS_KNOWN_TO_RAD = np.radians(0.1)
JOINTS_LONGEST_GAP_S = 0.1


@dataclass(frozen=True, kw_only=True)
class JointFacts:
    """What is said of the joints; ``move_at_most_radps`` is (joints,), None is not said.

    ``at_rest``: values that repeat to the last bit are those of a joint that stands still.
    """

    known_to_rad: float
    speeds_known_to_radps: float | None
    move_at_most_radps: NDArray[np.float64]
    accelerate_at_most_radps2: float | None
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, kw_only=True)
class HandFacts:
    """What is said of the hands, all of them; ``known_to_m`` is inf where each sample says it."""

    known_to_m: float
    moves_at_most_mps: float
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, eq=False)
class Body:
    """One hand: its own samples and those of its elbow, if these were recorded.

    Positions (n, 3) are in the base frame, times on the clock of the hands.  ``forearm`` is False for a hand
    that has none: then the hand alone is judged.
    """

    name: str
    hand: LogSamples
    elbow: LogSamples | None
    forearm: bool = True


@dataclass(frozen=True, eq=False)
class TcpCheck:
    """The TCP's own samples, at most ``apart_m`` from where the joints have it, of ``within_m`` allowed.

    Of the ``unseen`` joints another zero position would not have shown; ``unit``: another one would have.
    """

    samples: LogSamples
    apart_m: float
    within_m: float
    unseen: tuple[str, ...]
    unit: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class CellLog:
    """A log that was read.

    ``joints``: values (n, 2 j), positions and then velocities of the arm's joints, NaN where none was told,
    on the clock of the joints, from which everything is counted.  ``hands_ahead_ns`` is by how much the clock
    of the hands shows more, known to ``clock_known_to_s``.  ``period_ns`` is from tick to tick of the trace.
    ``said`` is the file, from which the scenario's own keys are still to be read; ``told`` is the
    controller's own word; ``tcp`` is where the log itself has the TCP.  Bodies beside the hands in their
    streams are ``left_out`` by the file, or ``unmapped``: then another hand may be there.  ``unused`` are the
    columns, topics and joints of its files that nothing reads.
    """

    name: str
    file: Path | None
    said: Field
    robot: AnyRobot
    joints: LogSamples
    joint_facts: JointFacts
    hands: tuple[Body, ...]
    hand_facts: HandFacts | None
    hands_ahead_ns: int
    clock_known_to_s: float
    period_ns: int
    files: tuple[Path, ...]
    told: Told
    left_out: tuple[str, ...] = ()
    unmapped: tuple[str, ...] = ()
    tcp: TcpCheck | None = None
    unused: tuple[str, ...] = ()

    @property
    def origin_ns(self) -> int:
        """When the trace begins, on the clock of the joints: at their first sample."""
        return int(self.joints.time_ns[0])

    @property
    def ticks(self) -> int:
        """How many ticks it has: up to the last sample of the joints."""
        return int((self.joints.time_ns[-1] - self.origin_ns) // self.period_ns) + 1

    @property
    def period_s(self) -> float:
        """From tick to tick."""
        return self.period_ns / NS

    def seconds(self, samples: LogSamples, *, of_hands: bool = False) -> NDArray[np.float64]:
        """(n,) the times of samples since the trace begins."""
        by_ns = self.hands_ahead_ns if of_hands else 0
        return np.asarray((samples.time_ns - by_ns - self.origin_ns) / NS)
