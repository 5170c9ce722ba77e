"""Recorded hands as a scenario space: what they did, as distributions that a space can have.

A quantity whose sample has the one or the other distribution (``fitting``) becomes it; of one that has
neither, the recorded values stand for themselves, each as probable as another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import gammaincc, gammaincinv

from safety_harness.base.exceptions import LogError, Place
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import Settings
from safety_harness.base.whole_file import sha256_of
from safety_harness.extensions.field.fitting import CONFIDENCE, Fit, fit
from safety_harness.extensions.field.logs.approaches import (
    LEAST_STAND_S,
    MOVES_MPS,
    NEAR_M,
    WINDOW_S,
    Approach,
    Watched,
    approaches_of,
)
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.scenario.codec import Tree, scalar_text
from safety_harness.scenario.files import told
from safety_harness.scenario.write import text_of

LEAST_APPROACHES = 5
HARD = 0.5  # of the speed over the window: from there on an acceleration comes out too small, by a tenth
WEAK_BELOW = 30  # values, with which a wrong family is seldom found
MOST_VALUES = 100  # that stand for themselves in a space
LONGEST_S, FARTHEST_M, LEAST_MPS2, HARDEST_MPS2 = 60.0, 2.0, 0.1, 50.0
ELBOW_BEHIND_M = 0.4
AXES = ("x", "y", "z")
SPEED_OF, ACCELERATION, DWELL, PAUSE, END = "speed", "acceleration", "dwell", "pause", "distance at the end"
FORMS = {"m/s": ("mm/s", 1e3), "m/s2": ("m/s2", 1.0), "s": ("ms", 1e3), "m": ("mm", 1e3)}


@dataclass(frozen=True, kw_only=True)
class FittedQuantity:
    """One quantity of approaches: its values in SI, known bounds, and what was fitted to it, best first."""

    name: str
    unit: str
    low: float
    high: float
    values: tuple[float, ...]
    fits: tuple[Fit, ...]

    @property
    def chosen(self) -> Fit | None:
        """The best fit that is not rejected; None where the values stand for themselves."""
        return next((one for one in self.fits if not one.rejected), None)

    @property
    def text(self) -> str:
        """As a space has it."""
        return self.beside(0.0)

    def beside(self, place: float) -> str:
        """The same of values that are so much more."""
        unit, per_si = FORMS[self.unit]

        def written(value: float) -> str:
            return f"{round((value + place) * per_si, 3):.10g} {unit}"

        one = self.chosen
        if one is None:
            values = np.quantile(self.values, np.linspace(0.0, 1.0, min(len(self.values), MOST_VALUES)))
            texts = list(dict.fromkeys(written(value) for value in values.tolist()))
            return texts[0] if len(texts) == 1 else f"one of {', '.join(texts)}"
        first, second = (one.parameters[key] for key in one.parameters)
        if one.family == "uniform":
            ends = dict.fromkeys((written(first), written(second)))
            return f"from {' to '.join(ends)}" if len(ends) > 1 else written(first)
        bounds = f"from {written(self.low)} to {written(self.high)}"
        return f"normal {written(first)} +- {round(second * per_si, 3):.10g} {unit} {bounds}"


@dataclass(frozen=True, kw_only=True)
class Direction:
    """Where approaches come from: the mean direction (3,) in the base frame, and how much they agree.

    ``resultant`` is the length of the mean of their directions, from 0 (any) to 1 (all the same), and
    ``concentration`` the kappa of a von Mises-Fisher distribution (Sra, 2012); ``any_p_value`` that of
    Rayleigh's test of directions that are uniform over the sphere (3 n r^2 is chi-square with 3 degrees).
    """

    mean: tuple[float, float, float]
    resultant: float
    concentration: float
    any_p_value: float


@dataclass(frozen=True, kw_only=True)
class HandsFit:
    """All that was fitted, of which recordings (their name and SHA-256), and what a reader has to know."""

    quantities: tuple[FittedQuantity, ...]
    direction: Direction
    approaches: int
    hours: float
    per_hour: float
    per_hour_interval: tuple[float, float]
    fastest_mps: float
    recordings: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    seed: int


def fit_hands(logs: Sequence[CellLog], *, seed: int) -> HandsFit:
    """What the hands of ``logs`` did; LogError for too few approaches to say anything of them."""
    watched, recordings = Watched(), _recordings(logs)
    for log in logs:
        watched.add(approaches_of(log))
    found = watched.approaches
    if len(found) < LEAST_APPROACHES:
        raise LogError(
            place=Place(file=logs[0].file),
            expected=f"{LEAST_APPROACHES} approaches at least, in all the logs",
            got=f"{len(found)}, among {watched.moves} moves in {watched.seconds:.1f} s with hands",
            hint=f"one ends 100 mm nearer to the TCP than it began, and within {NEAR_M * 1e3:g} mm of it",
        )
    quantities, lacking = [], []
    for number, (name, unit, low, high, values) in enumerate(_samples(found, watched.fastest_mps)):
        if len(values) < LEAST_APPROACHES:
            lacking.append(f"{name}: only {len(values)} values, not fitted")
            continue
        rng = generator(seed, Branch.STATISTICS, number)
        fits = fit(np.array(values), low=low, high=high, rng=rng)
        one = FittedQuantity(name=name, unit=unit, low=low, high=high, values=tuple(values), fits=fits)
        quantities.append(one)
    hours = watched.seconds / 3600.0
    return HandsFit(
        quantities=tuple(quantities),
        direction=_direction(found),
        approaches=watched.counted,
        hours=hours,
        per_hour=watched.counted / hours,
        per_hour_interval=_rate_interval(watched.counted, hours),
        fastest_mps=watched.fastest_mps,
        recordings=recordings,
        notes=(*_notes(watched, quantities), *lacking),
        seed=seed,
    )


def _samples(
    found: Sequence[Approach], fastest_mps: float
) -> list[tuple[str, str, float, float, list[float]]]:
    """(name, unit, low, high, values) of each quantity, without what is beyond its bounds."""
    starts = np.array([one.start_from_tcp_m for one in found])
    dwells = [one.dwell_s for one in found if one.dwell_s is not None]
    pauses = [one.pause_s for one in found if one.pause_s is not None]
    rows = [
        (SPEED_OF, "m/s", MOVES_MPS, fastest_mps, [one.speed_mps for one in found]),
        (ACCELERATION, "m/s2", LEAST_MPS2, HARDEST_MPS2, [one.acceleration_mps2 for one in found]),
        (DWELL, "s", LEAST_STAND_S, LONGEST_S, dwells),
        (PAUSE, "s", LEAST_STAND_S, LONGEST_S, pauses),
        (END, "m", 0.0, NEAR_M, [one.end_distance_m for one in found]),
        *((f"start {a}", "m", -FARTHEST_M, FARTHEST_M, starts[:, k].tolist()) for k, a in enumerate(AXES)),
    ]
    return [
        (name, unit, low, high, [value for value in values if low <= value <= high])
        for name, unit, low, high, values in rows
    ]


def _direction(found: Sequence[Approach]) -> Direction:
    starts = np.array([one.start_from_tcp_m for one in found])
    mean = (starts / np.linalg.norm(starts, axis=1, keepdims=True)).mean(axis=0)
    r = float(np.linalg.norm(mean))
    unit = mean / max(r, 1e-12)
    kappa = r * (3.0 - r**2) / max(1.0 - r**2, 1e-12)
    chi2 = 3.0 * len(found) * r**2
    tail = float(gammaincc(1.5, chi2 / 2.0))
    at = (float(unit[0]), float(unit[1]), float(unit[2]))
    return Direction(mean=at, resultant=r, concentration=kappa, any_p_value=tail)


def _rate_interval(count: int, hours: float) -> tuple[float, float]:
    """Of a Poisson process (Garwood, 1936): at most CONFIDENCE's rest on either side."""
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(gammaincinv(count, tail)) if count else 0.0
    return low / hours, float(gammaincinv(count + 1, 1.0 - tail)) / hours


