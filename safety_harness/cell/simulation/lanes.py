"""Kinematic episodes side by side, all of them a tick on in a few compiled calls.

Each record of ``WorldRecords`` and ``DrivenRecords`` is stacked: a lane is a row of it, as long as the
longest of its kind so far.  What is beyond a lane's own end is zero: no move begins there, no fault is in
force, no noise is read.  The functions are those of the kinematic world and of a user's controller.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined, njit_no_nrt
from safety_harness.cell.controller.cycle import report
from safety_harness.cell.controller.seeing import DrivenRecords, obey, see
from safety_harness.cell.simulation.kinematic_world import BRAKING, step
from safety_harness.cell.simulation.records import WorldRecords
from safety_harness.cell.simulation.steps import sense

Records = NDArray[np.void]
Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]
Flags = NDArray[np.bool_]
Stacked = TypeVar("Stacked", WorldRecords, DrivenRecords)


def stacked(like: Stacked, lanes: int) -> Stacked:
    """Room for so many lanes, each record (lanes, ...) of what one episode has."""

    def room(record: Any) -> Any:
        return np.zeros((lanes, *record.shape), record.dtype)

    return type(like)(*map(room, like))


def placed(lanes: Stacked, lane: int, own: Stacked) -> Stacked:
    """``lanes`` with an episode's ``own`` records in one of them; in new arrays where it needs more room."""
    pairs: Any = zip(lanes, own, strict=True)
    rooms: Any = (_placed(rows, lane, one) for rows, one in pairs)
    return type(lanes)(*rooms)


def _placed(rows: NDArray[np.void], lane: int, own: NDArray[np.void]) -> NDArray[np.void]:
    """``rows`` (lanes, k, ...), ``own`` (m, ...)."""
    if len(own) > rows.shape[1]:
        wider = np.zeros((len(rows), len(own), *rows.shape[2:]), rows.dtype)
        wider[:, : rows.shape[1]] = rows
        rows = wider
    _bytes(rows[lane, : len(own)])[:] = _bytes(own)  # else padding between fields would be anything
    _bytes(rows[lane, len(own) :])[:] = 0
    return rows


def _bytes(records: Any) -> NDArray[np.uint8]:
    """Where they lie, for they lie together."""
    found: NDArray[np.uint8] = records.reshape(-1).view(np.uint8)
    return found


@inlined
def _world_of(w: WorldRecords, lane: int) -> WorldRecords:
    return WorldRecords(
        w.drives[lane],
        w.moves[lane],
        w.samples[lane],
        w.arm[lane],
        w.truth[lane],
        w.hands[lane],
        w.capsules[lane],
        w.capsule_endpoints_in_base_m[lane],
        w.clock[lane],
        w.faults[lane],
        w.observation[lane],
        w.sensors[lane],
        w.object_frames[lane],
        w.hand_frames[lane],
        w.polygon_in_base_m[lane],
        w.normals[lane],
        w.uniforms[lane],
    )


@njit_no_nrt
def look_lanes(
    worlds: WorldRecords,
    controllers: DrivenRecords,
    lasts: Numbers,  # (lanes,)
    tick: int,
    objects: bool,
    predicts: bool,
) -> None:
    """The sensors see, and the controllers what they have delivered.

    Of the lanes whose last tick, of ``lasts``, is not over.
    """
    c = controllers
    for lane in range(lasts.shape[0]):
        if tick > lasts[lane]:
            continue
        w = _world_of(worlds, lane)
        sense(*w[4:])
        see(
            c.parameters[lane],
            c.filter_parameters[lane],
            c.state[lane],
            c.tracks[lane],
            w.observation,
            c.seen[lane],
            objects,
            predicts,
        )


@njit_no_nrt
def obey_lanes(
    observations: Records,  # (lanes, 1) OBSERVATION
    controllers: DrivenRecords,
    lasts: Numbers,  # (lanes,)
    tick: int,
    twists: Floats,  # (lanes, 6)
    joints: Floats,  # (lanes, n)
    by_joints: Flags,  # (lanes,)
    stop: Flags,  # (lanes,)
    finite: Flags,  # (lanes,), filled
) -> None:
    """A command for the action of each lane; ``finite`` is false of one that is none."""
    c = controllers
    for lane in range(lasts.shape[0]):
        if tick > lasts[lane]:
            continue
        p, s, o, command = c.parameters[lane], c.state[lane], observations[lane], c.command[lane]
        if by_joints[lane]:
            finite[lane] = obey(p, s, o, joints[lane], True, stop[lane], command)
        else:
            finite[lane] = obey(p, s, o, twists[lane], False, stop[lane], command)


@njit_no_nrt
def step_lanes(
    worlds: WorldRecords,
    controllers: DrivenRecords,
    questions: Records,  # (lanes, 1) QUESTION
    ticks: Records,  # (lanes, n) ``as_compiled``
    lasts: Numbers,  # (lanes,)
    tick: int,
    modes: Numbers,  # (lanes,), negative: not reported
) -> None:
    """Write down what the controllers saw and said; then a control period with their commands."""
    for lane in range(lasts.shape[0]):
        if tick > lasts[lane]:
            continue
        w, c, one = _world_of(worlds, lane), controllers, ticks[lane, tick : tick + 1]
        report(c.state[lane], questions[lane], c.command[lane], one)
        questions[lane, 0].tick += 1
        if modes[lane] >= 0:
            one[0].mode = modes[lane]
        if tick < lasts[lane] and step(*w[:10], c.command[lane]):
            one[0].limits |= BRAKING
        if w.faults.shape[0] > 0:
            one[0].faults |= w.clock[0].acted_faults
