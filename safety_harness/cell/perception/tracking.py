"""Track hands: pair boxes with tracks, and predict the position of each hand.

In case of doubt, the module assumes that a hand is present. A track ends only if no frame has shown its hand
for longer than the timeout. If the filter cannot extrapolate a track, the track stays at its place and does
not disappear.
"""

from __future__ import annotations

from math import inf, isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.base.settings import HAND_SLOTS
from safety_harness.cell.perception.hand_boxes import place_of_pixel
from safety_harness.cell.perception.hand_filter import FEW_BOXES, TRACK, initialise, predict, update, wait
from safety_harness.trace.records import TRACKS_PER_HAND

MOST_TRIED = 625  # pairings: (4 + 1)^4 of four boxes with four tracks
FARTHEST_PX = 1e9  # the largest distance of a box from its track, even if the gate is larger


def no_tracks(hand_slots: int = HAND_SLOTS[0]) -> NDArray[np.void]:
    """Return an array (n,) of unused ``TRACK`` records, with n = TRACKS_PER_HAND x ``hand_slots``."""
    return np.zeros(TRACKS_PER_HAND * hand_slots, TRACK)


@njit_no_nrt
def advance_tracks(
    tracks: NDArray[np.void],  # (n,) of TRACK, changed in place
    boxes: NDArray[np.float64],  # (n, 5); only the first ``count`` rows are read
    count: int,  # 0 .. n
    capture_time_s: float,
    parameters: NDArray[np.void],  # (1,) of FILTER_PARAMETERS
) -> bool:
    """Update the tracks with a frame of the hand sensor.

    ``count`` = 0 means a frame without a hand.

    1. The function predicts every track to the capture time.
    2. The function pairs boxes and tracks so that the sum of the distances between their centres in the image
      is least.
       A box without a track adds ``gate_px`` to the sum, and the distance of a pair is at most ``gate_px``.
       If at most MOST_TRIED pairings exist and some have equal sums, earlier boxes get lower slots.
    3. The function updates paired tracks. Every other box starts a track in the free slot that was seen
      longest ago.
       Without a free slot, the new track replaces the unpaired track that was seen longest ago.
    4. The function drops tracks that no frame has shown for longer than ``track_timeout_s``.

    The function ignores a box with a value that is not finite, or without a positive depth and area. If a
    track's predicted depth would not be positive, the track stays at its place, with growing uncertainty. So
    the depth of a track is always positive.

    If the frame is older than a track's state or its time is not finite, the function leaves the tracks
    unchanged and returns ``False``. Such a frame must not count as a frame without a hand.
    """
    if not isfinite(capture_time_s):
        return False
    for i in range(tracks.shape[0]):
        # All tracks are tested before any is changed, so that an old frame leaves no half-advanced state.
        if tracks[i]["valid"] and capture_time_s < tracks[i]["time_s"]:
            return False
    for i in range(tracks.shape[0]):
        if tracks[i]["valid"]:
            _predict_to(tracks[i], capture_time_s, parameters[0])
    _assign(tracks, boxes, count, parameters[0]["gate_px"])
    for i in range(tracks.shape[0]):
        if tracks[i]["box"] >= 0:
            update(tracks[i], boxes[tracks[i]["box"]], parameters[0])
    for i in range(tracks.shape[0]):
        # Before new tracks start, so that a slot that becomes free here can take a box of this frame.
        if capture_time_s - tracks[i]["last_seen_s"] > parameters[0]["track_timeout_s"]:
            tracks[i]["valid"] = False
    for j in range(count):
        if not _has_track(tracks, j) and _is_measurement(boxes[j]):
            slot = _slot_for_new_track(tracks)
            tracks[slot]["id"] = _greatest_id(tracks) + 1
            initialise(tracks[slot], boxes[j], capture_time_s, parameters[0])
            tracks[slot]["box"] = j
    for i in range(tracks.shape[0]):  # reset, so that equal tracks have equal bytes after other frames
        tracks[i]["box"] = 0
        for j in range(FEW_BOXES):
            tracks[i]["distance_px"][j] = 0.0
    return True


