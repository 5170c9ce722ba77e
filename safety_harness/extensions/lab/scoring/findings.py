"""Derive findings on an avoider: failures, and statistics that are clearly worse than every yardstick's.

Yardsticks are reference avoiders that answer the same questions. A fraction is worse if its exact interval
lies above the worst yardstick's interval by more than a margin. A length is worse if it exceeds the worst
yardstick's length by more than a given factor. An answer towards the hand is worse only if the answers of all
yardsticks to the same question lead away from the hand. ``FindingLimits`` lists every limit and the reason
for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.proportions import Proportion
from safety_harness.cell.avoidance.asking import Question
from safety_harness.cell.avoidance.measures import WRONG_M, gained_m
from safety_harness.extensions.lab.scoring.scorecard import (
    AskedAgain,
    Figure,
    Jumps,
    Kind,
    Moved,
    RegionScore,
    Scorecard,
    ScoredQuestion,
    ScoreFinding,
)

MM = 1e3  # millimetres per metre, or milliseconds per second


@dataclass(frozen=True)
class FindingLimits:
    """The limits beyond which a statistic becomes a finding."""

    # The share of answers that lead towards the hand where no yardstick does.  For sure answers it is the
    # margin above the worst yardstick's share.
    towards: float = 0.02
    unreached: float = 0.002
    wrong_and_sure: float = 0.002
    unsure: float = 0.03
    doubtful: float = 0.10  # doubt is no finding where a yardstick doubts more often: it may be right there
    stuck: float = 0.0005  # share of answers with an equal coordinate; a yardstick has no such answers
    stuck_least: int = 10  # answers; in single precision a few have an equal coordinate by chance
    off_factor: float = 1.25  # times the worst yardstick's median, 95 % and 99 % quantile
    most_factor: float = 1.5  # times the worst yardstick's largest distance, over ten thousand questions
    bias_m: float = 0.003  # added to bias_factor times the worst yardstick's; mc-dropout has 4 mm in "seen"
    bias_factor: float = 1.5
    pull: float = 0.020  # m per m above the worst yardstick; eq. 13 asks for 0.05, mc-dropout errs by 0.008
    scale: float = 0.060  # m per m above the worst yardstick
    jumped: int = 2  # segments; a single one may pass very near a point where the optimum itself turns
    # Times the worst yardstick's slope, if the hand moves.  A moving TCP has no limit, because the optimum
    # turns abruptly when the TCP is near its desired position.
    steep: float = 4.0
    too_sure: float = 1.25  # error to spread: times the larger of 1 and mc-dropout's ratio
    too_unsure: float = 0.70  # error to spread: times the smaller of 1 and mc-dropout's ratio
    rank: float = 0.05  # below both rank correlations: mc-dropout's and the honest spreads'
    same_m: float = 1e-9  # the size of a batch may change the order of a sum, and so an answer by 1e-16 m
    same_steps: float = 4.0  # the same limit for answers in single precision, in steps of that format
    late: int = 4  # answers after the deadline: other work of this machine may delay a few


LIMITS = FindingLimits()


def findings(
    card: Scorecard, yardsticks: Sequence[Scorecard], limits: FindingLimits = LIMITS
) -> tuple[ScoreFinding, ...]:
    """Return the findings on an avoider: first for each region, then for the avoider as a whole.

    The function skips a region whose questions cannot occur in a run.

    Args:
        card: The avoider's card.
        yardsticks: The cards of the yardsticks, for the same regions, questions and seed.
        limits: The limits.

    Raises:
        ValueError: The regions of a yardstick differ from those of ``card``.

    """
    result: list[ScoreFinding] = []
    for number, score in enumerate(card.regions):
        beside = [entry.regions[number] for entry in yardsticks]
        if any(entry.region != score.region for entry in beside):
            raise ValueError("expected yardsticks of the same regions")
        if score.asked_in_runs:
            result += _of_region(score, beside, limits)
    for jumps in card.jumps:
        jumps_beside = [
            entry
            for yardstick in yardsticks
            for entry in yardstick.jumps
            if (entry.region, entry.moved) == (jumps.region, jumps.moved)
        ]
        result += _of_jumps(jumps, jumps_beside, limits)
    step_m = max((entry.step_m for entry in card.regions), default=0.0)
    same_m = max(limits.same_m, limits.same_steps * step_m if step_m < 1e-6 else 0.0)
    result += _of_repeats(card.repeats, same_m)
    result += _of_times(card, limits)
    return tuple(result)


def _of_region(
    score: RegionScore, beside: Sequence[RegionScore], limits: FindingLimits
) -> Iterator[ScoreFinding]:
    """Yield the findings on the answers in one region."""
    if score.answered is not None and score.answered.count < score.answered.trials:
        missing, faults = score.answered.trials - score.answered.count, score.answers.faults
        rows = np.flatnonzero(~score.answers.given)[:3]
        text = (
            f"no answer to {missing} of {score.answered.trials:,} questions; "
            f"the first: {faults[int(rows[0])]}"
        )
        yield ScoreFinding(
            Kind.NO_ANSWER, score.region, text, tuple(score.questions.single(int(row)) for row in rows)
        )
    if score.off_m is None:
        return
    yield from _towards(score, beside, limits)
    yield from _shares(score, beside, limits)
    if score.stuck and score.stuck.count >= limits.stuck_least and score.stuck.low > limits.stuck:
        text = f"{_percent(score.stuck)} of the answers have the very same coordinate"
        yield ScoreFinding(Kind.STUCK, score.region, text)
    yield from _lengths(score, beside, limits)
    yield from _spreads(score, beside, limits)


def _shares(
    score: RegionScore, beside: Sequence[RegionScore], limits: FindingLimits
) -> Iterator[ScoreFinding]:
    """Yield a finding for each fraction that exceeds the worst yardstick's fraction by its margin."""
    rules: tuple[
        tuple[Kind, Callable[[RegionScore], Proportion | None], float, str, tuple[ScoredQuestion, ...]], ...
    ] = (
        (
            Kind.OUT_OF_REACH,
            _unreached,
            limits.unreached,
            "are out of reach or too near the table",
            score.worst_off,
        ),
        (
            Kind.WRONG_AND_SURE,
            lambda score_of: score_of.wrong_and_sure,
            limits.wrong_and_sure,
            f"are more than {WRONG_M * MM:g} mm off the optimum with no spread above the threshold",
            score.worst_off,
        ),
        (
            Kind.SURE_AND_UNSAFE,
            lambda score_of: score_of.sure_and_unsafe,
            limits.towards,
            "lead towards the hand or out of reach with no spread above the threshold",
            score.worst_gained,
        ),
        (
            Kind.UNSURE,
            lambda score_of: score_of.above_threshold,
            limits.unsure,
            "have a spread above the avoider's own threshold",
            (),
        ),
    )
    for kind, share_of, margin, text, shown in rules:
        mine = share_of(score)
        theirs = [share for score_of in beside if (share := share_of(score_of)) is not None]
        if mine is None or not theirs:
            continue
        worst = max(theirs, key=lambda score_of: score_of.high)
        if kind is Kind.UNSURE and worst.share > limits.doubtful:
            continue  # doubt is right where the training had no data
        if mine.low > worst.high + margin:
            yield ScoreFinding(
                kind,
                score.region,
                f"{_percent(mine)} of the answers {text}; the yardsticks at most {_percent(worst)}",
                _questions(shown),
            )


