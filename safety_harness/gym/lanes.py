"""Many kinematic episodes side by side, all of them a tick on in one compiled call.

Each record of ``WorldRecords`` and ``DrivenRecords`` is stacked: a lane is a row of it, as long as the
longest of its kind so far.  What is beyond a lane's own end is zero: no move begins there, no fault is in
force, no noise is read.  The functions are those of the kinematic world and of a user's controller.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import inlined, njit_no_nrt
from safety_harness.controller.seeing import DrivenRecords, obey, see
from safety_harness.simulation.kinematic_world import step
from safety_harness.simulation.records import WorldRecords
from safety_harness.simulation.steps import sense

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
    rows[lane, : len(own)] = own
    rows[lane, len(own) :] = np.zeros((), rows.dtype)
    return rows


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
def look_lane(
    worlds: WorldRecords, controllers: DrivenRecords, lane: int, objects: bool, predicts: bool
) -> None:
    """Let the sensors of one lane see, and its controller what they have delivered."""
    w, c = _world_of(worlds, lane), controllers
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
def step_lanes(
    worlds: WorldRecords,
    controllers: DrivenRecords,
    wanted: NDArray[np.float64],  # (lanes, 6) or (lanes, n), as ``obey`` has it
    by_joints: bool,
    objects: bool,
    predicts: bool,
) -> None:
    """Every lane obeys its action for a control tick, and looks."""
    c = controllers
    for lane in range(wanted.shape[0]):
        w, mine = _world_of(worlds, lane), wanted[lane]
        obey(c.parameters[lane], c.state[lane], w.observation, mine, by_joints, False, c.command[lane])
        step(*w[:10], c.command[lane])
        look_lane(worlds, controllers, lane, objects, predicts)
