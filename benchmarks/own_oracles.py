"""By how much a run breaks a claim, worked out without the claims' own code: above zero is a violation.

Kinematics are those of the trace or of ``links_in_base``, which the tests compare with PyBullet.  Distances,
ways, optima and times are formed here in plain numpy, by other formulas than the package's.  Lengths and
times come back in the unit that the pages show: mm, ms, degrees.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

Floats = NDArray[np.float64]
PARTS = 40  # of a tick, in which distances are looked at
TURN = 1e-6  # of a joint, for differences [rad]
DEG = 180.0 / np.pi
WAY_STEP_M = 0.002  # of the inverse kinematics along a straight way


def period_s(trace: Trace) -> float:
    """The control period."""
    return float(trace.scenario.settings.clock.control_period_s)


def capsules_of(trace: Trace) -> CapsuleSet:
    """Those of the arm, and the camera's."""
    return cell_capsules(arm_capsules(trace.scenario.robot), trace.scenario.settings)


def finer(values: Floats, parts: int = PARTS) -> Floats:
    """(m, ...) ``values`` (n, ...), straight between two neighbours."""
    at = np.linspace(0.0, len(values) - 1, (len(values) - 1) * parts + 1)
    before = np.minimum(at.astype(int), len(values) - 2)
    share = (at - before).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[before] + share * values[before + 1])