def _towards(
    score: RegionScore, beside: Sequence[RegionScore], limits: FindingLimits
) -> Iterator[ScoreFinding]:
    """Yield a finding if too many answers lead towards the hand.

    The function ignores a question if a yardstick's answer to it leads towards the hand too.

    It compares question by question, because avoiders with equal fractions may err on different questions.
    """
    count = min(len(scored.questions) for scored in (score, *beside))  # the questions that all cards have
    own, *theirs = (_leads_towards(scored, count) for scored in (score, *beside))
    alone = own & ~np.any(theirs, axis=0)
    share = Proportion.from_rows(alone)
    if share.low > limits.towards:
        text = f"{_percent(share)} of the answers lead towards the hand where each yardstick leads away"
        shown = tuple(score.questions.single(int(row)) for row in np.flatnonzero(alone)[:3])
        yield ScoreFinding(Kind.LEADS_TOWARDS, score.region, text, shown)


def _leads_towards(score: RegionScore, count: int) -> NDArray[np.bool_]:
    """Return whether each of the first answers leads towards the hand, shape (count,).

    The value for a missing answer is False.
    """
    questions, answers = score.questions[:count], score.answers[:count]
    return np.asarray(
        gained_m(questions.hands_in_base_m, questions.tcps_in_base_m, answers.positions_in_base_m) < 0.0
    )


