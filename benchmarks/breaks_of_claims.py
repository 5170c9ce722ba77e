"""The families of ``planted_breaks`` by claim, in the catalogue's order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import own_oracles as own
import planted_breaks as run
from broken import gate_of, passing
from examples import VISIT, Displaced, Slow, hand, scenario
from harmless import CERTAIN, IN_DOUBT, Astray
from planted_breaks import STAYS, Break, NowAndThen, Numberless, Proposes
from planted_controllers import Drifts, StopsLate
from test_fallback_resolution import BUILT_IN, gone

from safety_harness import read_scenario
from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.scenario.faults import CameraBlind, HandSensorBlind, HandSensorOff
from safety_harness.trace.records import DecisionOutcome, Mode

FALL, USED = "uncertain answers fall back within 2 cycles", "certain answers are used"
AWAY = "repulsion moves away from every hand"
OUT = (0.0, 0.6, 0.8)
NOTHING = read_scenario(Path(__file__).parents[1] / "scenarios" / "nothing-reachable.yaml")
DESIRED = (0.700, 0.0, 0.350)


def out(by_m: float) -> Displaced:
    """An avoider that proposes to go so far up and aside."""
    return Displaced(tuple(by_m * np.array(OUT)))


def distances() -> Iterator[Break]:
    """Claims about the distance of hands."""
    yield Break(
        "hand distance never below 50 mm",
        "a hand passes the moving arm that much nearer",
        "mm",
        run.passing_by,
        lambda t: 50.0 - own.hands_apart(t, moving=False),
        0.4,
        0.1,
    )
    yield Break(
        "no moving part touches a hand",
        "a hand that passes reaches that far into the moving arm",
        "mm",
        run.passing_by,
        lambda t: -own.hands_apart(t, moving=True),
        0.4,
        0.05,
    )
    for end, mps in (("", 2.0), (" at 1.6 m/s", 1.6), (" from hands at their own speeds", None)):
        yield Break(
            "protective separation kept" + end,
            "a hand passes the moving arm that much nearer than S_p",
            "mm",
            run.passing_by,
            lambda t, mps=mps: own.separation_lacks(t, mps),
            1.3 if mps else 1.0,
            0.15,
        )


def positions() -> Iterator[Break]:
    """Claims about what is proposed and chosen."""
    yield Break(
        "repulsive poses reachable",
        "a position that far out of reach, behind a gate that passes everything",
        "mm",
        lambda m: run.tried(run.resting(0.35), out(m), passing()),
        lambda t: own.out_of_reach(t, "chosen_position_in_base_m"),
        0.2,
        1.0,
    )
    yield Break(
        "proposed repulsive poses reachable",
        "a proposal that far out of reach",
        "mm",
        lambda m: run.tried(run.resting(0.35), out(m)),
        lambda t: own.out_of_reach(t, "proposed_position_in_base_m"),
        0.2,
        1.0,
    )
    yield Break(
        "proposals lead away to within 10 mm",
        "a proposal that much nearer to the hand than 10 mm",
        "mm",
        lambda m: run.tried(run.resting(0.35), Proposes(run.nearer(m))),
        lambda t: own.towards(t, "proposed_position_in_base_m", "asked") - 10.0,
        0.0,
        0.05,
    )
    yield Break(
        "proposals within 60 mm of the optimum",
        "a proposal that much farther off",
        "mm",
        lambda m: run.tried(run.resting(0.35), Proposes(run.off_optimum(m))),
        lambda t: own.off_optimum(t) - 60.0,
        0.0,
        0.1,
    )
    yield Break(
        "proposals within 3 spreads and 30 mm of the optimum",
        "a proposal off by that much more along an axis, with a spread of 5 mm",
        "mm",
        lambda m: run.tried(run.resting(0.35), Proposes(run.off_optimum(m), 0.005, 0.02)),
        lambda t: own.beyond_spreads(t) - 30.0,
        0.0,
        0.1,
    )
    yield Break(
        "proposals never sure and more than 60 mm from the optimum",
        "a proposal of which the avoider is sure, off by that much more",
        "mm",
        lambda m: run.tried(run.resting(0.35), Proposes(run.off_optimum(m), 0.005, 0.02)),
        lambda t: own.off_optimum(t, sure=True) - 60.0,
        0.0,
        0.1,
    )
    yield Break(
        "at most 50 % of proposals overruled",
        "one answer in doubt more than half of them",
        "proposal",
        lambda m: run.tried(scenario(STAYS, duration_s=4.0), NowAndThen(doubts=int(m))),
        lambda t: float(
            np.count_nonzero(t.decisions["outcome"] != DecisionOutcome.PROPOSED) - len(t.decisions) // 2
        ),
        0.0,
        40.0,
        whole=True,
    )
    yield Break(
        "acts only on answers within the gate's region",
        "a hand that far outside, behind a gate that does not look",
        "mm",
        run.unheeded,
        lambda t: (
            1e3 * t.scenario.gate.questions_within.hand.low_m[0]
            - 1e3 * t.decisions["hand_position_in_base_m"][:, 0].min()
        ),
        -0.05,
        0.05,
    )


def ways() -> Iterator[Break]:
    """Claims about where a repulsion goes."""
    yield Break(
        AWAY,
        "a way that leads that far towards the hand",
        "mm",
        lambda m: run.tried(run.resting(0.35), Proposes(run.nearer(m)), passing()),
        lambda t: own.towards(t, "chosen_position_in_base_m", "true"),
        -0.05,
        0.05,
    )
    yield Break(
        AWAY,
        "a retreat that much slower",
        "%",
        lambda m: gone(BUILT_IN, Astray(speed=1.0 - m)),
        lambda t: run.behind(t, 0.9, 0.7),
        0.0,
        0.6,
        1e-3,
        100.0,
    )
    yield Break(
        "repulsive ways clear of table, object and robot",
        "a position with the arm that deep in the table, behind a gate that passes everything",
        "mm",
        lambda m: run.tried(run.resting(0.35), Displaced((0.0, 0.0, -m)), passing()),
        own.below_table,
        0.2,
        0.7,
    )
    yield Break(
        "obstacle distance never below 20 mm",
        "a box that much nearer to an arm that turns",
        "mm",
        run.beside_box,
        lambda t: 20.0 - own.from_box(t),
        0.5,
        0.2,
    )


def doubts() -> Iterator[Break]:
    """Claims about doubt, certainty and the fallback."""
    for what, unit, make, oracle, broken, shown in (
        ("a fallback off its direction", "deg", lambda m: Astray(off_deg=m), run.off_direction, 8.0, 1.0),
        ("a fallback that ends that far aside", "mm", lambda m: Astray(aside_m=m), run.astray, 0.02, 1e3),
        (
            "a fallback that much slower",
            "%",
            lambda m: Astray(speed=1.0 - m),
            lambda t: run.behind(t, 0.95, 0.9),
            0.5,
            100.0,
        ),
    ):
        yield Break(
            FALL,
            what,
            unit,
            lambda m, make=make: gone(BUILT_IN, make(m)),
            oracle,
            0.0,
            broken,
            broken / 1000,
            shown,
        )
    yield Break(
        FALL,
        "a fallback that begins that much later than 2 cycles",
        "cycle",
        lambda m: gone(BUILT_IN, Astray(late=int(m))),
        run.late_cycles,
        2.0,
        8.0,
        whole=True,
    )
    yield Break(
        FALL,
        "a gate that hands over a position that much more than 1 mm off",
        "mm",
        lambda m: run.handed_over(IN_DOUBT, m),
        run.misled,
        0.0,
        0.05,
    )
    yield Break(
        USED,
        "a gate that hands over a position that much more than 1 mm off",
        "mm",
        lambda m: run.handed_over(CERTAIN, m),
        lambda t: run.misled(t, "proposed_position_in_base_m"),
        0.0,
        0.05,
    )
    yield Break(
        "stops where neither answer nor opposite pose can be reached",
        "a stop whose way is that much longer, for it comes some cycles late",
        "mm",
        lambda m: run.around(NOTHING, run.GoesOn, m),
        lambda t: own.stop_way_mm(t, int(t.decisions["tick"][0])),
        0.0,
        120.0,
        whole=True,
    )
    yield Break(
        "fallback poses reachable and away",
        "a fallback that leads that far towards the hand",
        "mm",
        lambda m: run.tried(run.resting(0.35), gate=gate_of(Gate, fallback=Proposes(run.nearer(m)))),
        lambda t: own.towards(t, "opposite_position_in_base_m", "true"),
        -0.05,
        0.05,
    )


def reactions() -> Iterator[Break]:
    """Claims about when the arm gives way, and what it is told."""
    yield Break(
        "starts retreating within 100 ms of a predicted hand",
        "a controller whose critical distance is too short gives way that much later",
        "ms",
        lambda m: run.set_up(scenario(VISIT), avoidance={"critical_distance_m": 0.4 - m}),
        lambda t: own.ignored_ms(t, own.predicted_near(t)) - 100.0,
        0.0,
        0.2,
        1e-4,
    )
    yield Break(
        "starts retreating within 100 ms of a true hand",
        "a hand sensor that is blind for too long: the arm gives way that much later",
        "ms",
        lambda m: run.faulty(HandSensorBlind(until_s=m), STAYS),
        lambda t: own.ignored_ms(t, own.true_near(t)) - 100.0,
        0.01,
        2.0,
        1e-3,
    )
    yield Break(
        "reacts within 120 ms",
        "a controller that stops that much later",
        "ms",
        lambda m: run.of_user(scenario(VISIT, duration_s=1.5), StopsLate(int(m))),
        own.braked_late_ms,
        0.0,
        40.0,
        whole=True,
    )
    for sentence in ("never retreats without a hand", "never retreats without a hand within 600 mm"):
        yield Break(
            sentence,
            "an arm that gives way to a hand that much farther off than 600 mm",
            "mm",
            lambda m: run.set_up(run.resting(m), avoidance={"critical_distance_m": 0.9}),
            lambda t: own.alarm_mm(t) - 600.0,
            0.55,
            0.8,
        )
    yield Break(
        "hand predictions within 50 mm",
        "a hand sensor that measures hands that much more than 50 mm off",
        "mm",
        lambda m: run.faulty(HandSensorOff(offset_in_base_m=(m, 0.0, 0.0)), hand(), duration_s=0.6),
        lambda t: own.prediction_off(t) - 50.0,
        0.0,
        0.2,
    )
    yield Break(
        "decisions within 100 ms",
        "an avoider whose answer counts that much later",
        "ms",
        lambda m: run.tried(scenario(VISIT, duration_s=1.5), Slow(m)),
        lambda t: 8.0 * float((t.decisions["tick"] - t.decisions["asked_tick"]).max()) - 100.0,
        0.01,
        0.2,
        1e-4,
    )
    yield Break(
        "the avoider answered",
        "a question without an answer",
        "question",
        lambda m: run.tried(scenario(VISIT), NowAndThen(silent=int(m))),
        lambda t: float(np.count_nonzero(np.isnan(t.decisions["proposed_position_in_base_m"]).any(axis=1))),
        0.0,
        5.0,
        whole=True,
    )


def limits() -> Iterator[Break]:
    """Claims about the arm's own limits."""
    rates = "joint_velocity_radps"
    yield Break(
        "joint positions within limits",
        "a controller that turns the elbow that far beyond its end",
        "deg",
        lambda m: run.driven(scenario(duration_s=1.0), 2, m),
        lambda t: own.DEG * t.ticks["joint_position_rad"][:, 2].max() - 180.0,
        0.5,
        2.0,
    )
    yield Break(
        "joint speeds within limits",
        "a controller that turns a joint that much too fast",
        "deg/s",
        lambda m: run.driven(scenario(duration_s=0.3), 0, m),
        lambda t: own.DEG * np.abs(t.ticks[rates]).max() - own.DEG * 2.16,
        1.0,
        3.0,
    )
    yield Break(
        "TCP speed never above 250 mm/s",
        "a controller that turns a joint, and the TCP goes that much too fast",
        "mm/s",
        lambda m: run.driven(scenario(duration_s=0.3), 0, m),
        lambda t: 1e3 * np.linalg.norm(np.diff(own.tcp_m(t), axis=0), axis=1).max() / 0.008 - 250.0,
        0.1,
        1.0,
    )
    yield Break(
        "joint accelerations never above 500 deg/s2",
        "a controller that starts a joint that much too hard",
        "deg/s2",
        lambda m: run.driven(scenario(duration_s=0.3), 0, m),
        lambda t: own.DEG * np.abs(np.diff(t.ticks[rates], axis=0)).max() / 0.008 - 500.0,
        0.01,
        1.0,
        1e-7,
    )
    yield Break(
        "TCP acceleration never above 2 m/s2",
        "a controller that starts the TCP that much too hard",
        "m/s2",
        lambda m: run.driven(scenario(duration_s=0.3), 0, m),
        lambda t: own.tcp_acceleration(t) - 2.0,
        0.001,
        1.0,
        1e-7,
    )