def between(a: Floats, u: Floats, b: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Distance of segments a + s u and b + t v (..., 3), and s and t: the least of corners, edges, inside."""
    uu, uv, vv = (np.einsum("...i,...i", *pair) for pair in ((u, u), (u, v), (v, v)))
    w = a - b
    uw, vw = np.einsum("...i,...i", u, w), np.einsum("...i,...i", v, w)
    some, more = np.where(uu > 0.0, uu, 1.0), np.where(vv > 0.0, vv, 1.0)
    det = np.where(uu * vv - uv**2 > 1e-12, uu * vv - uv**2, 1.0)
    zero, one = np.zeros_like(uw), np.ones_like(uw)
    pairs = [
        (np.clip((uv * vw - vv * uw) / det, 0.0, 1.0), np.clip((uu * vw - uv * uw) / det, 0.0, 1.0)),
        (zero, np.clip(vw / more, 0.0, 1.0)),
        (one, np.clip((vw + uv) / more, 0.0, 1.0)),
        (np.clip(-uw / some, 0.0, 1.0), zero),
        (np.clip((uv - uw) / some, 0.0, 1.0), one),
    ]
    s, t = np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])
    apart = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    least = apart.argmin(axis=0)[None]
    return tuple(np.take_along_axis(x, least, axis=0)[0] for x in (apart, s, t))  # type: ignore[return-value]


def axes_at(trace: Trace, joints_rad: Floats) -> tuple[Floats, Floats]:
    """(n, c, 3) beginning and (n, c, 3) end of each capsule's axis."""
    arm, capsules = arm_model(trace.scenario.robot), capsules_of(trace)
    links = np.array([links_in_base(arm, q)[capsules.link_index] for q in joints_rad])
    turn, at = links[..., :3, :3], links[..., :3, 3]
    return tuple(  # type: ignore[return-value]
        np.einsum("ncij,cj->nci", turn, ends) + at for ends in (capsules.start_in_link, capsules.end_in_link)
    )


def hands_apart(trace: Trace, moving: bool) -> float:
    """The least distance [mm] of the first hand and the arm, or its parts beyond the base, ticks in parts."""
    sizes, capsules = trace.scenario.settings.hand, capsules_of(trace)
    begin, end = axes_at(trace, finer(trace.ticks["joint_position_rad"]))
    hand, elbow = (finer(trace.ticks[f"{x}_position_in_base_m"][:, 0])[:, None] for x in ("hand", "elbow"))
    found = np.inf
    for reach, radius_m in ((np.zeros_like(hand), sizes.radius_m), (elbow - hand, sizes.forearm_radius_m)):
        apart = between(
            np.broadcast_to(hand, begin.shape), np.broadcast_to(reach, begin.shape), begin, end - begin
        )
        surface = apart[0] - capsules.radius_m - radius_m
        found = min(found, float(surface[:, capsules.link_index > 0 if moving else slice(None)].min()))
    return 1e3 * found


def separation_lacks(trace: Trace, hand_mps: float | None) -> float:
    """The most [mm] that S_p is above the distance, over pairs and ticks at which a joint turns.

    S_p = v_h (T_r + T_s) + v_r (T_r + T_s/2) + (|v_hand| + |v_link|) dt/2, the speeds of the nearest points
    by differences; ``hand_mps`` None takes the hand's own towards the link.
    """
    settings, dt, ticks = trace.scenario.settings, period_s(trace), trace.ticks
    capsules, joints, rates = (
        capsules_of(trace),
        ticks["joint_position_rad"],
        ticks["joint_velocity_radps"],
    )
    stop_s = (
        settings.braking.stop_time_base_s + settings.braking.stop_time_per_speed_s2pm * ticks["tcp_speed_mps"]
    )
    begin, end = axes_at(trace, joints)
    later = axes_at(trace, joints + TURN * rates)
    hand, elbow = ticks["hand_position_in_base_m"][:, :1], ticks["elbow_position_in_base_m"][:, :1]
    worst = -np.inf
    for reach, radius_m in (
        (np.zeros_like(hand), settings.hand.radius_m),
        (elbow - hand, settings.hand.forearm_radius_m),
    ):
        shape = begin.shape
        axes_m, s, t = between(
            np.broadcast_to(hand, shape), np.broadcast_to(reach, shape), begin, end - begin
        )
        s, t = s[..., None], t[..., None]
        near, far = begin + t * (end - begin), hand + s * reach
        unit = (far - near) / axes_m[..., None]
        link = (later[0] + t * (later[1] - later[0]) - near) / TURN
        body = np.empty_like(far)
        body[:-1] = (hand[1:] + s[:-1] * reach[1:] - far[:-1]) / dt
        body[-1] = (far[-1] - hand[-2] - s[-1] * reach[-2]) / dt
        v_r = np.maximum(np.einsum("nci,nci->nc", link, unit), 0.0)
        own = np.maximum(-np.einsum("nci,nci->nc", body, unit), 0.0)
        v_h = own if hand_mps is None else np.full_like(own, hand_mps)
        reaction_s = settings.braking.reaction_time_s
        needed = v_h * (reaction_s + stop_s[:, None]) + v_r * (reaction_s + 0.5 * stop_s[:, None])
        needed += 0.5 * dt * (np.linalg.norm(body, axis=-1) + np.linalg.norm(link, axis=-1))
        lacks = needed - (axes_m - capsules.radius_m - radius_m)
        worst = max(worst, float(lacks[np.abs(rates).max(axis=1) >= 1e-3].max()))
    return 1e3 * worst


def jacobian(trace: Trace, joints_rad: Floats) -> Floats:
    """(6, 6) of the TCP, by differences to both sides."""
    arm, found = arm_model(trace.scenario.robot), np.empty((6, 6))
    for j, step in enumerate(np.eye(6) * TURN):
        up, down = links_in_base(arm, joints_rad + step)[-1], links_in_base(arm, joints_rad - step)[-1]
        turn = (up[:3, :3] @ down[:3, :3].T) / (2.0 * TURN)
        found[:3, j] = (up[:3, 3] - down[:3, 3]) / (2.0 * TURN)
        found[3:, j] = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
    return found


def solved(trace: Trace, joints_rad: Floats, position_m: Floats) -> Floats | None:
    """(6,) joints near ``joints_rad`` with the TCP at a position (3,), turned as before; or None."""
    arm, q = arm_model(trace.scenario.robot), joints_rad.copy()
    wanted = links_in_base(arm, joints_rad)[-1][:3, :3]
    for _ in range(8):
        pose = links_in_base(arm, q)[-1]
        turn = wanted @ pose[:3, :3].T
        error = np.r_[
            position_m - pose[:3, 3],
            0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]),
        ]
        if np.abs(error).max() < 1e-11:
            fits = (q > arm.position_lower_rad).all() and (q < arm.position_upper_rad).all()
            least = trace.scenario.settings.motion.min_singular_value
            regular = np.linalg.svd(jacobian(trace, q), compute_uv=False)[-1] >= least
            return q if fits and regular and np.abs(q - joints_rad).max() < 0.5 else None
        q = q + np.linalg.solve(jacobian(trace, q), error)
    return None


