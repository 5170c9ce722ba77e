"""Figure 5: repulsive candidates on the quarter sphere about a TCP."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.extensions.lab.learning.dataset import candidates_of, seen
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.extensions.lab.learning.image_error import ImageErrors
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import (
    Panel,
    Plot,
    Result,
    Series,
    Table,
    every,
    judge,
)
from safety_harness_paper.scale import Scale
from safety_harness_paper.work import Json, Task

PAIRS = 2000
_DRAW = 10
SAYS = (
    "The candidates are in the opposite direction of the hand, on a quarter of a sphere about the TCP, "
    "Gaussian; using a quarter sphere will lead the robot away from the hand."
)


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """A picture's worth."""
    arguments = (("seed", leaf(root, _DRAW)), ("settings", DEFAULTS))
    return {"candidates": Task("figure 5's candidates", measure, arguments)}


def measure(folder: Path, *, seed: int, settings: Settings) -> Json:
    """One TCP's candidates with the selected one, and how many of many lead away from a seen hand."""
    rng = np.random.default_rng(seed)
    space, cap = seen(settings), CandidateCap.from_settings(settings)
    tcps, hands = space.tcp.draw(rng, PAIRS), space.hand.draw(rng, PAIRS)
    candidates = candidates_of(settings, tcps, seed, np.arange(PAIRS))  # (pairs, 100, 3)
    offsets = candidates - tcps[:, None]
    best, _ = ImageErrors.from_settings(settings).select(candidates[:1])
    nominal = np.array(settings.avoidance.nominal_hand_position_in_base_m)

    def farther(hand: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> int:
        before = np.linalg.norm(tcps - hand, axis=1)[:, None]
        return int(np.count_nonzero(np.linalg.norm(candidates - hand[:, None], axis=2) > before))

    return {
        "tcp": tcps[0].tolist(),
        "candidates": candidates[0].tolist(),
        "selected": candidates[0, int(best[0])].tolist(),
        "desired": list(settings.cell.desired_tcp_position_in_base_m),
        "hand": nominal.tolist(),
        "all": offsets.shape[0] * offsets.shape[1],
        "in_cap": int(
            np.count_nonzero(offsets @ cap.axis_in_base >= cap.radius_m * (np.cos(cap.cone_rad) - 1e-9))
        ),
        "farther_from_nominal": farther(np.broadcast_to(nominal, tcps.shape).copy()),
        "farther_from_seen": farther(hands),
    }


def result(scale: Scale, found: Found) -> Result:
    """Seen from above and from the side."""
    one = found["candidates"].result
    claims = [
        every("every candidate lies on the quarter sphere", one["in_cap"], one["all"]),
        every(
            "every candidate is farther from the hand at its nominal place than the TCP is",
            one["farther_from_nominal"],
            one["all"],
        ),
        every(
            "every candidate is farther from the hand, wherever in its space it is, than the TCP is",
            one["farther_from_seen"],
            one["all"],
        ),
    ]
    word, why = judge(claims, [])
    return Result(
        name="figure5",
        title="Candidates on the quarter sphere",
        source="Figure 5",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        plots=(_plot(one),),
        tables=(
            Table(
                f"Candidates of {PAIRS:,} TCPs, each with one hand of the seen space.",
                ("candidates", "farther from the nominal hand", "farther from the hand of its pair"),
                (
                    (
                        f"{one['all']:,}",
                        f"{100.0 * one['farther_from_nominal'] / one['all']:.1f} %",
                        f"{100.0 * one['farther_from_seen'] / one['all']:.1f} %",
                    ),
                ),
            ),
        ),
        notes=(
            "Radius (100 mm) and sigma (45 degrees in azimuth and elevation) are not in the paper. The "
            "quarter sphere is fixed about the direction from the nominal hand to the desired TCP, one set "
            "for each TCP.",
        ),
    )


def _plot(one: Json) -> Plot:
    def view(x: int, y: int, title: str, labels: tuple[str, str]) -> Panel:
        def cloud(name: str, points: list[list[float]]) -> Series:
            return Series(name, tuple(1e3 * p[x] for p in points), tuple(1e3 * p[y] for p in points))

        return Panel(
            kind="map",
            title=title,
            x_label=labels[0],
            y_label=labels[1],
            series=(
                cloud("candidates", one["candidates"]),
                cloud("TCP", [one["tcp"]]),
                cloud("desired TCP", [one["desired"]]),
                cloud("selected", [one["selected"]]),
            ),
        )

    return Plot(
        title="100 candidates of one TCP",
        caption="Positions in the robot's base frame, millimetres. The selected candidate has the least "
        "image error. "
        "The hand's nominal place is (840, \u2212350, 5) mm, far below and to the right.",
        panels=(
            view(0, 1, "From above", ("x, mm", "y, mm")),
            view(1, 2, "From the side", ("y, mm", "z, mm")),
        ),
    )


PART = Part("figure5", tasks, result)