def _recordings(logs: Sequence[CellLog]) -> tuple[tuple[str, str], ...]:
    """Their files and hashes; LogError for a file that two logs have, since its time would count twice."""
    found: dict[Path, str] = {}
    for log in logs:
        known = {digest: file for file, digest in found.items()}
        for file in log.files:
            digest = sha256_of(file)
            if digest in known:
                raise LogError(
                    place=Place(file=log.file),
                    expected="each recording once",
                    got=f"{told(file)}, with the bytes of {told(known[digest])}, of another log",
                )
            found[file] = digest
    return tuple((str(told(file)), digest) for file, digest in found.items())


def _notes(watched: Watched, quantities: Sequence[FittedQuantity]) -> list[str]:
    found = []
    if watched.gaps:
        found.append(f"{watched.gaps} gaps longer than said: what was going on there is left out")
    if watched.cut:
        found.append(f"{watched.cut} moves whose beginning or end was not seen are counted, no more")
    if more := watched.counted - watched.cut - len(watched.approaches):
        found.append(f"{more} more counted: reaches that turned back without a stand, or came in a gap")
    hard = sum(one.acceleration_mps2 > HARD * one.speed_mps / WINDOW_S for one in watched.approaches)
    if hard:
        found.append(
            f"{hard} accelerations are too small, as a speed is over {WINDOW_S:g} s: hands sped up harder"
        )
    for one in quantities:
        if one.chosen is None:
            found.append(f"{one.name}: no family fits, so that the recorded values stand for themselves")
        elif len(one.values) < WEAK_BELOW:
            found.append(f"{one.name}: with {len(one.values)} values a wrong family is seldom found")
    found.append(
        "approaches count as independent: the interval is too narrow where the same people come many times"
    )
    found.append("quantities are drawn one by one: what goes together in people is not kept")
    return found