def way_gone(trace: Trace, joints_rad: Floats, way_m: Floats) -> tuple[float, Floats]:
    """How far [m] a straight way (3,) can be followed, and (n, 6) the joints on it."""
    start = links_in_base(arm_model(trace.scenario.robot), joints_rad)[-1][:3, 3]
    length, gone, step, along = float(np.linalg.norm(way_m)), 0.0, WAY_STEP_M, [joints_rad]
    while step > 1e-7 and gone < length:
        here = min(gone + step, length)
        found = solved(trace, along[-1], start + here / length * way_m)
        if found is None:
            step *= 0.5
        else:
            gone, along = here, [*along, found]
    return gone, np.array(along)


def out_of_reach(trace: Trace, name: str) -> float:
    """The most [mm] that is missing of the straight way to the positions of a column of the decisions."""
    worst = -np.inf
    for decision in trace.decisions:
        tick = trace.ticks[decision["tick"]]
        way = decision[name] - tick["transform_tcp_to_base"][:3, 3]
        far = (1.0 + 0.001 / np.linalg.norm(way)) * way
        gone, _ = way_gone(trace, tick["joint_position_rad"], far)
        worst = max(worst, 1e3 * (float(np.linalg.norm(way)) - gone))
    return worst


def below_table(trace: Trace) -> float:
    """How deep [mm] forearm, wrist or camera are in the table on the first decision's planned way."""
    decision = trace.decisions[0]
    tick, capsules = trace.ticks[decision["tick"]], capsules_of(trace)
    way = decision["chosen_position_in_base_m"] - tick["transform_tcp_to_base"][:3, 3]
    ends = np.stack(axes_at(trace, way_gone(trace, tick["joint_position_rad"], way)[1]))
    height = ends[..., 2].min(axis=0) - capsules.radius_m
    lowest = float(height[:, capsules.link_index >= 3].min())
    return 1e3 * (trace.scenario.settings.cell.table_height_m - lowest)


def from_box(trace: Trace) -> float:
    """The least distance [mm] of the arm, but for its base, from the first box, which is not turned."""
    box, capsules = trace.scenario.obstacles[0], capsules_of(trace)
    begin, end = axes_at(trace, finer(trace.ticks["joint_position_rad"], 8))  # (n, c, 3)
    low, high = np.zeros(begin.shape[:2]), np.ones(begin.shape[:2])
    for _ in range(10):  # the distance from a convex body is convex along an axis
        share = low + np.linspace(0.0, 1.0, 9)[:, None, None] * (high - low)
        points = begin + share[..., None] * (end - begin)
        beyond = np.abs(points - np.array(box.position_in_base_m)) - 0.5 * np.array(box.size_m)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        at = np.take_along_axis(share, outside.argmin(axis=0)[None], axis=0)[0]
        low, high = np.maximum(at - (high - low) / 8.0, 0.0), np.minimum(at + (high - low) / 8.0, 1.0)
    least = outside.min(axis=0) - capsules.radius_m
    return 1e3 * float(least[:, capsules.link_index > 0].min())


def towards(trace: Trace, name: str, hand: str) -> float:
    """The most [mm] that a way to the positions ``name`` leads towards the hand, ``true`` or asked about."""
    found = []
    for decision in trace.decisions:
        tick = trace.ticks[decision["tick"]]
        tcp = tick["transform_tcp_to_base"][:3, 3] if hand == "true" else decision["tcp_position_in_base_m"]
        at = tick["hand_position_in_base_m"][0] if hand == "true" else decision["hand_position_in_base_m"]
        cosine = np.linalg.norm(decision[name] - at) ** 2 - np.linalg.norm(decision[name] - tcp) ** 2
        apart = np.linalg.norm(tcp - at)
        found.append((apart**2 - cosine) / (2.0 * apart))  # by the law of cosines
    return 1e3 * max(found)


