"""Make a scenario space from recorded hands, with distributions that are fitted to their approaches.

Each quantity gets the family of distributions that fits its sample best (``fitting``). If no family fits, the
space draws recorded values with equal probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import gammaincc, gammaincinv

from safety_harness.base.elementary import length
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
from safety_harness.scenario.files import display_path
from safety_harness.scenario.write import text_of

LEAST_APPROACHES = 5  # fewer are refused; a quantity with fewer values is not fitted
HARD = 0.5  # times speed / window; the log shows a larger acceleration too small by a tenth or more
WEAK_BELOW = 30  # with fewer values, the test seldom rejects a wrong family
MOST_VALUES = 100  # the most recorded values that a space lists
# Bounds of the quantities in a fit; a choice.  Values beyond them are left out.
LONGEST_S, FARTHEST_M, LEAST_MPS2, HARDEST_MPS2 = 60.0, 2.0, 0.1, 50.0
ELBOW_BEHIND_M = 0.4  # from the mean start of a hand, along the mean direction
AXES = ("x", "y", "z")
SPEED_OF, ACCELERATION, DWELL, PAUSE, END = "speed", "acceleration", "dwell", "pause", "distance at the end"
# The unit in which a space states a quantity, and the units in one SI unit.
FORMS = {"m/s": ("mm/s", 1e3), "m/s2": ("m/s2", 1.0), "s": ("ms", 1e3), "m": ("mm", 1e3)}


@dataclass(frozen=True, kw_only=True)
class FittedQuantity:
    """One quantity of approaches, with its values in SI units, its known bounds, and its fits.

    The best fit comes first.
    """

    name: str
    unit: str
    low: float
    high: float
    values: tuple[float, ...]
    fits: tuple[Fit, ...]

    @property
    def chosen(self) -> Fit | None:
        """The best fit that the test does not reject, or None if the test rejects all fits.

        If it is None, the space lists the recorded values instead.
        """
        return next((f for f in self.fits if not f.rejected), None)

    @property
    def text(self) -> str:
        """The text of the quantity in the file of a space."""
        return self.beside(0.0)

    def beside(self, place: float) -> str:
        """Return the text of the quantity after ``place`` is added to all its values."""
        unit, per_si = FORMS[self.unit]

        def written(value: float) -> str:
            return f"{round((value + place) * per_si, 3):.10g} {unit}"

        best = self.chosen
        if best is None:
            values = np.quantile(self.values, np.linspace(0.0, 1.0, min(len(self.values), MOST_VALUES)))
            texts = list(dict.fromkeys(written(value) for value in values.tolist()))
            return texts[0] if len(texts) == 1 else f"one of {', '.join(texts)}"
        first, second = (best.parameters[key] for key in best.parameters)
        if best.family == "uniform":
            ends = dict.fromkeys((written(first), written(second)))
            return f"from {' to '.join(ends)}" if len(ends) > 1 else written(first)
        bounds = f"from {written(self.low)} to {written(self.high)}"
        return f"normal {written(first)} +- {round(second * per_si, 3):.10g} {unit} {bounds}"


@dataclass(frozen=True, kw_only=True)
class Direction:
    """The mean direction (3,) of approaches in the base frame, with statistics about the directions' spread.

    ``resultant`` r is the length of the mean of the n unit vectors; it is 1 if all directions are the same.
    ``concentration`` is the kappa of a von Mises-Fisher distribution (Sra, 2012). ``any_p_value`` is the
    p-value of Rayleigh's test for uniform directions: 3 n r^2 is chi-square with 3 degrees of freedom.
    """

    mean: tuple[float, float, float]
    resultant: float
    concentration: float
    any_p_value: float


@dataclass(frozen=True, kw_only=True)
class HandsFit:
    """The fits of all quantities, the name and the SHA-256 of each recording, and notes for the user."""

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
    """Fit distributions to the approaches of hands in ``logs``, and return the fits.

    Raise LogError if there are too few approaches.

    Args:
        logs: The logs. Each of them must have hands.
        seed: The seed of the bootstrap.

    """
    watched, recordings = Watched(), _recordings(logs)
    for log in logs:
        watched.add(approaches_of(log))
    approaches = watched.approaches
    if len(approaches) < LEAST_APPROACHES:
        raise LogError(
            place=Place(file=logs[0].file),
            expected=f"{LEAST_APPROACHES} approaches at least, in all the logs",
            got=f"{len(approaches)}, among {watched.moves} moves in {watched.seconds:.1f} s with hands",
            hint=f"one ends 100 mm nearer to the TCP than it began, and within {NEAR_M * 1e3:g} mm of it",
        )
    quantities, lacking = [], []
    for number, (name, unit, low, high, values) in enumerate(_samples(approaches, watched.fastest_mps)):
        if len(values) < LEAST_APPROACHES:
            lacking.append(f"{name}: only {len(values)} values, not fitted")
            continue
        rng = generator(seed, Branch.STATISTICS, number)
        fits = fit(np.array(values), low=low, high=high, rng=rng)
        quantity = FittedQuantity(name=name, unit=unit, low=low, high=high, values=tuple(values), fits=fits)
        quantities.append(quantity)
    hours = watched.seconds / 3600.0
    return HandsFit(
        quantities=tuple(quantities),
        direction=_direction(approaches),
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
    approaches: Sequence[Approach], fastest_mps: float
) -> list[tuple[str, str, float, float, list[float]]]:
    """Return a tuple (name, unit, low, high, values) for each quantity, without values outside the bounds."""
    starts = np.array([a.start_from_tcp_m for a in approaches])
    dwells = [a.dwell_s for a in approaches if a.dwell_s is not None]
    pauses = [a.pause_s for a in approaches if a.pause_s is not None]
    rows = [
        (SPEED_OF, "m/s", MOVES_MPS, fastest_mps, [a.speed_mps for a in approaches]),
        (ACCELERATION, "m/s2", LEAST_MPS2, HARDEST_MPS2, [a.acceleration_mps2 for a in approaches]),
        (DWELL, "s", LEAST_STAND_S, LONGEST_S, dwells),
        (PAUSE, "s", LEAST_STAND_S, LONGEST_S, pauses),
        (END, "m", 0.0, NEAR_M, [a.end_distance_m for a in approaches]),
        *((f"start {x}", "m", -FARTHEST_M, FARTHEST_M, starts[:, k].tolist()) for k, x in enumerate(AXES)),
    ]
    return [
        (name, unit, low, high, [value for value in values if low <= value <= high])
        for name, unit, low, high, values in rows
    ]


def _direction(approaches: Sequence[Approach]) -> Direction:
    starts = np.array([approach.start_from_tcp_m for approach in approaches])
    mean = (starts / np.linalg.norm(starts, axis=1, keepdims=True)).mean(axis=0)
    r = float(length(mean))
    unit = mean / max(r, 1e-12)
    # Sra's approximation for three dimensions; its denominator vanishes for equal directions.
    kappa = r * (3.0 - r**2) / max(1.0 - r**2, 1e-12)
    chi2 = 3.0 * len(approaches) * r**2
    tail = float(gammaincc(1.5, chi2 / 2.0))
    at = (float(unit[0]), float(unit[1]), float(unit[2]))
    return Direction(mean=at, resultant=r, concentration=kappa, any_p_value=tail)


def _rate_interval(count: int, hours: float) -> tuple[float, float]:
    """Return the equal-tailed confidence interval of a Poisson rate (Garwood, 1936)."""
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(gammaincinv(count, tail)) if count else 0.0
    return low / hours, float(gammaincinv(count + 1, 1.0 - tail)) / hours


def _recordings(logs: Sequence[CellLog]) -> tuple[tuple[str, str], ...]:
    """Return the (file, hash) pairs of all logs.

    Raise LogError if two logs share a file, because the time in this file would be added up twice.
    """
    hashes: dict[Path, str] = {}
    for log in logs:
        known = {digest: file for file, digest in hashes.items()}
        for file in log.files:
            digest = sha256_of(file)
            if digest in known:
                raise LogError(
                    place=Place(file=log.file),
                    expected="each recording once",
                    got=f"{display_path(file)}, with the bytes of {display_path(known[digest])}, "
                    "of another log",
                )
            hashes[file] = digest
    return tuple((str(display_path(file)), digest) for file, digest in hashes.items())


def _notes(watched: Watched, quantities: Sequence[FittedQuantity]) -> list[str]:
    notes = []
    if watched.gaps:
        notes.append(f"{watched.gaps} gaps exceed the stated longest gap: motion in them does not count")
    if watched.cut:
        notes.append(f"{watched.cut} moves with an unseen beginning or end are only counted")
    if more := watched.counted - watched.cut - len(watched.approaches):
        notes.append(f"{more} more counted: reaches that turned back without a stand, or came in a gap")
    hard = sum(item.acceleration_mps2 > HARD * item.speed_mps / WINDOW_S for item in watched.approaches)
    if hard:
        notes.append(f"{hard} accelerations are too small, since a speed is a mean over {WINDOW_S:g} s")
    for item in quantities:
        if item.chosen is None:
            notes.append(f"{item.name}: no family fits, so that the recorded values stand for themselves")
        elif len(item.values) < WEAK_BELOW:
            notes.append(f"{item.name}: with {len(item.values)} values a wrong family is seldom found")
    notes.append(
        "approaches count as independent: the interval is too narrow where the same people come many times"
    )
    notes.append("quantities are drawn independently: correlations between them are lost")
    return notes


def space_text(fitted: HandsFit) -> str:
    """Return the text of a scenario space.

    While the arm is at its desired pose, hands approach the arm with the recorded distributions.
    """
    by_name = {item.name: item for item in fitted.quantities}
    tcp = Settings().cell.desired_tcp_position_in_base_m
    starts = [by_name[f"start {axis}"].beside(place) for axis, place in zip(AXES, tcp, strict=True)]
    mean = [float(np.mean(by_name[f"start {axis}"].values)) for axis in AXES]
    elbow = [p + m + ELBOW_BEHIND_M * d for p, m, d in zip(tcp, mean, fitted.direction.mean, strict=True)]
    stay: list[Tree] = [{"wait": by_name[DWELL].text}] if DWELL in by_name else []
    speed, varied = by_name[SPEED_OF].text, ("from ", "normal ", "one of ")
    choices: dict[str, Tree] = {"choices": {"reach speed": speed}} if speed.startswith(varied) else {}
    speed = "the reach speed" if choices else speed
    come: dict[str, Tree] = {
        "reach for tcp": speed,
        "stop at distance": by_name[END].text,
        "give up after": "4 s",
    }
    pause: list[Tree] = [{"wait": by_name[PAUSE].text}] if PAUSE in by_name else []
    # As many approaches as the recorded rate leads to in the 20 s of a run.
    times = max(1, round(fitted.per_hour / 3600.0 * 20.0))
    moves: list[Tree] = [*pause, come, *stay, {"withdraw": speed}]
    repeated: Tree = {"repeat": f"from 1 to {times} times", "moves": moves}
    tree: dict[str, Tree] = {
        "scenario space": "hands as they were recorded",
        "about": scalar_text(
            f"Fitted to {fitted.approaches} approaches in {fitted.hours * 60.0:.1f} min of hands."
        ),
        "duration": "20 s",
        "avoider": "opposite pose",
        **choices,
        "tcp start": {"offset": ["0 mm", "0 mm", "0 mm"]},
        "hands": [
            {
                "hand": "recorded hand",
                "acceleration at most": by_name[ACCELERATION].text,
                "speed at most": f"{fitted.fastest_mps:.10g} m/s",
                "starts at": [scalar_text(item) for item in starts],
                "elbow towards": [f"{round(item * 1e3, 1):.10g} mm" for item in elbow],
                "moves": [repeated] if times > 1 else moves,
            }
        ],
        "claims": {"hand distance never below 50 mm": "holds", "repulsive poses reachable": "holds"},
    }
    return "".join(f"# {line}\n" for line in _comments(fitted)) + text_of(tree)


def _comments(fitted: HandsFit) -> list[str]:
    """Return the comments at the beginning of the space's file."""
    low, high = fitted.per_hour_interval
    lines = [
        f"Written by: safety-harness hands fit --seed {fitted.seed}",
        f"approaches per hour: {fitted.per_hour:.0f} ({low:.0f} to {high:.0f}, {CONFIDENCE:.0%})",
        *(line for quantity in fitted.quantities for line in quantity_lines(quantity)),
        direction_line(fitted.direction),
        *fitted.notes,
    ]
    return [*lines, *(f"{digest} {name}" for name, digest in fitted.recordings)]


def quantity_lines(quantity: FittedQuantity) -> list[str]:
    """Return one line for each fit of ``quantity``, or one line that says that no family can be fitted."""
    unit, per_si = FORMS[quantity.unit]
    lines = []
    for each in quantity.fits:
        values = ", ".join(
            f"{key} {each.parameters[key] * per_si:.4g} ({low * per_si:.4g} to {high * per_si:.4g})"
            for key, (low, high) in each.intervals.items()
        )
        verdict = "rejected" if each.rejected else "taken" if each is quantity.chosen else "not rejected"
        text = f"{each.family}: {values} {unit}; A2 = {each.distance:.3f}, p = {each.p_value:.3f}, {verdict}"
        lines.append(f"{quantity.name}, {len(quantity.values)} values, {text}")
    return lines or [f"{quantity.name}, {len(quantity.values)} values: both families fail to fit"]


def direction_line(trend: Direction) -> str:
    """Return a line of text about the direction of approaches."""
    at = ", ".join(f"{x:+.2f}" for x in trend.mean)
    return (
        f"from the direction ({at}) of the TCP, in the base frame: resultant {trend.resultant:.2f}, kappa "
        f"{trend.concentration:.2f}; any direction alike: p = {trend.any_p_value:.2g}"
    )
