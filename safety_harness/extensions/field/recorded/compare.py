"""Compare a log with runs in both worlds.

In these runs, the controller of the log's scenario meets the recorded hands. The recorded values come from
the log's trace at its ticks, with the stated uncertainty; ticks in gaps are omitted. The simulated values are
interpolated linearly between the ticks of the simulation.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.driving import named_system
from safety_harness.admission.trial import judge, run_trial
from safety_harness.base.exceptions import LogError, Place
from safety_harness.base.whole_file import sha256_of
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.worlds import WORLDS, WorldEntry
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.field.recorded.apart import (
    BLOCKS,
    CONFIDENCE,
    FEWEST,
    USUALLY,
    DelayFit,
    Difference,
    difference_of,
    fit_of,
)
from safety_harness.extensions.field.recorded.scenario import FromLog
from safety_harness.scenario.files import display_path
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.typed_json import of_format, plain, read_json, typed
from safety_harness.trace.provenance import provenance
from safety_harness.trace.system import SystemUnderTest
from safety_harness.trace.trace import Trace

FORMAT = "safety-harness recorded cell 1"
FILE = "compare-worlds.json"
JOINTS, TCP, DISTANCE = "joint_position_rad", "transform_tcp_to_base", "hand_distance_m"
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ClosestHand:
    """The least distance of a hand in the simulation [m], and bounds of its least distance in the recording.

    ``recorded_least_m`` is None if the log has a gap, because the hand may have been nearer during the gap.
    """

    hand: str
    simulated_m: float
    recorded_least_m: float | None
    recorded_most_m: float


@dataclass(frozen=True, kw_only=True)
class ClaimOfBoth:
    """Two verdicts on one claim, for the log and for a simulated run, and the texts of both margins."""

    sentence: str
    recorded: Verdict
    recorded_margin: str
    simulated: Verdict
    simulated_margin: str

    @property
    def decided(self) -> bool:
        """Return whether both verdicts are conclusive."""
        return Verdict.INCONCLUSIVE not in (self.recorded, self.simulated)

    @property
    def differs(self) -> bool:
        """Return whether the two verdicts contradict each other."""
        return self.decided and self.recorded is not self.simulated

    @property
    def optimistic(self) -> bool:
        """Return whether the claim holds in simulation although the log violates it."""
        return self.recorded is Verdict.VIOLATED and self.simulated is Verdict.HOLDS


@dataclass(frozen=True, kw_only=True)
class WorldBeside:
    """The comparison of one world with the log.

    ``absent`` lists the comparisons that are missing, with the reasons.
    """

    world: str
    joints: tuple[Difference, ...]
    tcp: Difference | None
    distances: tuple[Difference, ...]
    closest: tuple[ClosestHand, ...]
    fit: DelayFit | None
    claims: tuple[ClaimOfBoth, ...]
    absent: tuple[str, ...]

    @property
    def contradicted(self) -> int:
        """The number of claims for which the verdict on the run contradicts the verdict on the log."""
        return sum(claim.differs for claim in self.claims)


@dataclass(frozen=True, kw_only=True)
class CellComparison:
    """The comparison of both worlds with a recorded cell.

    It includes software versions, and a pair (name, sha256) for each file.
    """

    log: str
    title: str
    scenario: str
    tested: str
    duration_s: float
    joint_samples: int
    confidence: float
    blocks: int
    usually: float
    worlds: tuple[WorldBeside, ...]
    notes: tuple[str, ...]
    package_version: str
    source_hash: str
    python: str
    platform: str
    libraries: tuple[tuple[str, str], ...]
    files: tuple[tuple[str, str], ...]
    system: SystemUnderTest | None = None  # of the simulated runs; an earlier version did not write it

    @property
    def claims(self) -> tuple[ClaimOfBoth, ...]:
        """The comparisons of claims in all worlds."""
        return tuple(claim for world in self.worlds for claim in world.claims)


def compare_worlds(made: FromLog) -> CellComparison:
    """Run the scenario of a log in every world, and compare each run with the log.

    Raises:
        InstallationError: The engine of a world is missing.
        InadmissibleError: The scenario cannot run.
        LogError: The recording is too short for statistics.

    """
    trace = made.trace
    least_s = FEWEST * trace.scenario.settings.clock.control_period_s
    if made.scenario.duration_s < least_s:
        place = Place(file=made.log.file, field="log.joints")
        raise LogError(place=place, expected=f"{least_s:g} s at least", got=f"{made.scenario.duration_s:g} s")
    recorded = judge(replace(trace, scenario=replace(trace.scenario, claims=made.scenario.claims)))
    # Refuse a missing engine before the first run.
    for world in WORLDS:
        world.opener()
    worlds = tuple(_beside(made, world, recorded) for world in WORLDS)
    origin = provenance("recorded", tuple(name for world in WORLDS for name in world.libraries))
    read = [*made.log.files, *(file for file in (made.log.file, made.cell.file) if file is not None)]
    hashes = [(str(display_path(file)), sha256_of(file)) for file in read if file.is_file()]
    hashes += [(name.name, name.hand.motion.sha256) for name in made.hands]
    return CellComparison(
        log=str(display_path(made.log.file)) if made.log.file else made.log.name,
        title=trace.scenario.title,
        scenario=made.cell.name,
        tested=made.scenario.under_test,
        duration_s=made.scenario.duration_s,
        joint_samples=len(made.log.joints.time_ns),
        confidence=CONFIDENCE,
        blocks=BLOCKS,
        usually=USUALLY,
        worlds=worlds,
        notes=made.notes,
        package_version=origin.package_version,
        source_hash=origin.source_hash,
        python=origin.python,
        platform=origin.platform,
        libraries=origin.libraries,
        files=tuple(hashes),
        system=named_system(made.scenario),
    )


def _beside(made: FromLog, world: WorldEntry, recorded: tuple[Evaluation, ...]) -> WorldBeside:
    simulated = run_trial(admit(made.scenario), world=world)
    return beside(made.trace, simulated, recorded, judge(simulated), world=world.label)


def beside(
    recorded: Trace,
    simulated: Trace,
    of_recorded: tuple[Evaluation, ...],
    of_simulated: tuple[Evaluation, ...],
    *,
    world: str,
) -> WorldBeside:
    """Return the comparison of a world's run with the log.

    Args:
        recorded: The trace of the log.
        simulated: The trace of the run.
        of_recorded: The evaluations of the claims on the log.
        of_simulated: The evaluations of the same claims on the run.
        world: The label of the world.

    """
    shared = recorded.time_s <= simulated.time_s[-1] + 1e-9
    absent = []
    if not simulated.complete:
        absent.append(f"what follows after {simulated.time_s[-1]:.3f} s: the run has {simulated.ended}")
    names = arm_model(recorded.scenario.robot).joint_names
    there = shared & recorded.known.measured(JOINTS, recorded.ticks)
    off_by = recorded.known.uncertainty_of(JOINTS, len(recorded.ticks))[there]
    time_s, own = recorded.time_s[there], recorded.ticks[JOINTS][there]
    differences = _simulated(simulated, JOINTS, time_s) - own
    joints = [
        difference_of(name, "rad", time_s, column, off_by)
        for name, column in zip(names, differences.T, strict=True)
    ]
    distances, closest = [], []
    for pair in _distances(recorded, simulated, shared, absent):
        distances.append(pair[0])
        closest.append(pair[1])
    return WorldBeside(
        world=world,
        joints=tuple(pair for pair in joints if pair is not None),
        tcp=_tcp(recorded, simulated, shared),
        distances=tuple(distances),
        closest=tuple(closest),
        fit=fit_of(time_s, own, simulated.time_s, simulated.ticks[JOINTS]),
        claims=tuple(map(_claim, of_recorded, of_simulated)),
        absent=tuple(absent),
    )


def _simulated(trace: Trace, name: str, time_s: Floats) -> Floats:
    """Return the column ``name`` (n, ...) at the times ``time_s`` (n,), interpolated between ticks."""
    values = trace.ticks[name].reshape(len(trace.ticks), -1)
    columns = np.column_stack([np.interp(time_s, trace.time_s, column) for column in values.T])
    return columns.reshape(len(time_s), *trace.ticks[name].shape[1:])


def _tcp(recorded: Trace, simulated: Trace, shared: NDArray[np.bool_]) -> Difference | None:
    """Return the statistics of the unsigned distance between the recorded and the simulated TCP."""
    there = shared & recorded.known.measured(TCP, recorded.ticks)
    time_s, off_by = recorded.time_s[there], recorded.known.uncertainty_of(TCP, len(recorded.ticks))[there]
    way_m = _simulated(simulated, TCP, time_s)[:, :3, 3] - recorded.ticks[TCP][there][:, :3, 3]
    return difference_of("TCP", "m", time_s, np.linalg.norm(way_m, axis=1), off_by)


def _distances(
    recorded: Trace, simulated: Trace, shared: NDArray[np.bool_], absent: list[str]
) -> Iterator[tuple[Difference, ClosestHand]]:
    hands = recorded.scenario.hands
    if recorded.known.missing([DISTANCE]):
        absent.append("hand distances: the log does not have all of the hands and forearms")
        return
    measured = recorded.known.measured(DISTANCE, recorded.ticks)
    within_m = recorded.known.uncertainty_of(DISTANCE, len(recorded.ticks))
    for k, hand in enumerate(hands):
        there = shared & measured[:, k]
        time_s, off_m = recorded.time_s[there], within_m[there]
        own_m, other_m = recorded.ticks[DISTANCE][there, k], _simulated(simulated, DISTANCE, time_s)[:, k]
        difference = difference_of(f"distance of {hand.name}", "m", time_s, other_m - own_m, off_m)
        if difference is None:
            absent.append(f"the distance of {hand.name}: seen for too short a time")
            continue
        yield (
            difference,
            ClosestHand(
                hand=hand.name,
                simulated_m=float(other_m.min()),
                # If the hand was not measured at all times, it may have come nearer meanwhile.
                recorded_least_m=float((own_m - off_m).min()) if there.sum() == shared.sum() else None,
                recorded_most_m=float((own_m + off_m).min()),
            ),
        )


def _claim(recorded: Evaluation, simulated: Evaluation) -> ClaimOfBoth:
    return ClaimOfBoth(
        sentence=recorded.sentence,
        recorded=recorded.verdict,
        recorded_margin=recorded.margin_text(),
        simulated=simulated.verdict,
        simulated_margin=simulated.margin_text(),
    )


def as_json(comparison: CellComparison) -> str:
    """Return the text of ``compare-worlds.json``."""
    return json.dumps({"format": FORMAT, **plain(comparison)}, indent=1, ensure_ascii=False) + "\n"


def read_comparison(path: Path) -> CellComparison:
    """Return the comparison in a file that ``compare-worlds`` wrote; raise InputError for any other file."""
    content = of_format(read_json(path, "what compare-worlds wrote"), FORMAT, path)
    del content["format"]
    return typed(content, CellComparison, path)