@njit_no_nrt
def predict_positions(
    tracks: NDArray[np.void],  # (n,) of TRACK
    at_time_s: float,
    parameters: NDArray[np.void],  # (1,) of FILTER_PARAMETERS
    transform_sensor_to_base: NDArray[np.float64],  # (4, 4)
    positions_in_base_out: NDArray[np.float64],  # (n, 3) [m]
    valid_out: NDArray[np.bool_],  # (n,)
) -> None:
    """Fill ``positions_in_base_out`` with the centre of every tracked hand at ``at_time_s``.

    The tracks do not change. The function extrapolates the filtered box by its rates, and converts it by the
    pinhole model (``position_from_box``). The rows of slots without a track are NaN and not valid.

    An extrapolated depth that is not positive means that the hand would pass through the sensor's plane. At
    this plane, a pixel and a depth have no meaning. The function then uses the filter's present position,
    whose depth ``advance_tracks`` keeps positive. The function also uses the present position if the
    extrapolation is not finite. So a tracked hand always has a position, which is never behind the sensor.
    """
    focal_px, radius_m = parameters[0]["focal_px"], parameters[0]["assumed_radius_m"]
    c_u, c_v = parameters[0]["c_u"], parameters[0]["c_v"]
    for i in range(tracks.shape[0]):
        valid_out[i] = tracks[i]["valid"]
        if not tracks[i]["valid"]:
            for row in range(3):
                positions_in_base_out[i, row] = nan
            continue
        u, v, depth_m = _extrapolated(tracks[i], at_time_s - tracks[i]["time_s"])
        if not _is_place(u, v, depth_m):
            u, v, depth_m = _extrapolated(tracks[i], 0.0)
        x, y, z = place_of_pixel(u, v, depth_m, focal_px, c_u, c_v, radius_m)
        for row in range(3):
            positions_in_base_out[i, row] = (
                transform_sensor_to_base[row, 0] * x
                + transform_sensor_to_base[row, 1] * y
                + transform_sensor_to_base[row, 2] * z
                + transform_sensor_to_base[row, 3]
            )


@njit_no_nrt
def _is_place(u_px: float, v_px: float, z_m: float) -> bool:
    """Return whether u, v and z of a box define a point in front of the sensor."""
    return isfinite(u_px) and isfinite(v_px) and isfinite(z_m) and z_m > 0.0


@njit_no_nrt
def _is_measurement(box: NDArray[np.float64]) -> bool:
    """Return whether ``box`` (5,) is finite and has a positive depth and a positive area."""
    return _is_place(box[0], box[1], box[2]) and isfinite(box[3]) and box[3] > 0.0 and isfinite(box[4])


@njit_no_nrt
def _extrapolated(track: np.void, dt_s: float) -> tuple[float, float, float]:
    """Return (u, v, z) of a track's box after ``dt_s``, which is value + dt rate for each pair."""
    mean = track["mean"]
    return mean[0] + dt_s * mean[5], mean[1] + dt_s * mean[6], mean[2] + dt_s * mean[7]


@njit_no_nrt
def _predict_to(track: np.void, time_s: float, parameters: np.void) -> None:
    """Predict a track to ``time_s``.

    If the predicted depth would not be positive, the mean does not change.
    """
    dt_s = time_s - track["time_s"]
    if track["mean"][2] + dt_s * track["mean"][7] > 0.0:
        predict(track, dt_s, parameters)
    else:
        wait(track, dt_s, parameters)
    track["time_s"] = time_s  # exactly, not by a sum of steps


@njit_no_nrt
def _assign(
    tracks: NDArray[np.void],  # (n,) of TRACK
    boxes: NDArray[np.float64],  # (n, 5)
    count: int,
    gate_px: float,
) -> None:
    """Find the cheapest pairing, and write into each track the index of its box.

    If there are few boxes, the function tries all pairings. Otherwise the function calls ``_assign_many``.
    """
    slots = tracks.shape[0]
    for i in range(slots):
        tracks[i]["box"] = -1
    tried = 1.0
    for _ in range(count):
        tried *= slots + 1
    if count > FEW_BOXES or tried > MOST_TRIED:
        _assign_many(tracks, boxes, count, gate_px)
        return
    for j in range(count):
        for i in range(slots):
            tracks[i]["distance_px"][j] = _distance_px(tracks[i], boxes[j])
    least = inf
    for code in range((slots + 1) ** count):
        total = 0.0
        used = 0
        rest = code
        for j in range(count - 1, -1, -1):  # the first box is the digit that changes last
            i = rest % (slots + 1)  # the last value: this box starts a track of its own
            rest //= slots + 1
            if i == slots:
                total += gate_px  # less than any pair beyond the gate
            elif used & (1 << i) or not tracks[i]["distance_px"][j] <= gate_px:
                total = inf
            else:
                total += tracks[i]["distance_px"][j]
                used |= 1 << i
        # Strictly less: of equal sums the first pairing wins, in which earlier boxes have lower slots.
        if total < least:
            least = total
            rest = code
            for i in range(slots):
                tracks[i]["box"] = -1
            for j in range(count - 1, -1, -1):
                i = rest % (slots + 1)
                rest //= slots + 1
                if i < slots:
                    tracks[i]["box"] = j


