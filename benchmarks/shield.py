"""What a shield is worth and what it costs: sections of benchmarks/SHIELD.md, written anew.

Run: python benchmarks/shield.py [SECTION]... [--ledgers FOLDER] [--pairs N] [--search N]; the full numbers,
and the campaigns themselves, take days: make shield-all.

*contacts*: what the ledgers of plans/shield-hundred-thousand.yaml and plans/shield-in-pybullet.yaml hold.
*cost*: the same draws of each space with a shield and without one: who comes within 20 mm of the desired
TCP and stays, and when.  *gate*: what share of proposals `every hand within` refuses.  *tick*: the
kinematic loop with and without, in turns.  *search*: told to break the claim, with the margin as its guide,
where all assumptions are true and where one is not.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.trial import run_many
from safety_harness.base.exceptions import InputError
from safety_harness.base.proportions import upper_bound
from safety_harness.base.settings import HandSensorKind
from safety_harness.cell.controller.shield import Guard
from safety_harness.cell.simulation.simulate import Episode
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.summary import StratumTally, tally_of
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.gate import GateRule
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.shield import Shield
from safety_harness.search.cube import Cube
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import searcher_named
from safety_harness.search.trials import ScenarioRunner, Trials, in_kinematic
from safety_harness.space.read import read_space
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[1]
TABLES, CONTACTS = Path(__file__).with_name("SHIELD.md"), Path(__file__).with_name("shield_contacts.json")
SHIELDED = ("shielded/reaching-hands", "shielded/unseen-both")
OF_COST = ("nominal", "unseen-hand", "unseen-tcp", "unseen-both", "reaching-hands", "recorded-variations")
NOISY = OF_COST[-2:]
WITHIN_SHARES = (None, 0.9, 0.99, 0.999)
SPEEDS_MPS = (0.5, 1.0, 1.6, 2.0)
ARRIVED_M, LONG_S = 0.020, 40.0
SEED, BATCH, TURNS = 20261124, 24, 15
PLANS = ("shield-hundred-thousand", "shield-in-pybullet")
FIRST_FORGOTTEN, FAR_M = 4, 10.0  # the links of the wrist and of the tool
SMALL = """settings:
  hand: {forearm length: 10 mm}
  avoidance: {critical distance: 150 mm}
  cell: {preferred joint position: [-14 deg, -82 deg, 116 deg, -124 deg, -90 deg, -104 deg]}
"""  # nothing but one assumption is then in the way
WITHIN = "body within: 60 mm"
SLOWLY = "deceleration: 200 mm/s2, hand acceleration: 100 mm/s2"
KNOWN = f"{SMALL}shield: {{{WITHIN}}}\n"
UR10E = KNOWN + "avoider: opposite pose\nrobot: {arm: shipped:ur10e, drives: {%s}}\n"
UNTOLD = (
    UR10E.replace(WITHIN, f"{WITHIN}, reaction time: 5 s") + "about: its shield is told no reaction time\n"
)
FORGETS = KNOWN + "about: its shield knows nothing of the wrist and of what it carries\n"
STOUT = "300 mm, forearm radius: 150 mm"
FAULTY = KNOWN + "faults:\n  - hand sensor: "
VIOLATED = [  # assumption, how, lines of the space
    ("none", "as it ships", ""),
    ("none", "hands without a forearm, hardly avoided", KNOWN),
    ("none", "measured speeds", f"{SMALL}shield: {{{WITHIN}, hand acceleration: 10 m/s2}}\n"),
    ("none", "a UR10e", UR10E % "dead time: 0 ms"),
    ("1 speed", "a bound of 100 mm/s", f"{SMALL}shield: {{{WITHIN}, hand speed: 100 mm/s}}\n"),
    ("none", "braked at 0.2 m/s2, not 1", f"{SMALL}shield: {{{WITHIN}, deceleration: 200 mm/s2}}\n"),
    ("2 acceleration", "so, and a bound of 0.1 m/s2", f"{SMALL}shield: {{{WITHIN}, {SLOWLY}}}\n"),
    ("3 body", "a forearm 150 mm thick, a bound of 60", KNOWN.replace("10 mm", STOUT, 1)),
    ("4 sight", "the sensor sees nothing", f"{FAULTY}sees nothing\n"),
    ("5 place", "850 mm off", f"{FAULTY}is off\n    offset: [600 mm, -600 mm, 0 mm]\n"),
    ("6 time", "frozen, with new time stamps", f"{FAULTY}freezes\n    from: 100 ms\n"),
    ("7 drives", "a dead time of 100 ms, untold", UNTOLD % "dead time: 100 ms"),
    ("8 deceleration", "drives that lag by 500 ms, untold", UNTOLD % "lag: 500 ms"),
    ("9 shape", "the wrist and all beyond are forgotten", FORGETS),
]
HEAD = """# Shield

