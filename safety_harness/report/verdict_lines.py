"""Print verdicts on a terminal: all verdicts of a single run, or only unexpected verdicts of many runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from safety_harness.claims.properties.against import SCALES
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.hand_distance import nearest_hand
from safety_harness.claims.properties.tally import made_in
from safety_harness.report.evidence import SEVERITY, JudgedRun
from safety_harness.report.words import tested_words
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

MOST_LINES = 20  # verdicts of each kind that a summary of many runs prints; -v prints all
BEFORE_S = 2.0  # the time before a contact in which hand and arm approached each other
LONGEST = 60  # characters to which the sentences of claims are padded


@dataclass(frozen=True)
class ClaimLine:
    """The texts that describe the verdict on one claim of a run.

    Args:
        run: The scenario's name.
        sentence: The sentence of the claim.
        evaluation: The evaluation of the claim.
        words: The verdict, such as "holds" or "violated, as expected". It is in capitals if the file expects
            another verdict.
        remark: The verdict that the file expects instead, or the avoider for which the file expects this
            verdict. In all other cases, the text is empty.
        differs: Whether the file expects another verdict.

    """

    run: str
    sentence: str
    evaluation: Evaluation
    words: str
    remark: str
    differs: bool

    @property
    def moment(self) -> str:
        """The time of the margin, or a dash if there is no margin."""
        time_s = self.evaluation.worst_time_s
        return "-" if time_s is None or self.evaluation.margin is None else f"{time_s:.3f} s"

    @property
    def margin(self) -> str:
        """The margin and its moment, or an empty text if there is no margin."""
        if self.evaluation.margin is None:
            return ""
        when = "" if self.moment == "-" else f" at {self.moment}"
        return f"{self.evaluation.margin_text()}{when}"

    @property
    def rank(self) -> tuple[bool, int, float]:
        """The key by which claims are sorted.

        Unexpected verdicts come first. Then graver verdicts come first, and then smaller margins. Each margin
        is divided by the scale of its unit.
        """
        evaluation = self.evaluation
        margin = inf if evaluation.margin is None else evaluation.margin / SCALES[evaluation.unit]
        return not self.differs, SEVERITY.index(evaluation.verdict), margin


def lines_of(run: JudgedRun) -> Iterator[ClaimLine]:
    """Yield the verdict on each claim of a run, in the order of its file."""
    place = run.trace.scenario.places.get("avoider")
    overridden = place.field if place is not None and (place.field or "").startswith("--") else ""
    for (claim, evaluation), same in zip(run.judged_claims(), run.as_expected, strict=True):
        text, remark = evaluation.verdict.value, ""
        if not evaluation.applicable:
            text = "not applicable"
        elif not same:
            text, remark = text.upper(), f" (expected {claim.expectation})"
        elif evaluation.verdict is not Verdict.HOLDS:
            text += ", as expected"
        if overridden and claim.is_loosely(evaluation.verdict):
            remark = f" (expected of another than {overridden}: it may be for another reason)"
        yield ClaimLine(run.trace.scenario.name, claim.sentence, evaluation, text, remark, not same)


def every_line(run: JudgedRun) -> Iterator[str]:
    """Yield a line for each claim of a run.

    Further lines state missing measurements, the nearest hand, and the tested system.
    """
    for line in lines_of(run):
        columns = f"{line.words:<25} {line.evaluation.margin_text():>13} at {line.moment:>9}"
        yield f"{columns}  {line.run}: {line.sentence}{line.remark}"
        if line.evaluation.unmeasured:
            yield f"     {line.evaluation.reason}"
    nearest = nearest_hand_words(run.trace)
    yield from [f"     {nearest}"] * bool(nearest)
    yield tested_line(run)


def block_of(run: JudgedRun) -> Iterator[str]:
    """Yield the lines on a single run.

    The lines state the tested system, then the claims, and then the nearest hand. The worst claim comes
    first. If the nearest hand explains a claim's verdict, the line on this hand follows the first such claim.
    Otherwise, the line on this hand comes last.
    """
    lines = sorted((line for line in lines_of(run) if line.evaluation.applicable), key=lambda line: line.rank)
    yield f"{tested_line(run)}, in {made_in(run.trace)}, seed {run.trace.scenario.seed}"
    nearest = nearest_hand_words(run.trace)
    wide = max((len(line.words) for line in lines), default=0)
    longest = min(max((len(line.sentence) for line in lines), default=0), LONGEST)
    for line in lines:
        yield f"{line.words:<{wide}}  {line.sentence:<{longest}}  {line.margin}{line.remark}".rstrip()
        if line.differs or line.evaluation.verdict is not Verdict.HOLDS:
            is_nearest = f": {line.evaluation.reason} at " in nearest
            yield f"{'':{wide}}  {nearest if is_nearest else line.evaluation.reason}"
            nearest = "" if is_nearest else nearest
    yield from [nearest] * bool(nearest)


def nearest_hand_words(trace: Trace) -> str:
    """Describe the nearest approach of a hand: distance, hand, part of the arm, and time.

    The text begins with "contact" if the hand touched the arm. For a simulated contact, the text adds the
    highest speeds of hand and tool shortly before the contact. The text is empty for a run without hands, or
    if the distance was not measured.
    """
    nearest = nearest_hand(trace)
    if nearest.margin is None or nearest.worst_time_s is None:
        return ""
    moment = f"{nearest.reason} at {nearest.worst_time_s:.3f} s"
    if nearest.verdict is not Verdict.VIOLATED or not trace.known.simulated:
        return f"{'contact' if nearest.verdict is Verdict.VIOLATED else 'nearest hand'}: {moment}"
    period_s = trace.scenario.settings.clock.control_period_s
    last = min(int(nearest.worst_time_s / period_s), len(trace.ticks) - 1)
    moments = trace.ticks[max(last - int(BEFORE_S / period_s), 0) : last + 1]
    hand = int(np.argmin(moments["hand_distance_m"][-1]))
    moments = moments[moments["hand_present"][:, hand]]
    hand_m, tcp_m = moments["hand_position_in_base_m"][:, hand], moments["transform_tcp_to_base"][:, :3, 3]
    steps_m = [np.linalg.norm(np.diff(path_m, axis=0), axis=1).max(initial=0.0) for path_m in (hand_m, tcp_m)]
    hand_words, tcp_words = (f"at up to {1e3 * step_m / period_s:.0f} mm/s" for step_m in steps_m)
    return f"contact: {moment}; before, the hand moved {hand_words}, the tool {tcp_words}"


def surprise_lines(runs: Sequence[JudgedRun]) -> Iterator[str]:
    """Yield a line for each unexpected verdict of ``runs``, and then for each inconclusive verdict."""
    lines = [line for run in runs for line in lines_of(run) if line.evaluation.applicable]
    differing = sorted((line for line in lines if line.differs), key=lambda line: line.rank)
    undecided = [
        line for line in lines if not line.differs and line.evaluation.verdict is Verdict.INCONCLUSIVE
    ]
    for group in (differing, undecided):
        for line in group[:MOST_LINES]:
            yield f"{line.words}  {line.run}: {line.sentence}  {line.margin}{line.remark}".rstrip()
            yield f"    {line.evaluation.reason}"
        if len(group) > MOST_LINES:
            yield f"... {len(group) - MOST_LINES} more like these; -v prints every verdict"


def tested_line(run: JudgedRun) -> str:
    """Return a line that states the scenario and the tested system of ``run``."""
    return f"tested in {run.trace.scenario.name}: {tested_words(run.trace.scenario, run.trace.system)}"