def _unreached(score: RegionScore) -> Proportion | None:
    """Return the fraction of answers that the arm cannot reach."""
    return None if score.in_reach is None else _complement(score.in_reach)


def _complement(share: Proportion) -> Proportion:
    """Return the complement of a fraction, that is, 1 minus the fraction."""
    return Proportion(share.trials - share.count, share.trials, 1.0 - share.high, 1.0 - share.low)


def _lengths(
    score: RegionScore, beside: Sequence[RegionScore], limits: FindingLimits
) -> Iterator[ScoreFinding]:
    """Yield findings on the distances from the optimum, on the mean error, and on the slopes of the error."""
    assert score.off_m is not None
    assert score.off_most_m is not None
    shown = _questions(score.worst_off)
    for name, number in (("half", 0), ("5 %", 1), ("1 %", 2)):
        mine = score.off_m[number]
        worst = max((each.off_m[number] for each in beside if each.off_m), key=lambda each: each.high)
        if mine.low > limits.off_factor * worst.high:
            text = (
                f"{name} of the answers are more than {_mm(mine)} off the optimum; "
                f"the worst yardstick: {_mm(worst)}"
            )
            yield ScoreFinding(Kind.FAR_OFF, score.region, text, shown)
            break
    most = max(each.off_most_m for each in beside if each.off_most_m is not None)
    if score.off_most_m > limits.most_factor * most:
        text = (
            f"up to {score.off_most_m * MM:.0f} mm off the optimum; the yardsticks up to {most * MM:.0f} mm"
        )
        yield ScoreFinding(Kind.WORST_CASE, score.region, text, shown)
    bias, least = _bias_m(score), limits.bias_factor * max(map(_bias_m, beside)) + limits.bias_m
    if bias > least:
        text = (
            f"{bias * MM:.1f} mm off on average, {_vector(score)} mm along x, y, z; "
            f"the limit is {least * MM:.1f} mm"
        )
        yield ScoreFinding(Kind.BIASED, score.region, text)
    for kind, size_of, more, of_what in (
        (Kind.HAND_PULL, _pull_off, limits.pull, "hand"),
        (Kind.SCALE, _scale_off, limits.scale, "TCP"),
    ):
        slope, limit = size_of(score), max(map(size_of, beside)) + more
        if slope > limit:
            text = (
                f"the error grows by {slope * MM:.0f} mm a metre of the {of_what}'s position; "
                f"the limit is {limit * MM:.0f}"
            )
            yield ScoreFinding(kind, score.region, text)


def _bias_m(score: RegionScore) -> float:
    """Return the length of the mean error [m]."""
    return (
        0.0
        if score.bias_in_base_m is None
        else float(np.linalg.norm([axis.value for axis in score.bias_in_base_m]))
    )


def _vector(score: RegionScore) -> str:
    """Return a text with the mean error along x, y and z [mm]."""
    assert score.bias_in_base_m is not None
    return ", ".join(f"{axis.value * MM:+.1f}" for axis in score.bias_in_base_m)


def _pull_off(score: RegionScore) -> float:
    """Return the largest slope of the error with respect to the hand's position [m/m]."""
    return 0.0 if score.pull is None else float(np.abs(np.array(score.pull)).max())


def _scale_off(score: RegionScore) -> float:
    """Return the largest slope of the error with respect to the TCP's position [m/m]."""
    return 0.0 if score.scale is None else float(np.abs(np.array(score.scale)).max())


def _spreads(
    score: RegionScore, beside: Sequence[RegionScore], limits: FindingLimits
) -> Iterator[ScoreFinding]:
    """Yield findings on spreads that are too small, too large, or not correlated with the errors."""
    mine, theirs = score.spreads, [scored.spreads for scored in beside if scored.spreads is not None]
    if mine is None or not theirs:
        return
    their = theirs[-1]
    ratio, axes = mine.error_to_spread, np.array(mine.by_axis)
    # The interval of the ratio over all axes, relative to the ratio, also serves for each axis.
    low, high = (ratio.low / ratio.value, ratio.high / ratio.value) if ratio.value else (1.0, 1.0)
    most = limits.too_sure * max(1.0, *their.by_axis)
    least = limits.too_unsure * min(1.0, *their.by_axis)
    for kind, row, exceeds, limit in (
        (Kind.SPREAD_MISSES, int(axes.argmax()), low * axes.max() > most, f"at most {most:.2f}"),
        (Kind.SPREAD_WIDE, int(axes.argmin()), high * axes.min() < least, f"at least {least:.2f}"),
    ):
        if exceeds:
            text = f"along {'xyz'[row]} the errors are {axes[row]:.2f} times the spreads, and may be {limit}"
            yield ScoreFinding(kind, score.region, text, _questions(score.worst_off))
    if their.rank is not None:
        got = mine.rank or Figure(0.0, 0.0, 0.0)
        promised = mine.honest_rank if mine.rank else 1.0  # a constant spread ranks nothing
        if got.high < min(their.rank.low, promised) - limits.rank:
            text = (
                f"rank correlation of spread and error {got.value:.2f}; mc-dropout's is "
                f"{their.rank.value:.2f}, and honest spreads like these would have {mine.honest_rank:.2f}"
            )
            yield ScoreFinding(Kind.SPREAD_UNRANKED, score.region, text)


