"""Made-up but plausible runs for the report's tests: no simulator, the same record layout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import Claim, MovingHand, OffsetStart, Scenario, Verdict
from safety_harness.scenario.moves import ReachForTcp, Withdraw
from safety_harness.trace.records import DECISION, Check, DecisionOutcome, Limit, Mode, Trigger, tick_dtype
from safety_harness.trace.system import NOT_NOTED, Component
from safety_harness.trace.trace import Provenance, Trace

PROVENANCE = Provenance(
    package_version="0.1.0",
    source_hash="0123456789abcdef",
    world="kinematic",
    python="3.11.9",
    platform="Linux-x86_64",
    libraries=(("numpy", "2.4.6"), ("numba", "0.68.1")),
)
SYSTEM = replace(NOT_NOTED, avoider=Component(name="opposite"))
SEED_JOINTS = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])


def hand(name: str) -> MovingHand:
    return MovingHand(
        name=name,
        starts_at_in_base_m=(0.84, -0.65, 0.0),
        elbow_towards_in_base_m=(0.9, -1.0, 0.1),
        moves=(ReachForTcp(speed_mps=0.4, until_distance_m=0.3, at_most_s=4.0), Withdraw(speed_mps=0.3)),
    )


def claim(sentence: str, expected: Verdict = Verdict.HOLDS) -> Claim:
    return Claim(sentence=sentence, expected=expected)


def scenario(
    name: str = "reach-in",
    *,
    title: str = "A hand reaches in from the right",
    about: str = "One hand reaches for the TCP while the arm is servoing, stays for a moment and withdraws.",
    duration_s: float = 12.0,
    hands: tuple[str, ...] = ("right hand",),
    claims: tuple[Claim, ...] = (),
    settings: Settings = DEFAULTS,
) -> Scenario:
    return Scenario(
        name=name,
        title=title,
        about=about,
        duration_s=duration_s,
        seed=7,
        start=OffsetStart(offset_in_base_m=(0.04, 0.12, 0.08)),
        hands=tuple(hand(each) for each in hands),
        avoider="opposite",
        claims=claims,
        settings=settings,
    )


def trace(
    source: Scenario, *, ended: str = "complete", ticks: int | None = None, noise_m: float = 0.0
) -> Trace:
    """A servo loop that gives way while a hand is there; ``ticks`` cuts it short."""
    count = source.ticks + 1 if ticks is None else ticks
    rng = np.random.default_rng(source.seed)
    out = np.zeros(count, dtype=tick_dtype(source.hand_slots))
    period = source.settings.clock.control_period_s
    time = out["time_s"] = np.arange(count) * period
    desired = np.array(source.settings.cell.desired_tcp_position_in_base_m)
    enters, leaves = 0.25 * source.duration_s, 0.6 * source.duration_s
    close = (time > enters) & (time < leaves) & bool(source.hands)
    away = np.exp(-0.4 * time)[:, None] * np.array([0.04, 0.12, 0.08])
    give = np.where(close, 1.0 - np.exp(-(time - enters) / 0.4), 0.0)
    after = time >= leaves
    give = np.where(after & bool(source.hands), np.exp(-(time - leaves) * 0.5), give)
    tcp = desired + away + give[:, None] * np.array([-0.03, 0.07, 0.065])
    out["transform_tcp_to_base"] = np.diag([1.0, -1.0, -1.0, 1.0])
    out["transform_tcp_to_base"][:, :3, 3] = tcp
    out["tcp_speed_mps"][1:] = np.minimum(np.linalg.norm(np.diff(tcp, axis=0), axis=1) / period, 0.25)
    swing = np.array([0.3, 0.1, -0.2, 0.1, 0.02, -0.3])
    out["joint_position_rad"] = SEED_JOINTS + (tcp - desired)[:, 1:2] * swing * 4
    out["hand_distance_m"] = np.inf
    out["predicted_distance_m"] = np.inf
    for index in range(len(source.hands)):
        side = 1.0 if index == 0 else -1.0
        reach = np.exp(-(((time - 0.42 * source.duration_s) / (0.16 * source.duration_s)) ** 2))
        start = np.array([0.84, -0.65 * side, 0.0])
        place = start + reach[:, None] * (desired + np.array([0.05, -0.2 * side, 0.0]) - start) * 0.85
        out["hand_present"][:, index] = True
        out["hand_position_in_base_m"][:, index] = place
        out["elbow_position_in_base_m"][:, index] = place + np.array([0.05, -0.28 * side, 0.09])
        gap = np.linalg.norm(place - tcp, axis=1) - 0.1 + rng.normal(0.0, noise_m, count)
        out["hand_distance_m"][:, index] = gap
        out["predicted_hand_in_base_m"][:, index] = place
        out["track_valid"][:, index] = True
        out["predicted_distance_m"] = np.minimum(out["predicted_distance_m"], gap + 0.1)
    out["object_visible"] = True
    out["feature_error"][:, :3] = tcp - desired
    out["feature_error"][:, 3:] = np.exp(-0.4 * time)[:, None] * [0.02, -0.03, 0.05]
    out["sse"] = (out["feature_error"] ** 2).sum(axis=1)
    out["mode"] = np.where(close, Mode.REPULSING, Mode.SERVOING)
    if source.hands:
        out["mode"][(time > leaves - 0.6) & (time < leaves)] = Mode.PROTECTIVE_STOP
        out["limits"][(time > enters) & (time < enters + 0.4)] = Limit.TCP_SPEED | Limit.TCP_ACCELERATION
    out["decision"] = -1
    made = decisions(out, (enters, enters + 1.5, leaves - 0.6)) if source.hands else np.zeros(0, DECISION)
    return Trace(
        scenario=source,
        ticks=out,
        decisions=made,
        decision_latency_s=np.full(len(made), 1.2e-4),
        provenance=PROVENANCE,
        ended=ended,
        system=SYSTEM,
    )


def decisions(ticks: np.ndarray, times_s: tuple[float, ...]) -> np.ndarray:
    """One proposed, one opposite (with the reasons why), one stop; those that fall into the trace."""
    out = np.zeros(3, dtype=DECISION)
    for index, time_s in enumerate(times_s):
        tick = min(int(np.searchsorted(ticks["time_s"], time_s)), len(ticks) - 1)
        tcp = ticks["transform_tcp_to_base"][tick, :3, 3]
        out[index]["tick"], out[index]["time_s"], out[index]["seed"] = tick, time_s, index
        out[index]["asked_tick"] = tick
        out[index]["trigger"] = list(Trigger)[index]
        out[index]["hand_position_in_base_m"] = ticks["hand_position_in_base_m"][tick, 0]
        out[index]["tcp_position_in_base_m"] = tcp
        out[index]["proposed_position_in_base_m"] = tcp + np.array([-0.03, 0.07, 0.065])
        out[index]["proposed_spread_m"] = 0.011
        out[index]["spread_threshold_m"] = 0.0125
        out[index]["opposite_position_in_base_m"] = tcp + np.array([-0.02, 0.09, 0.03])
        out[index]["outcome"] = list(DecisionOutcome)[index]
    out[0]["chosen_position_in_base_m"] = out[0]["proposed_position_in_base_m"]
    out[1]["chosen_position_in_base_m"] = out[1]["opposite_position_in_base_m"]
    out[1]["proposed_failed"] = Check.PATH_UNREACHABLE
    out[2]["chosen_position_in_base_m"] = np.nan
    out[2]["proposed_failed"] = Check.UNREACHABLE | Check.TABLE
    out[2]["opposite_failed"] = Check.UNREACHABLE
    return out[[bool(time_s <= ticks["time_s"][-1]) for time_s in times_s]]


def evaluation(
    sentence: str,
    verdict: Verdict = Verdict.HOLDS,
    *,
    margin: float | None = 0.0123,
    worst_time_s: float | None = 5.0,
    unit: Unit = Unit.LENGTH,
    reason: str = "nearest at the forearm",
) -> Evaluation:
    return Evaluation(
        sentence=sentence,
        verdict=verdict,
        unit=unit,
        margin=margin,
        worst_time_s=worst_time_s,
        reason=reason,
        exercised=0 if verdict is Verdict.INCONCLUSIVE else 120,
    )


APART = "hand distance never below 150 mm"
SLOW = "TCP speed never above 250 mm/s"
CONVERGES = "gain switch reached within 60 s"


def holds_run(name: str = "reach-in") -> JudgedRun:
    source = scenario(name, claims=(claim(APART), claim(SLOW)))
    return JudgedRun(
        trace(source),
        (
            evaluation(APART, margin=0.0213, worst_time_s=5.4, reason="nearest between hand and wrist 2"),
            evaluation(
                SLOW, margin=0.0, worst_time_s=3.1, unit=Unit.SPEED, reason="the limit acted on 50 ticks"
            ),
        ),
        f"safety-harness run scenarios/{name}.yaml --seed 7",
        (),
    )


def violated_run() -> JudgedRun:
    source = scenario(
        "two-hands",
        title="Two hands from both sides, the controller short-sighted",
        about="The critical distance is cut to 250 mm; two hands come from left and right at once.",
        duration_s=20.0,
        hands=("right hand", "left hand"),
        claims=(claim(APART), claim(SLOW, Verdict.VIOLATED), claim(CONVERGES)),
        settings=replace(
            DEFAULTS,
            avoidance=replace(DEFAULTS.avoidance, critical_distance_m=0.25),
            camera=replace(DEFAULTS.camera, latency_s=0.05),
        ),
    )
    return JudgedRun(
        trace(source, noise_m=0.004),
        (
            evaluation(
                APART,
                Verdict.VIOLATED,
                margin=-0.0371,
                worst_time_s=8.6,
                reason="right hand 112.9 mm from wrist 1",
            ),
            evaluation(
                SLOW,
                Verdict.VIOLATED,
                margin=-0.012,
                worst_time_s=5.1,
                unit=Unit.SPEED,
                reason="262 mm/s while repulsing",
            ),
            evaluation(CONVERGES, margin=12.5, worst_time_s=20.0, unit=Unit.TIME, reason="crossed at 47.5 s"),
        ),
        "safety-harness run scenarios/two-hands.yaml --seed 7",
        ("Recording 'right hand': 3 gaps of at most 41 ms were bridged by straight lines.",),
    )


def no_hands_run() -> JudgedRun:
    """Nobody near: the claim about hands was never put to the test."""
    source = scenario(
        "empty-cell",
        title="Nobody near the cell",
        about="Servoing alone.",
        hands=(),
        claims=(claim(APART, Verdict.INCONCLUSIVE),),
    )
    return JudgedRun(
        trace(source),
        (
            evaluation(
                APART,
                Verdict.INCONCLUSIVE,
                margin=None,
                worst_time_s=None,
                reason="never exercised: no hand came near",
            ),
        ),
        "safety-harness run scenarios/empty-cell.yaml",
    )


def truncated_run() -> JudgedRun:
    source = scenario("cut-short", title="The run that stopped half-way", claims=(claim(APART),))
    return JudgedRun(
        trace(source, ended="the arm reached a joint limit", ticks=600),
        (
            evaluation(
                APART,
                Verdict.INCONCLUSIVE,
                margin=0.04,
                worst_time_s=4.79,
                reason="the run was cut short (the arm reached a joint limit): nearest so far",
            ),
        ),
        "safety-harness run scenarios/cut-short.yaml --seed 7",
    )


HOSTILE = "<script>alert('x')</script><b>$\\frac{1}$ & \"q\""


def hostile_run() -> JudgedRun:
    """Markup in every text that a user can write."""
    source = scenario(
        "hostile",
        title=f"title {HOSTILE}",
        about=f"about {HOSTILE}",
        hands=(f"_{HOSTILE}", "\x0bhand \u624b"),
        claims=(claim(f"hand claim {HOSTILE}"),),
    )
    return JudgedRun(
        trace(source, ended=f"ended {HOSTILE}", ticks=900),
        (evaluation(f"hand read {HOSTILE}", Verdict.VIOLATED, margin=-0.001, reason=f"reason {HOSTILE}"),),
        f"replay {HOSTILE}",
        (f"note {HOSTILE}",),
    )