Written by `python benchmarks/shield.py`, each section at the revision that it names; the full numbers by
`make shield-all`. [The shield](../docs/explanation/shield.md) has the rule, its proof and its
assumptions.
"""


def file_of(space: str) -> Path:
    """The shielded ones lie beside the plan that they are for."""
    return ROOT / ("plans" if space in SHIELDED else "scenarios/spaces") / f"{space}.yaml"


def draws(
    space: str, count: int, change: Callable[[Scenario], Scenario] = lambda one: one
) -> Iterator[Admitted]:
    """The first ``count`` draws of a shipped space that can be tried, each changed alike."""
    of_space, admitter = read_space(file_of(space)), Admitter()
    found, number = 0, 0
    while found < count:
        try:
            yield admitter.admit(change(of_space.draw(SEED, number)))
            found += 1
        except InputError:
            pass
        number += 1


def contacts(given: argparse.Namespace) -> str:
    """What the ledgers of the two plans hold, with those noted before, and the exact bounds of each world.

    A part (``campaign run PLAN --part 1/37 --ledger FOLDER/PLAN.1of37.sqlite``) is noted in CONTACTS, so that
    it counts when its ledger is gone: by its name, under the source that ran it.
    """
    noted = json.loads(CONTACTS.read_text()) if CONTACTS.exists() else {}
    rows = [
        "| stratum | world | source | episodes | of | came near | touched | failed | at most, of those "
        "| of all | least distance |",
        "|---" * 11 + "|",
    ]
    for name in PLANS:
        plan, sources = read_plan(ROOT / f"plans/{name}.yaml"), noted.setdefault(name, {})
        for path in sorted(given.ledgers.glob(f"{name}*.sqlite")):
            with Ledger.open(path, check=False) as ledger:
                source = dict(ledger.declared.identity.parts)["the source of this package"]
                sources.setdefault(source, {})[path.stem] = [_noted(one) for one in tally_of(ledger).strata]
        told = list(sources.items())
        every = {part: found for _, parts in told for part, found in parts.items()}
        if len({part.partition("of")[2] for part in every}) > 1:
            sys.exit(
                f"{name}: parts of different numbers overlap, and would count episodes twice: {[*every]}"
            )
        if len(told) > 1:
            told.append(("all", every))
        for source, parts in told:
            for k, planned in enumerate(plan.strata):
                cells = [planned.name, plan.world.label, source[:12]]
                rows.append(_together(cells, planned.runs, [one[k] for one in parts.values()]))
    CONTACTS.write_text(json.dumps(noted, indent=1) + "\n")
    text = (
        "A bound is one-sided and exact, and counts an episode that failed as one that was touched; the two "
    )
    text += "of a world hold together with 95 % confidence. *Came near*: a hand within the critical distance "
    text += (
        "of the arm, which the claim asks for; in the others none was near enough to be touched. *Source*: "
    )
    text += "of the package that ran them; *all* holds if no change between them changed what a run does. "
    text += f"What each part of a plan found is in `{CONTACTS.name}`.\n\n"
    return text + "\n".join(rows)


def _noted(one: StratumTally) -> dict[str, float]:
    counts = one.claims[0].counts
    return {
        "done": one.done,
        "held": counts[EpisodeOutcome.HOLDS],
        "violated": counts[EpisodeOutcome.VIOLATED],
        "failed": counts[EpisodeOutcome.FAILED] + counts[EpisodeOutcome.INCONCLUSIVE],
        "worst_m": one.claims[0].worst,
    }


def _together(cells: list[object], planned: int, parts: list[dict[str, float]]) -> str:
    """A line of what several parts of a stratum found."""
    done, held, broken, failed = (
        sum(int(part[key]) for part in parts) for key in ("done", "held", "violated", "failed")
    )
    tested, worst_m = held + broken, float(np.nanmin([part["worst_m"] for part in parts]))
    bounds = [upper_bound(broken + failed, n, 0.05 / len(SHIELDED)) if n else 1.0 for n in (tested, done)]
    cells += [f"{done:,}", f"{planned:,}", f"{tested:,}", broken, failed, *(f"{one:.2g}" for one in bounds)]
    return f"| {' | '.join(map(str, cells))} | {worst_m * 1e3:.0f} mm |"


def longer(scenario: Scenario) -> Scenario:
    """The same with time to arrive, and a sensor that a shield can use."""
    sensor = scenario.settings.hand_sensor
    kind = HandSensorKind.SURROUND if sensor.kind is HandSensorKind.OVERHEAD else sensor.kind
    settings = replace(scenario.settings, hand_sensor=replace(sensor, kind=kind))
    return replace(scenario, duration_s=LONG_S, settings=settings)


def behind(shield: Shield) -> Callable[[Scenario], Scenario]:
    """``longer``, with a shield."""
    return lambda scenario: replace(longer(scenario), shield=shield)


def arrival_s(trace: Trace) -> float:
    """From when on the TCP stays within ARRIVED_M of the desired one; infinite for never."""
    desired = np.array(trace.scenario.settings.cell.desired_tcp_position_in_base_m)
    away = np.linalg.norm(trace.ticks["transform_tcp_to_base"][:, :3, 3] - desired, axis=1) > ARRIVED_M
    if away[-1]:
        return np.inf
    return float(trace.time_s[int(np.flatnonzero(away)[-1]) + 1]) if away.any() else 0.0


def cost(given: argparse.Namespace) -> str:
    """Arrivals and times of the same draws with a shield and without."""
    rows = [
        "| space | hand speed | acceleration | arrive plain | shielded | to 20 mm, plain | shielded | ratio "
        "| above 1.25 | slowed |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for space in OF_COST:
        plain = [arrival_s(one) for one in run_many(draws(space, given.pairs, longer))]
        uncertainty_m = 0.04 if space in NOISY else 0.01
        kinds = [(speed, None) for speed in SPEEDS_MPS] + [(2.0, 10.0)]
        for speed_mps, most_mps2 in kinds:
            shield = Shield(
                hand_speed_mps=speed_mps, hand_acceleration_mps2=most_mps2, uncertainty_m=uncertainty_m
            )
            shielded, slowed = [], []
            for one in run_many(draws(space, given.pairs, behind(shield))):
                shielded.append(arrival_s(one))
                slowed.append(float((one.interventions["scale"] < 1.0).mean()))
            rows.append(_of_pairs(space, speed_mps, most_mps2, plain, shielded, float(np.mean(slowed))))
    text = f"{given.pairs} draws of each space, of {LONG_S:.0f} s, run both ways. Times are medians over the "
    text += (
        "draws that arrive both ways; the ratio is the median of their own, with its 95 % interval by ranks. "
    )
    text += "Hands stay as fast as they are: a bound below their speed is no shield, and only a price.\n\n"
    return text + "\n".join(rows)


def _of_pairs(
    space: str, speed_mps: float, most: float | None, plain: list[float], shielded: list[float], slowed: float
) -> str:
    both = [(a, b) for a, b in zip(plain, shielded, strict=True) if np.isfinite(a) and np.isfinite(b)]
    ratios = sorted((b + 1.0) / (a + 1.0) if a == 0.0 else b / a for a, b in both)
    n = len(ratios)
    reach = 1.96 * 0.5 * np.sqrt(n)
    low, high = max(int(n / 2 - reach), 0), min(int(n / 2 + reach), n - 1)
    arrive = [f"{100.0 * np.mean(np.isfinite(one)):.0f} %" for one in (plain, shielded)]
    of_most = "any" if most is None else f"{most:g} m/s2"
    head = f"| {space} | {speed_mps:g} m/s | {of_most} | {arrive[0]} | {arrive[1]} "
    if n == 0:
        return f"{head}| - | - | - | - | {100 * slowed:.0f} % |"
    times = [f"{statistics.median(column):.1f} s" for column in zip(*both, strict=True)]
    slower = sum(ratio > 1.25 for ratio in ratios) / n
    ratio = f"{statistics.median(ratios):.2f} ({ratios[low]:.2f} to {ratios[high]:.2f})"
    tail = f"{100.0 * slower:.0f} % | {100.0 * slowed:.0f} % |"
    return f"{head}| {times[0]} | {times[1]} | {ratio} | {tail}"


def gate(given: argparse.Namespace) -> str:
    """What share of proposals the gate refuses that has to reckon with every place where a hand may be."""
    rows = ["| space | hands within | proposals | towards a hand | refused in all |", "|---|---|---|---|---|"]
    for space in OF_COST:
        for share in WITHIN_SHARES:
            rule = None if share is None else GateRule(hands_within=share)
            found = Overruling.from_traces(run_many(draws(space, given.pairs, partial(replace, gate=rule))))
            towards = found.reasons[Check.TOWARDS_A_HAND]
            shares = [
                f"{n / max(found.proposals, 1):.1%}".replace("%", " %") for n in (towards, found.overruled)
            ]
            within = "as predicted" if share is None else f"{100.0 * share:g} %"
            rows.append(f"| {space} | {within} | {found.proposals} | {' | '.join(shares)} |")
    text = (
        f"{given.pairs} draws of each space, each run in the kinematic world with every rule; avoiders are "
    )
    return (
        text
        + "the spaces' own, and what they propose depends on what was refused before.\n\n"
        + "\n".join(rows)
    )


def tick(given: argparse.Namespace) -> str:
    """Microseconds a tick in the kinematic world, the sides taking turns."""
    del given

    def without_avoidance(scenario: Scenario) -> Scenario:
        avoidance = replace(scenario.settings.avoidance, critical_distance_m=0.0)
        return replace(scenario, settings=replace(scenario.settings, avoidance=avoidance))

    rows = ["| space | hands | plain | shielded | ratio (least to greatest) |", "|---|---|---|---|---|"]
    for space in SHIELDED:
        sides = {
            "plain": list(draws(space, BATCH, lambda s: replace(without_avoidance(s), shield=None))),
            "shielded": list(draws(space, BATCH, without_avoidance)),
        }
        found: dict[str, list[float]] = {name: [] for name in sides}
        for turn in range(TURNS + 1):
            for name, admitted in sides.items():
                us = _tick_us(admitted)
                if turn:
                    found[name].append(us)
        ratios = [b / a for a, b in zip(*found.values(), strict=True)]
        hands = len(sides["plain"][0].scenario.hands)
        a, b = (statistics.median(one) for one in found.values())
        rows.append(
            f"| {space} | {hands} | {a:.2f} us | {b:.2f} us "
            f"| {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) |"
        )
    text = (
        "The loop of the kinematic world, with hands but without avoidance: both sides do the same but for "
    )
    return text + "the shield; processor time.\n\n" + "\n".join(rows)


def _tick_us(admitted: Sequence[Admitted]) -> float:
    episodes = []
    for one in admitted:
        world = KINEMATIC.open(one.scenario, one.arm, one.joint_position_rad)
        episodes.append(Episode(one.scenario, world.__enter__(), one.servo()))  # type: ignore[arg-type]
    begun_s = time.process_time()
    for episode in episodes:
        while episode.advance():
            pass
    seconds = time.process_time() - begun_s
    return 1e6 * seconds / sum(len(episode.ticks) for episode in episodes)


def search(given: argparse.Namespace) -> str:
    """What the default searcher finds in the shielded spaces, and with one assumption violated."""
    rows = [
        "| space | violated assumption | how | runs | with a verdict | violated | first at "
        "| least distance |",
        "|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for space in SHIELDED:
            for number, (assumption, how, lines) in enumerate(VIOLATED):
                file = Path(folder) / f"{Path(space).name}-{number}.yaml"
                head = f"scenario space: searched\nextends: {file_of(space)}\n"
                file.write_text(head + lines)
                world = forgetting if lines is FORGETS else untold if "untold" in how else in_kinematic
                rows.append(f"| {space} | {assumption} | {how} | {_searched(file, world, given.search)} |")
                print(rows[-1], flush=True)
    text = (
        f"The default searcher of `fuzz`, from seed {SEED}, in the kinematic world, the margin of the claim "
    )
    text += "as its guide. *First at*: the run of the first violation.\n\n"
    return text + "\n".join(rows)


def _searched(file: Path, world: ScenarioRunner, budget: int) -> str:
    """Runs, those with a verdict, those that violate the claim, the first of them, and the least margin."""
    trials = Trials(read_space(file), world, seed=SEED, sentences=(NO_MOVING_PART_TOUCHES.prop.sentence,))
    cube = Cube.from_space(trials.space)
    searcher = searcher_named("default")(cube, claims=len(trials.goals), seed=SEED)
    found = find_violations(cube, trials.goals, trials, searcher, budget=budget, batch=32)
    first = found.first_violation[0] or "-"
    least = f"{found.improvements[0][-1][1] * 1e3:.0f} mm"
    return f"{found.tried} | {found.evidence[0]} | {found.violated[0]} | {first} | {least}"


class Forgets(Admitted):
    """With a shield that knows nothing of the wrist and of what it carries."""

    def guard(self) -> Guard:
        """As it is, but that the capsules of the last links are far inside them."""
        guard = super().guard()
        guard.capsules["radius_m"][guard.capsules["link_index"] >= FIRST_FORGOTTEN] = -FAR_M
        return guard


def forgetting(admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
    """In the kinematic world, each behind a shield that forgets."""
    return in_kinematic([Forgets(**vars(one)) for one in admitted])


class Untold(Admitted):
    """Its shield takes the drives for ones that do at once what they are told."""

    def guard(self) -> Guard:
        """As it is, without a reaction time."""
        guard = super().guard()
        guard.shield["reaction_time_s"] = 0.0
        return guard


def untold(admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
    """In the kinematic world, each behind a shield that knows of no reaction time."""
    return in_kinematic([Untold(**vars(one)) for one in admitted])


SECTIONS = {"contacts": contacts, "cost": cost, "gate": gate, "tick": tick, "search": search}


def revision() -> str:
    """That of what is measured, and whether it was changed since."""
    what = ["safety_harness", "scenarios", "plans", "benchmarks/shield.py"]
    git = [["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--", *what]]
    head, changed = (
        subprocess.run(["git", *one], capture_output=True, text=True, cwd=ROOT).stdout.strip() for one in git
    )
    return f"{head}, changed" if changed else head


def written(section: str, body: str, at: str) -> None:
    """Put a section into the file, in its place."""
    text = TABLES.read_text() if TABLES.exists() else HEAD
    parts = dict(re.findall(r"^## (\w+)\n\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE))
    parts[section.capitalize()] = f"At {at}. {body}\n\n"
    order = [name.capitalize() for name in SECTIONS if name.capitalize() in parts]
    whole = HEAD + "".join(f"\n## {name}\n\n{parts[name].strip()}\n" for name in order)
    TABLES.write_text(whole)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, []], default=[])
    parser.add_argument("--ledgers", type=Path, default=ROOT / "reports/shield")
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--search", type=int, default=300)
    given = parser.parse_args(arguments)
    for name in given.sections or SECTIONS:
        begun_s, at = time.monotonic(), revision()
        body = SECTIONS[name](given)
        took_min = (time.monotonic() - begun_s) / 60.0
        written(name, f"{body}\n\nTook {took_min:.1f} min." if took_min >= 0.1 else body, at)
        print(body, flush=True)


if __name__ == "__main__":
    main()