@njit_no_nrt
def _distance_px(track: np.void, box: NDArray[np.float64]) -> float:
    """Return the distance in the image of ``box`` (5,) from a track, or infinity for an impossible pair."""
    if not (track["valid"] and _is_measurement(box)):
        return inf
    du, dv = box[0] - track["mean"][0], box[1] - track["mean"][1]
    return sqrt(du * du + dv * dv)


@njit_no_nrt
def _has_track(tracks: NDArray[np.void], box: int) -> bool:
    """Return whether any track is paired with ``box``."""
    has_track = False
    for i in range(tracks.shape[0]):
        has_track = has_track or tracks[i]["box"] == box
    return has_track


@compiled
def _assign_many(
    tracks: NDArray[np.void],  # (n,) of TRACK
    boxes: NDArray[np.float64],  # (n, 5)
    count: int,
    gate_px: float,
) -> None:
    """Find the cheapest pairing by shortest augmenting paths (Hungarian method).

    The method takes count^2 (tracks + count) steps. Besides the columns of the tracks, each box has its own
    column with the cost ``gate_px``. The algorithm numbers the columns and the boxes from 1.
    """
    slots = tracks.shape[0]
    size, gate = slots + count + 1, gate_px if gate_px < FARTHEST_PX else FARTHEST_PX
    box_price, column_price = np.zeros(count + 1), np.zeros(size)
    box_of, predecessor = np.zeros(size, np.int64), np.zeros(size, np.int64)
    # Add one box at a time: a shortest path over reduced costs moves earlier boxes to other columns if
    # needed.
    for box in range(1, count + 1):
        box_of[0], column = box, 0
        least, done = np.full(size, inf), np.zeros(size, np.bool_)
        while box_of[column] != 0:
            done[column] = True
            row, step, nearest = box_of[column], inf, 0
            for k in range(1, size):
                if done[k]:
                    continue
                cost = gate
                if k <= slots:
                    distance_px = _distance_px(tracks[k - 1], boxes[row - 1])
                    cost = distance_px if distance_px <= gate else 2.0 * gate  # dearer than its own
                # Reduced costs stay non-negative, so Dijkstra's method applies.
                cost -= box_price[row] + column_price[k]
                if cost < least[k]:
                    least[k], predecessor[k] = cost, column
                if least[k] < step:
                    step, nearest = least[k], k
            for k in range(size):
                # Raise the prices so that the edges of the path have the reduced cost 0.
                if done[k]:
                    box_price[box_of[k]] += step
                    column_price[k] -= step
                else:
                    least[k] -= step
            column = nearest
        # Walk the path back, and give each column on it the box of the column before.
        while column != 0:
            box_of[column] = box_of[predecessor[column]]
            column = predecessor[column]
    for k in range(1, slots + 1):
        if box_of[k] != 0:
            tracks[k - 1]["box"] = box_of[k] - 1


@njit_no_nrt
def _slot_for_new_track(tracks: NDArray[np.void]) -> int:
    """Return the slot for a new track.

    The function prefers the free slot that was seen longest ago. If no slot is free, it takes the slot of the
    unpaired track that was seen longest ago. Such a slot always exists, because there are at most as many
    boxes as slots. So at least one slot is unpaired if a box has no track.
    """
    best = -1
    for i in range(tracks.shape[0]):
        if tracks[i]["box"] >= 0:
            continue
        if best < 0:
            best = i
        elif tracks[i]["valid"] != tracks[best]["valid"]:
            if not tracks[i]["valid"]:
                best = i
        elif tracks[i]["last_seen_s"] < tracks[best]["last_seen_s"]:
            best = i
    return best


@njit_no_nrt
def _greatest_id(tracks: NDArray[np.void]) -> int:
    """Return the greatest track id in all slots.

    A slot keeps the id of a dropped track until its next use, so that every id is unique.
    """
    greatest = 0
    for i in range(tracks.shape[0]):
        greatest = max(greatest, tracks[i]["id"])
    return greatest
