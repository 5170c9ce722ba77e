"""The log of a real cell as data: its recordings, its clocks, and its owner's statements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.extensions.field.logs.controller_reports import ControllerReports
from safety_harness.extensions.field.logs.streams import NS, LogSamples
from safety_harness.scenario.fields import Field
from safety_harness.scenario.robots import AnyRobot

JOINTS_KNOWN_TO_RAD = np.radians(0.1)  # without a statement in LOG.yaml
JOINTS_LONGEST_GAP_S = 0.1  # without a statement in LOG.yaml


@dataclass(frozen=True, kw_only=True)
class JointFacts:
    """The statements of LOG.yaml on the joints, with None for no statement.

    ``move_at_most_radps`` is of shape (joints,). ``at_rest`` is true if values that repeat to the last bit
    come from a joint that stands still.
    """

    known_to_rad: float
    speeds_known_to_radps: float | None
    move_at_most_radps: NDArray[np.float64]
    accelerate_at_most_radps2: float | None
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, kw_only=True)
class HandFacts:
    """The statements of LOG.yaml on hands; ``known_to_m`` is inf if each sample has its own uncertainty."""

    known_to_m: float
    moves_at_most_mps: float
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, eq=False)
class Body:
    """One hand: its own samples, and its elbow's samples if the log has them.

    Positions (n, 3) are in the base frame, times on the clock of the hands. ``forearm`` is False for a hand
    without a forearm, whose verdicts concern the hand alone.
    """

    name: str
    hand: LogSamples
    elbow: LogSamples | None
    forearm: bool = True


@dataclass(frozen=True, eq=False)
class TcpCheck:
    """The result of the check of the log's own TCP ``samples`` against the TCP that the joints determine.

    Both are at most ``apart_m`` apart, where ``within_m`` is allowed. The check cannot detect a wrong zero
    position of the ``unseen`` joints. ``unit`` is true if the check would detect a wrong unit of angles.
    """

    samples: LogSamples
    apart_m: float
    within_m: float
    unseen: tuple[str, ...]
    unit: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class CellLog:
    """The content of a log: its data, and the statements of its LOG.yaml.

    Args:
        name: The name of the log.
        file: The LOG.yaml, None if it is not a file.
        said: The file's tree, with the keys of a scenario, which the code for the trace reads.
        robot: The arm.
        joints: Values (n, 2 j), positions and then velocities of the arm's joints [rad, rad/s], NaN for a
            missing value. Their clock is the reference.
        joint_facts: The statements on the joints.
        hands: The hands.
        hand_facts: The statements on the hands, None without hands.
        hands_ahead_ns: The lead of the hands' clock over the joints' clock.
        clock_known_to_s: The uncertainty of that lead.
        period_ns: The period of the trace's ticks.
        files: All files that were read.
        told: The controller's own reports.
        left_out: Other bodies in the hands' streams that LOG.yaml leaves out.
        unmapped: Other bodies in the hands' streams that LOG.yaml does not mention; some may be hands.
        tcp: The check of the log's own TCP, None without one.
        unused: The columns, topics and joints in the files that the reader does not use.

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
    told: ControllerReports
    left_out: tuple[str, ...] = ()
    unmapped: tuple[str, ...] = ()
    tcp: TcpCheck | None = None
    unused: tuple[str, ...] = ()

    @property
    def origin_ns(self) -> int:
        """The beginning of the trace on the joints' clock, which is the time of the joints' first sample."""
        return int(self.joints.time_ns[0])

    @property
    def ticks(self) -> int:
        """The number of ticks up to the last sample of the joints."""
        return int((self.joints.time_ns[-1] - self.origin_ns) // self.period_ns) + 1

    @property
    def period_s(self) -> float:
        """The period of the ticks [s]."""
        return self.period_ns / NS

    def seconds(self, samples: LogSamples, *, of_hands: bool = False) -> NDArray[np.float64]:
        """Return (n,) the times of samples since the trace begins [s].

        Args:
            samples: The samples.
            of_hands: True if the samples are on the hands' clock.

        """
        by_ns = self.hands_ahead_ns if of_hands else 0
        return np.asarray((samples.time_ns - by_ns - self.origin_ns) / NS)
