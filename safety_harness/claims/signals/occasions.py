"""Write the reasons why a run did not exercise a claim: how near it came, and how near is sufficient.

The functions return texts for the reason of an inconclusive verdict. Each number in the texts comes from the
trace or from its scenario's settings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.signals.true_motion import nearest_hand_m, true_motion
from safety_harness.trace.known import PRESENCE
from safety_harness.trace.records import ENDLESS
from safety_harness.trace.trace import Trace

# A hand nearer than this exercises a claim.  The number belongs to the claims: if it were a setting of the
# tested system, a change of that setting would change how many runs count.
NEAR_M = 0.4
MOVES = 1e-3  # m/s and rad/s: what is slower stands
SEEN = ("predicted_distance_m", "transform_tcp_to_base", "hand_position_in_base_m", PRESENCE)
OFF_THE_GOAL = "a TCP start farther from the desired pose"


def beside(value: float, limit: float, unit: str, per_si: float) -> str:
    """Return ``value`` (SI) as text in ``unit``.

    The text has enough digits to distinguish the value from ``limit``.
    """
    shown = value * per_si
    digits = 1
    while digits < 9 and value != limit and round(shown, digits) == round(limit * per_si, digits):
        digits += 1
    return f"{shown:.{digits}f} {unit}"


def millimetres(value_m: float, limit_m: float) -> str:
    """Return ``value_m`` as text in mm, with enough digits to differ from ``limit_m``."""
    return beside(value_m, limit_m, "mm", 1e3)


def nearest_of(
    trace: Trace,
    distance_m: NDArray[np.float64],  # (n,) at each tick; what is not finite is not there
    limit_m: float,
    body: str,
    target: str = "the TCP",
) -> str:
    """Return a text that states the least distance of a hand from ``target``.

    The text also states the time of this distance, and the distance that would exercise the claim. The text
    is empty if no hand was present.
    """
    there_m = np.where(np.abs(distance_m) < ENDLESS, distance_m, np.inf)
    tick = int(np.argmin(there_m))
    if not np.isfinite(there_m[tick]):
        return ""
    came = f"the nearest {body} came to {millimetres(there_m[tick], limit_m)} of {target}"
    return f"{came} at {trace.time_s[tick]:.3f} s; within {limit_m * 1e3:g} mm exercises it"


def _near_m(trace: Trace) -> float:
    """Return the distance within which a hand exercises a claim and the arm must respond to the hand."""
    return min(trace.scenario.settings.avoidance.critical_distance_m, NEAR_M)


def no_near_hand(trace: Trace) -> str:
    """Return the reason why no true hand was near the TCP."""
    near_m = _near_m(trace)
    return nearest_of(trace, nearest_hand_m(trace), near_m, "hand") or no_hand(trace)


def no_hand(trace: Trace) -> str:
    """Return a text that says that no hand was present, and how near a hand would have to come."""
    near_m = _near_m(trace)
    enough = f"one within {near_m * 1e3:g} mm of the TCP exercises it"
    return f"{'no hand was there' if trace.scenario.hands else 'there is no hand in this scenario'}; {enough}"


def no_predicted_hand(trace: Trace) -> str:
    """Return the reason why no predicted hand was near the TCP.

    Either every predicted hand was too far away, or no hand was seen. If measurements are missing, the text
    only states the distance that is sufficient.
    """
    near_m = _near_m(trace)
    if _not_all_seen(trace):
        return f"a predicted hand within {near_m * 1e3:g} mm of the TCP exercises it"
    predicted = nearest_of(trace, trace.ticks["predicted_distance_m"], near_m, "predicted hand")
    if predicted:
        return predicted
    true = nearest_of(trace, nearest_hand_m(trace), near_m, "hand")
    return f"no hand was ever tracked; {true} if the hand sensor sees it" if true else no_hand(trace)


def _not_all_seen(trace: Trace) -> bool:
    """Return whether the trace lacks measurements that show how near true or predicted hands came."""
    return not trace.known.whole and any(trace.known.column(name).limited for name in SEEN)


def no_decision(trace: Trace) -> str:
    """Return why the controller made no decision."""
    if _not_all_seen(trace):
        return no_predicted_hand(trace)
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    near_ticks = np.flatnonzero(trace.ticks["predicted_distance_m"] < critical_m)
    if len(near_ticks) == 0:
        return no_predicted_hand(trace)
    time_s = trace.time_s[near_ticks[0]]
    came = f"a predicted hand came within {critical_m * 1e3:g} mm of the TCP at {time_s:.3f} s"
    return f"{came}, and nothing was decided by the end of the run; a longer duration exercises it"


def no_position(trace: Trace) -> str:
    """Return why the controller chose no retreat position."""
    stops = len(trace.decisions)
    if stops == 0:
        return no_decision(trace)
    return f"decisions: {stops}, each a protective stop; one that passes the gate exercises it"


def no_answer(trace: Trace) -> str:
    """Return why the avoider never gave a usable answer."""
    questions = len(trace.decisions)
    if questions == 0:
        return no_decision(trace)
    return f"the avoider never answered; questions: {questions}, and one usable answer exercises it"


def no_time(due_m: float, least_m: float) -> str:
    """Return a text which says that no repulsion lasted long enough to move the TCP by ``least_m``.

    ``due_m`` is the longest distance that the TCP could have moved during a repulsion.
    """
    had = f"a repulsion had time for {millimetres(due_m, least_m)} of way at most"
    return f"{had}; {least_m * 1e3:g} mm exercise it: a hand that comes earlier, or a longer duration"


def spread_beside_threshold(trace: Trace, *, above: bool) -> str:
    """Return a text on the answer whose spread came nearest to exercising the claim.

    If ``above`` is True, a spread above the threshold exercises the claim. Otherwise, a spread that does not
    exceed the threshold exercises it. If no answer has both a spread and a threshold, the text gives another
    reason.
    """
    if len(trace.decisions) == 0:
        wanted = "in doubt, above its threshold" if above else "sure of an answer that can be used"
        return f"{no_decision(trace)} if the avoider is {wanted}"
    largest_m = trace.decisions["proposed_spread_m"].max(axis=1)
    limit_m = trace.decisions["spread_threshold_m"]
    known_rows = np.flatnonzero((np.abs(largest_m) < ENDLESS) & (np.abs(limit_m) < ENDLESS))
    if len(known_rows) == 0:
        return "no answer had a spread and a threshold; one of an avoider that states both exercises it"
    excess_m = largest_m[known_rows] - limit_m[known_rows]
    at = known_rows[int(np.argmax(excess_m) if above else np.argmin(excess_m))]
    spread, extreme = millimetres(largest_m[at], limit_m[at]), "largest" if above else "smallest"
    enough = f"{'above' if above else 'at most'} {limit_m[at] * 1e3:.6g} mm, the avoider's threshold"
    time_s = trace.decisions["time_s"][at]
    return f"the {extreme} spread of an answer was {spread}, at {time_s:.3f} s; {enough}, exercises it"


def went(trace: Trace, place: str, counted: NDArray[np.bool_]) -> bool:
    """Return whether the column ``place`` certainly changes by more than its uncertainty.

    The function uses only changes within an unbroken sequence of ticks at which ``counted`` (n,) is True.
    """
    values = trace.ticks[place] if trace.ticks[place].ndim == 2 else trace.ticks[place][:, :3, 3]
    error, slow = 2.0 * trace.known.column(place).uncertainty, MOVES * trace.time_s[:, None]
    for ticks in np.split(np.arange(len(values)), np.flatnonzero(np.diff(counted)) + 1):
        for along in (values[ticks] - slow[ticks], -values[ticks] - slow[ticks]):
            if counted[ticks].all() and np.any(along - np.fmin.accumulate(along) > error):
                return True
    return False


def tcp_stood(trace: Trace) -> str:
    """Return the largest speed of the TCP as text, and the speed that exercises the claim."""
    fastest = millimetres(float(trace.ticks["tcp_speed_mps"].max()), MOVES)
    return f"the TCP moved at {fastest}/s at most; above {MOVES * 1e3:g} mm/s exercises it: {OFF_THE_GOAL}"


def joints_stood(trace: Trace) -> str:
    """Return the largest speed of the joints as text, and the speed that exercises the claim."""
    fastest = beside(float(np.abs(true_motion(trace).rates_radps).max()), MOVES, "mrad/s", 1e3)
    return f"a joint turned at {fastest} at most; above {MOVES * 1e3:g} mrad/s exercises it: {OFF_THE_GOAL}"


def occasion_m(limit_m: float = 0.0) -> float:
    """Return how near [m] a hand must come to exercise a limit of its distance.

    The result is NEAR_M or twice the limit, whichever is larger.
    """
    return max(NEAR_M, 2.0 * limit_m)