def optimum_m(trace: Trace, decision: Any) -> Floats:
    """(3,) the cap's point nearest to the desired position, by zooming in, drawn away from the hand."""
    avoidance, desired = (
        trace.scenario.settings.avoidance,
        np.array(trace.scenario.settings.cell.desired_tcp_position_in_base_m),
    )
    tcp, hand = decision["tcp_position_in_base_m"], decision["hand_position_in_base_m"]
    axis = desired - np.array(avoidance.nominal_hand_position_in_base_m)
    axis /= np.linalg.norm(axis)
    side = np.linalg.qr(np.c_[axis, np.eye(3)])[0][:, 1:3]
    low, high = np.array([0.0, -np.pi]), np.array([avoidance.candidate_cone_rad, np.pi])
    best, widths = np.zeros(2), high - low
    centre = 0.5 * (low + high)
    for _ in range(30):
        grid = np.stack(
            np.meshgrid(*(c + w * np.linspace(-0.5, 0.5, 41) for c, w in zip(centre, widths, strict=True))),
            -1,
        )
        grid[..., 0] = np.clip(grid[..., 0], low[0], high[0])
        polar, turn = grid[..., 0, None], grid[..., 1, None]
        points = np.cos(polar) * axis + np.sin(polar) * (
            np.cos(turn) * side[:, 0] + np.sin(turn) * side[:, 1]
        )
        points = tcp + avoidance.radius_m * points
        at = np.unravel_index(np.linalg.norm(points - desired, axis=-1).argmin(), grid.shape[:2])
        best, centre, widths = points[at], grid[at], 0.4 * widths
    return np.asarray(best + avoidance.hand_pull * (tcp - hand))


def off_optimum(trace: Trace, sure: bool = False) -> float:
    """The farthest [mm] that a proposal is from the optimum; only those within the threshold, if ``sure``."""
    return 1e3 * max(
        float(np.linalg.norm(one["proposed_position_in_base_m"] - optimum_m(trace, one)))
        for one in trace.decisions
        if not sure or one["proposed_spread_m"].max() <= one["spread_threshold_m"]
    )


def beyond_spreads(trace: Trace) -> float:
    """The most [mm] by which an axis of a proposal is off the optimum beyond three spreads."""
    return 1e3 * max(
        float(
            (
                np.abs(one["proposed_position_in_base_m"] - optimum_m(trace, one))
                - 3.0 * one["proposed_spread_m"]
            ).max()
        )
        for one in trace.decisions
    )


def ignored_ms(trace: Trace, near: NDArray[np.bool_]) -> float:
    """The longest time [ms] from a tick with a hand near (n,) to the one at which the arm gives way."""
    longest, since = 0, -1
    for k, mode in enumerate(trace.ticks["mode"]):
        gives = mode in (Mode.REPULSING, Mode.PROTECTIVE_STOP)
        since = -1 if gives else (k if since < 0 and near[k] else since)
        if since >= 0:
            longest = max(longest, min(k + 1, len(near) - 1) - since)
    return 1e3 * longest * period_s(trace)


def tcp_m(trace: Trace) -> Floats:
    """(n, 3) the TCP."""
    return np.asarray(trace.ticks["transform_tcp_to_base"][:, :3, 3])


def true_near(trace: Trace) -> NDArray[np.bool_]:
    """(n,) is the first hand within the critical distance of the TCP?"""
    apart = np.linalg.norm(trace.ticks["hand_position_in_base_m"][:, 0] - tcp_m(trace), axis=1)
    return np.asarray(apart < trace.scenario.settings.avoidance.critical_distance_m)


def braked_late_ms(trace: Trace) -> float:
    """How much later [ms] than 120 ms after the first hand came near the drives of an arm brake."""
    near, brakes = (int(np.argmax(one)) for one in (true_near(trace), trace.ticks["limits"] & 16 != 0))
    return 1e3 * (brakes - near) * period_s(trace) - 120.0


def predicted_near(trace: Trace) -> NDArray[np.bool_]:
    """(n,) is a predicted hand?"""
    apart = np.linalg.norm(trace.ticks["predicted_hand_in_base_m"] - tcp_m(trace)[:, None], axis=2)
    critical = trace.scenario.settings.avoidance.critical_distance_m
    return np.asarray(((apart < critical) & trace.ticks["track_valid"]).any(axis=1))