def _of_jumps(jumps: Jumps, beside: Sequence[Jumps], limits: FindingLimits) -> Iterator[ScoreFinding]:
    """Yield findings on answers that jump or change steeply between neighbouring questions."""
    most = max((each.jumped.count for each in beside if each.jumped), default=0)
    if jumps.largest and jumps.jumped and jumps.jumped.count >= most + limits.jumped:
        largest = jumps.largest
        text = (
            f"jumps by up to {largest.change_m * MM:.1f} mm where {jumps.moved.value} moves by a nanometre, "
            f"on {jumps.jumped.count} of {jumps.segments:,} segments; the limit is "
            f"{jumps.limit_m * MM:.3g} mm"
        )
        yield ScoreFinding(Kind.JUMPS, jumps.region, text, (largest.before, largest.after))
    slope = _slope(jumps)
    limit = limits.steep * max(1.0, *(_slope(each) for each in beside))
    if jumps.moved is Moved.HAND and jumps.steepest and slope > limit:
        text = (
            f"the answer moves by {slope:.1f} mm a millimetre of the hand's way; the limit is {limit:.1f} mm"
        )
        yield ScoreFinding(Kind.STEEP, jumps.region, text, (jumps.steepest.before, jumps.steepest.after))


def _slope(jumps: Jumps) -> float:
    """Return the steepest slope of the answers.

    The function first subtracts two steps of the number format from the change of the answer.
    """
    if jumps.steepest is None:
        return 0.0
    return max(jumps.steepest.change_m - 2.0 * jumps.step_m, 0.0) / jumps.steepest.apart_m


def _of_repeats(repeats: Iterable[AskedAgain], same_m: float) -> Iterator[ScoreFinding]:
    """Yield a finding for each way of asking again that changed an answer by more than ``same_m``."""
    for repeat in repeats:
        if repeat.largest_m > same_m:
            text = (
                f"{repeat.differ} of {repeat.questions:,} answers differ, "
                f"by up to {repeat.largest_m * MM:.3g} mm, when {repeat.way.value}"
            )
            yield ScoreFinding(Kind.NOT_REPEATED, "", text, () if repeat.first is None else (repeat.first,))


def _of_times(card: Scorecard, limits: FindingLimits) -> Iterator[ScoreFinding]:
    """Yield findings on answer times that exceed the deadline or the declared time."""
    times = card.times
    if times is None:
        return
    deadline = f"the deadline is {times.deadline_s * MM:g} ms"
    if times.declared_s > times.deadline_s:
        yield ScoreFinding(Kind.SLOW, "", f"declares {times.declared_s * MM:g} ms for a decision; {deadline}")
    if times.p99_s > times.deadline_s or times.late >= limits.late:
        text = (
            f"{times.late} of {times.questions:,} answers took longer, up to {times.most_s * MM:.0f} ms; "
            f"{deadline}"
        )
        yield ScoreFinding(Kind.SLOW, "", text)
    elif times.p99_s > times.declared_s > 0.0:
        text = (
            f"1 % of the answers took longer than {times.p99_s * MM:.1f} ms; "
            f"it declares {times.declared_s * MM:g} ms"
        )
        yield ScoreFinding(Kind.SLOW, "", text)


def _questions(shown: tuple[ScoredQuestion, ...]) -> tuple[Question, ...]:
    """Return the first three questions of ``shown``."""
    return tuple(row.question for row in shown[:3])


def _percent(share: Proportion) -> str:
    return f"{100 * share.share:.3g} % ({share.count:,} of {share.trials:,})"


def _mm(figure: Figure) -> str:
    return f"{figure.value * MM:.1f} mm"