def space_text(found: HandsFit) -> str:
    """A scenario space: hands that come as the recorded ones did, to an arm at its desired pose."""
    by_name = {one.name: one for one in found.quantities}
    tcp = Settings().cell.desired_tcp_position_in_base_m
    starts = [by_name[f"start {axis}"].beside(place) for axis, place in zip(AXES, tcp, strict=True)]
    mean = [float(np.mean(by_name[f"start {axis}"].values)) for axis in AXES]
    elbow = [p + m + ELBOW_BEHIND_M * d for p, m, d in zip(tcp, mean, found.direction.mean, strict=True)]
    stay: list[Tree] = [{"wait": by_name[DWELL].text}] if DWELL in by_name else []
    speed, words = by_name[SPEED_OF].text, ("from ", "normal ", "one of ")
    choices: dict[str, Tree] = {"choices": {"reach speed": speed}} if speed.startswith(words) else {}
    speed = "the reach speed" if choices else speed
    come: dict[str, Tree] = {"reach for tcp": speed, "until": by_name[END].text, "at most": "4 s"}
    pause: list[Tree] = [{"wait": by_name[PAUSE].text}] if PAUSE in by_name else []
    times = max(1, round(found.per_hour / 3600.0 * 20.0))
    moves: list[Tree] = [*pause, come, *stay, {"withdraw": speed}]
    repeated: Tree = {"repeat": f"from 1 to {times} times", "moves": moves}
    tree: dict[str, Tree] = {
        "scenario space": "hands as they were recorded",
        "about": scalar_text(
            f"Fitted to {found.approaches} approaches in {found.hours * 60.0:.1f} min of hands."
        ),
        "duration": "20 s",
        "avoider": "opposite pose",
        **choices,
        "tcp start": {"offset": ["0 mm", "0 mm", "0 mm"]},
        "hands": [
            {
                "hand": "recorded hand",
                "acceleration at most": by_name[ACCELERATION].text,
                "speed at most": f"{found.fastest_mps:.10g} m/s",
                "starts at": [scalar_text(one) for one in starts],
                "elbow towards": [f"{round(one * 1e3, 1):.10g} mm" for one in elbow],
                "moves": [repeated] if times > 1 else moves,
            }
        ],
        "claims": {"hand distance never below 50 mm": "holds", "repulsive poses reachable": "holds"},
    }
    return "".join(f"# {line}\n" for line in _comments(found)) + text_of(tree)


def _comments(found: HandsFit) -> list[str]:
    """What the file says of itself, in comments."""
    low, high = found.per_hour_interval
    lines = [
        f"Written by: safety-harness hands fit --seed {found.seed}",
        f"approaches per hour: {found.per_hour:.0f} ({low:.0f} to {high:.0f}, {CONFIDENCE:.0%})",
        *(line for one in found.quantities for line in quantity_lines(one)),
        direction_line(found.direction),
        *found.notes,
    ]
    return [*lines, *(f"{digest} {name}" for name, digest in found.recordings)]


def quantity_lines(one: FittedQuantity) -> list[str]:
    """What was fitted to one quantity, a family a line."""
    unit, per_si = FORMS[one.unit]
    lines = []
    for each in one.fits:
        values = ", ".join(
            f"{key} {each.parameters[key] * per_si:.4g} ({low * per_si:.4g} to {high * per_si:.4g})"
            for key, (low, high) in each.intervals.items()
        )
        verdict = "rejected" if each.rejected else "taken" if each is one.chosen else "not rejected"
        words = f"{each.family}: {values} {unit}; A2 = {each.distance:.3f}, p = {each.p_value:.3f}, {verdict}"
        lines.append(f"{one.name}, {len(one.values)} values, {words}")
    return lines or [f"{one.name}, {len(one.values)} values: neither family can be fitted"]


def direction_line(found: Direction) -> str:
    """Where approaches come from, in words."""
    at = ", ".join(f"{one:+.2f}" for one in found.mean)
    return (
        f"from the direction ({at}) of the TCP, in the base frame: resultant {found.resultant:.2f}, kappa "
        f"{found.concentration:.2f}; any direction alike: p = {found.any_p_value:.2g}"
    )