def alarm_mm(trace: Trace) -> float:
    """How far [mm] the first hand is from the TCP when the arm first gives way; it must."""
    first = int(np.argmax(trace.ticks["mode"] == Mode.REPULSING))
    return 1e3 * float(np.linalg.norm(trace.ticks["hand_position_in_base_m"][first, 0] - tcp_m(trace)[first]))


def prediction_off(trace: Trace) -> float:
    """The most [mm] that a prediction is from the first hand, straight between ticks, at its time."""
    time = np.arange(len(trace.ticks)) * period_s(trace)
    then = time + trace.scenario.settings.hand_filter.prediction_horizon_s
    hand = trace.ticks["hand_position_in_base_m"][:, 0]
    true = np.stack([np.interp(then, time, hand[:, i]) for i in range(3)], axis=1)
    apart = np.linalg.norm(trace.ticks["predicted_hand_in_base_m"] - true[:, None], axis=2)
    counts = trace.ticks["track_valid"] & (then <= time[-1] + 1e-9)[:, None]
    return 1e3 * float(apart[counts].max())


def tcp_acceleration(trace: Trace) -> float:
    """The largest change of the TCP's velocity in a tick [m/s2], its velocity by differences of its place."""
    arm = arm_model(trace.scenario.robot)
    velocity = np.array(
        [
            (links_in_base(arm, q + TURN * r)[-1][:3, 3] - links_in_base(arm, q - TURN * r)[-1][:3, 3])
            / (2.0 * TURN)
            for q, r in zip(
                trace.ticks["joint_position_rad"], trace.ticks["joint_velocity_radps"], strict=True
            )
        ]
    )
    return float(np.linalg.norm(np.diff(velocity, axis=0), axis=1).max()) / period_s(trace)


def longest_s(trace: Trace, lost: NDArray[np.bool_]) -> float:
    """The longest time [s] from a tick with ``lost`` (n,) to the next one without."""
    longest = count = 0
    for one in lost[:-1]:
        count = count + 1 if one else 0
        longest = max(longest, count)
    return longest * period_s(trace)


def squared_error(trace: Trace) -> Floats:
    """(n,) |f - f*|^2 of an upright camera: the squared distance of the TCP from where it should end."""
    desired = np.array(trace.scenario.settings.cell.desired_tcp_position_in_base_m)
    return np.asarray(((tcp_m(trace) - desired) ** 2).sum(axis=1))


def switch_tick(trace: Trace) -> int:
    """The first tick with the error below the gain switch; as many as there are if there is none."""
    below = squared_error(trace) < trace.scenario.settings.servo.gain_switch_sse
    return int(np.argmax(below)) if below.any() else len(below)


def starved_s(trace: Trace) -> float:
    """The longest time [s] without a tenth of the closed form's progress, until 1 mm better than ever."""
    error, mode = np.sqrt(squared_error(trace)), trace.ticks["mode"]
    best, lost, longest = error[0], 0, 0
    tenth = 0.1 * trace.scenario.settings.servo.gain_far * period_s(trace)
    for before, here, now in zip(error[:-1], error[1:], mode[1:], strict=True):
        if here**2 < trace.scenario.settings.servo.gain_switch_sse or here < best - 0.001:
            best, lost = min(best, here), 0
        elif now != Mode.SERVOING or before - here < tenth * here:
            lost += 1
        longest = max(longest, lost)
    return longest * period_s(trace)


def stop_way_mm(trace: Trace, first: int) -> float:
    """The TCP's way [mm] from a tick on beyond that of a protective stop, a period's way and 2 mm."""
    braking, at = trace.scenario.settings.braking, tcp_m(trace)
    speed = float(trace.ticks["tcp_speed_mps"][first])
    stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * speed
    allowed = speed * (braking.reaction_time_s + 0.5 * stop_s + period_s(trace)) + 0.002
    ended = first + int(np.argmax(trace.ticks["mode"][first:] != Mode.PROTECTIVE_STOP)) or len(at)
    return 1e3 * (float(np.linalg.norm(np.diff(at[first:ended], axis=0), axis=1).sum()) - allowed)
