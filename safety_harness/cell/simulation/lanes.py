"""Run kinematic episodes side by side.

A few compiled calls advance all episodes by one tick. The functions stack the ``WorldRecords`` and the
``DrivenRecords`` of episodes. A lane is an episode's row in a stack. Each row is as long as the longest
record so far. The entries after the end of a lane's own record are zero. In these entries, moves do not begin
and faults do not act. The functions do not read noise from them. The functions call the compiled steps of the
kinematic world and of users' controllers.
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
    """Return zero records for ``lanes`` lanes.

    Each record has a first axis of lanes before the axes of the record in ``like``.
    """

    def zeros(record: Any) -> Any:
        return np.zeros((lanes, *record.shape), record.dtype)

    return type(like)(*map(zeros, like))


def placed(lanes: Stacked, lane: int, own: Stacked) -> Stacked:
    """Store the records ``own`` of an episode in row ``lane`` of ``lanes``, and return the arrays.

    The function makes wider arrays if necessary.
    """
    pairs: Any = zip(lanes, own, strict=True)
    filled: Any = (_placed(rows, lane, record) for rows, record in pairs)
    return type(lanes)(*filled)


def _placed(rows: NDArray[np.void], lane: int, own: NDArray[np.void]) -> NDArray[np.void]:
    """Store ``own`` (m, ...) in row ``lane`` of ``rows`` (lanes, k, ...), and return the array.

    If m > k, the result is wider than ``rows``.
    """
    if len(own) > rows.shape[1]:
        wider = np.zeros((len(rows), len(own), *rows.shape[2:]), rows.dtype)
        wider[:, : rows.shape[1]] = rows
        rows = wider
    _bytes(rows[lane, : len(own)])[:] = _bytes(own)  # as bytes, so that the padding is the same too
    _bytes(rows[lane, len(own) :])[:] = 0
    return rows


def _bytes(records: Any) -> NDArray[np.uint8]:
    """Return a view of contiguous records as bytes."""
    view: NDArray[np.uint8] = records.reshape(-1).view(np.uint8)
    return view


@inlined
def _world_of(w: WorldRecords, lane: int) -> WorldRecords:
    """Return the records of the lane with the number ``lane``."""
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
    """Let sensors deliver their frames, and fill the controllers' views.

    The function skips lanes whose last tick, in ``lasts``, is before ``tick``.
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
    """Turn the action of each lane into a command.

    Set ``finite`` to False where the action is not finite.
    """
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
    """Record the controllers' views and answers, then execute the commands for a control period."""
    for lane in range(lasts.shape[0]):
        if tick > lasts[lane]:
            continue
        w, c, record = _world_of(worlds, lane), controllers, ticks[lane, tick : tick + 1]
        report(c.state[lane], questions[lane], c.command[lane], record)
        questions[lane, 0].tick += 1
        if modes[lane] >= 0:
            record[0].mode = modes[lane]
        if tick < lasts[lane] and step(*w[:10], c.command[lane]):
            record[0].limits |= BRAKING
        if w.faults.shape[0] > 0:
            record[0].faults |= w.clock[0].acted_faults