def tasks() -> Iterator[Break]:
    """Claims about the task and the record."""
    yield Break(
        "object in view or recovered within 2 s",
        "a camera that is blind for that much longer",
        "s",
        lambda m: run.faulty(CameraBlind(from_s=0.5, for_s=m), duration_s=6.0),
        lambda t: own.longest_s(t, ~t.ticks["object_visible"]) - 2.0,
        1.0,
        3.0,
        1e-3,
    )
    for sentence, unit, excess in (
        (
            "gain switch reached",
            "s",
            lambda t: (
                0.008 * own.switch_tick(t) - 1.25 * 0.5 * np.log(own.squared_error(t)[0] / 0.005) / 0.4 - 1.0
            ),
        ),
        ("gain switch reached within 5 s", "s", lambda t: 0.008 * own.switch_tick(t) - 5.0),
        ("gain switch reached within 600 iterations", "iteration", lambda t: own.switch_tick(t) - 600),
    ):
        yield Break(
            sentence,
            "a gain that is too low: the switch is reached that much later",
            unit,
            lambda m: run.set_up(scenario(duration_s=16.0), servo={"gain_far": 0.4 - m}),
            excess,
            0.0,
            0.35,
            1e-5,
        )
    yield Break(
        "converged to the desired pose",
        "a controller that servoes to a place that much more than 1 mm off",
        "mm",
        lambda m: run.set_up(
            scenario(duration_s=80.0),
            cell={"desired_tcp_position_in_base_m": (DESIRED[0], DESIRED[1] + m, DESIRED[2])},
        ),
        lambda t: 1e3 * float(np.sqrt(own.squared_error(t)[-1])) - 1.0,
        0.0,
        0.01,
    )
    yield Break(
        "retreats at most 3 times",
        "a hand that comes once more",
        "time",
        run.returning,
        lambda t: float(
            np.count_nonzero(
                np.diff(np.isin(t.ticks["mode"], (Mode.REPULSING, Mode.PROTECTIVE_STOP)).astype(int)) == 1
            )
            - 3
        ),
        1.0,
        6.0,
        whole=True,
    )
    yield Break(
        "task pauses at most 10 s",
        "a controller that stands still for that much longer",
        "s",
        lambda m: run.around(scenario(duration_s=16.0), run.Idle, m),
        lambda t: own.starved_s(t) - 10.0,
        0.0,
        1500.0,
        whole=True,
    )
    yield Break(
        "keeps its place within 5 mm",
        "a controller that drifts that much farther",
        "mm",
        lambda m: run.of_user(scenario(duration_s=6.0, offset=(0.0, 0.0, 0.0)), Drifts(until_m=m)),
        lambda t: 1e3 * float(np.linalg.norm(own.tcp_m(t) - own.tcp_m(t)[0], axis=1).max()) - 5.0,
        0.004,
        0.02,
    )
    yield Break(
        "trace finite and monotone",
        "a tick with a value that is no number",
        "tick",
        lambda m: run_kinematic(admit(scenario(duration_s=0.1)), controller=Numberless(int(m))),
        lambda t: float(np.count_nonzero(t.ticks["object_visible"] & np.isnan(t.ticks["sse"]))),
        0.0,
        5.0,
        whole=True,
    )


def breaks() -> list[Break]:
    """Every break that is measured, in the catalogue's order."""
    return [*distances(), *positions(), *ways(), *doubts(), *reactions(), *limits(), *tasks()]
