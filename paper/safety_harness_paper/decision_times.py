"""Timing: the network's decision beside the image errors of 100 candidates, computed when they are needed."""

from __future__ import annotations

from statistics import median

from safety_harness.base.settings import DEFAULTS
from safety_harness_paper.avoiders import BAYESIAN, DNN
from safety_harness_paper.intervals import median_of
from safety_harness_paper.measurements import systems
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import ClaimState, PaperClaim, Result, Table, judge, number
from safety_harness_paper.scale import Scale
from safety_harness_paper.timing import EXACT, RASTER, RENDERED, measurement
from safety_harness_paper.work import Task

SAYS = "Using the network is faster than calculating the image-moment errors of the candidates online."


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """One, when nothing else runs."""
    return {"timing": measurement(systems(scale, root, 0), calls=scale.calls, settings=DEFAULTS)}


def result(scale: Scale, found: Found) -> Result:
    """The paper gives no times; the claim is judged with rendered images, as it has them, and with others."""
    seconds: dict[str, list[float]] = found["timing"].result["seconds"]
    claims = [
        quicker(
            "the Bayesian DNN decides faster than 100 images are rendered",
            seconds[BAYESIAN],
            seconds[RENDERED],
        ),
        quicker(
            "the Bayesian DNN decides faster than 100 images are sampled", seconds[BAYESIAN], seconds[RASTER]
        ),
        quicker(
            "the Bayesian DNN decides faster than 100 images are computed in closed form",
            seconds[BAYESIAN],
            seconds[EXACT],
        ),
        quicker(
            "the DNN decides faster than 100 images are computed in closed form", seconds[DNN], seconds[EXACT]
        ),
    ]
    word, why = judge(claims, [])
    slowest = max(median(values) for values in seconds.values())
    return Result(
        name="timing",
        title="The network against 100 images",
        source="Section 1, timing",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        tables=(
            Table(
                "One decision, one call at a time on one core of the machine that made this page; median "
                "with its exact 95 % interval, and the 99th of 100.",
                ("what", "median, \u00b5s", "99 % below, \u00b5s", "times slower than the quickest", "calls"),
                tuple(
                    (
                        name,
                        _micro(values),
                        number(1e6 * sorted(values)[int(0.99 * (len(values) - 1))], 1),
                        number(median(values) / min(median(v) for v in seconds.values()), 1),
                        str(len(values)),
                    )
                    for name, values in seconds.items()
                ),
            ),
        ),
        notes=(
            "Rendered: PyBullet's software renderer, threshold and moments of one image, times 100. All "
            "networks and images are the package's own compiled code; ten passes of the Bayesian DNN.",
            f"The slowest takes {1e3 * slowest:,.0f} ms, the decision deadline is "
            f"{1e3 * DEFAULTS.avoidance.decision_deadline_s:g} ms, a control period "
            f"{1e3 * DEFAULTS.clock.control_period_s:g} ms.",
        ),
    )


def quicker(sentence: str, first: list[float], second: list[float]) -> PaperClaim:
    """By the intervals of the two medians: apart, or undecided."""
    a, b = median_of(first), median_of(second)
    state = (
        ClaimState.HOLDS
        if a.high < b.low
        else ClaimState.CONTRADICTED
        if a.low > b.high
        else ClaimState.UNDECIDED
    )
    return PaperClaim(sentence, state, f"medians {1e6 * a.value:,.1f} and {1e6 * b.value:,.1f} \u00b5s")


def _micro(values: list[float]) -> str:
    found = median_of(values)
    ends = (
        f"[{number(1e6 * found.low, 1)}, {number(1e6 * found.high, 1)}]"
        if found.low > 0.0
        else "[no interval]"
    )
    return f"{number(1e6 * found.value, 1)} {ends}"


PART = Part("timing", tasks, result)
