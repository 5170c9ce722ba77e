"""Define the data of a real cell's log: recordings, clocks, and statements of the cell's owner."""

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
    """The statements about the joints in LOG.yaml.

    A value of None means that LOG.yaml does not make this statement. ``move_at_most_radps`` (joints,) has the
    largest speed of each joint. ``at_rest`` is True if LOG.yaml states that repeated values come from a joint
    at rest.
    """

    known_to_rad: float
    speeds_known_to_radps: float | None
    move_at_most_radps: NDArray[np.float64]
    accelerate_at_most_radps2: float | None
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, kw_only=True)
class HandFacts:
    """The statements about hands in LOG.yaml.

    ``known_to_m`` is infinite if the log states the uncertainty of each sample separately.
    """

    known_to_m: float
    moves_at_most_mps: float
    longest_gap_s: float
    at_rest: bool = False


@dataclass(frozen=True, eq=False)
class Body:
    """The samples of one hand, and the samples of the elbow if the log has them.

    Positions (n, 3) are in the base frame, and times are on the clock of the hands. If ``forearm`` is False,
    there is no forearm, and verdicts concern only the hand.
    """

    name: str
    hand: LogSamples
    elbow: LogSamples | None
    forearm: bool = True


@dataclass(frozen=True, eq=False)
class TcpCheck:
    """The comparison of the TCP positions in the log (``samples``) with the positions that the joints imply.

    The two positions differ by at most ``apart_m``; the tolerance is ``within_m``. If a joint in ``unseen``
    has a wrong zero position, the check cannot detect the error. ``unit`` is true if the check would detect a
    wrong unit of angles.
    """

    samples: LogSamples
    apart_m: float
    within_m: float
    unseen: tuple[str, ...]
    unit: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class CellLog:
    """The content of a log: its data, and the statements in its LOG.yaml.

    Args:
        name: The name of the log.
        file: The LOG.yaml, or None if the log comes from no file.
        said: The tree of LOG.yaml. It includes the keys of a scenario, which are read when the trace is made.
        robot: The arm.
        joints: Values (n, 2 j), positions and then velocities of the arm's joints [rad, rad/s], NaN for a
            missing value. Their clock is the reference.
        joint_facts: The statements about the joints.
        hands: The hands.
        hand_facts: The statements about the hands, or None if the log has no hands.
        hands_ahead_ns: The lead of the hands' clock over the joints' clock.
        clock_known_to_s: The uncertainty of that lead.
        period_ns: The period of the trace's ticks.
        files: All files that were read.
        told: The controller's own reports.
        left_out: Other bodies in the hands' streams, which LOG.yaml excludes.
        unmapped: Other bodies in the hands' streams, which LOG.yaml does not mention and which may be hands.
        tcp: The check of the log's own TCP, or None if the log has no TCP.
        unused: The unused columns, topics and joints of the files.

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
        """The time on the joints' clock at which the trace begins, that is, at the joints' first sample."""
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
        """Return the times of the samples relative to the beginning of the trace, shape (n,) [s].

        Args:
            samples: The samples.
            of_hands: True if the samples are on the hands' clock.

        """
        by_ns = self.hands_ahead_ns if of_hands else 0
        return np.asarray((samples.time_ns - by_ns - self.origin_ns) / NS)
