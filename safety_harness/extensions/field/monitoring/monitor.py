"""Monitor one stream: make ticks from its samples, and judge the claims at every tick.

The monitor judges a tick as soon as joints arrive whose time is at or after this tick. Until the next sample
of a hand, the hand may be anywhere that its latest sample allows. When the next sample arrives, the monitor
judges the ticks since the previous sample again. The verdicts then equal the verdicts on a log with both
samples.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from math import inf

import numpy as np

from safety_harness.base.exceptions import FormulaError, StreamError
from safety_harness.claims.formulas.claim import WORST_FIRST
from safety_harness.claims.formulas.signals import hand_distance
from safety_harness.extensions.field.logs.streams import NS, SHORTEST_STEP_NS
from safety_harness.extensions.field.monitoring.cell import WatchedCell
from safety_harness.extensions.field.monitoring.journal import Journal
from safety_harness.extensions.field.monitoring.sample import Sample, line_error, read_sample
from safety_harness.extensions.field.monitoring.sensing import MEASURED, HandTracks, Sensing, TickSeen
from safety_harness.extensions.field.monitoring.tracks import BodyTrack, JointTrack, Jump
from safety_harness.extensions.field.monitoring.watched import WatchedClaim
from safety_harness.scenario.model import Verdict

NO_SAFETY_FUNCTION = (
    "this monitor is no safety function: it stops nothing, and nothing may rely on it to protect a person"
)
FARTHEST_AHEAD_S = 60.0  # a line further ahead of the latest one has a wrong time, or another clock
LATENCY_S = 0.1  # hands may come this much after the joints, and ticks are still judged again
WAITING_HANDS = 100  # lines of hands that are kept until the first joints come
FORGETS_EVERY = 10  # ticks


@dataclass
class StreamCounts:
    """The numbers of lines, samples and ticks in a stream so far."""

    lines: int = 0
    refused: int = 0  # lines that cannot be used, at least in part
    out_of_order: int = 0  # joints or hands that came after later ones, whether they were used or too late
    late: int = 0  # joints or hands that were left out, since later ones were used already
    repeated: int = 0  # joints or hands that were left out, since others of the same time were used
    ticks: int = 0
    missing: int = 0  # ticks in a gap of the joints, or without joints within a period
    lost: int = 0  # ticks at which the arm or a hand was lost when they were first judged
    silent: int = 0  # times that no joints came for their longest gap


@dataclass(frozen=True, kw_only=True)
class VerdictLine:
    """One line of output with two verdicts on a claim.

    ``verdict`` is for the run so far, and ``latest`` is for the latest tick.
    """

    time_s: float
    claim: str
    verdict: Verdict
    latest: Verdict
    margin: float | None
    unit: str
    reason: str

    @property
    def as_dict(self) -> dict[str, object]:
        """Return the line as a dictionary of JSON values, for programs."""
        return asdict(self) | {"verdict": self.verdict.value, "latest": self.latest.value}

    told = as_dict  # deprecated: the old name, for one release


@dataclass(kw_only=True)
class Monitor:
    """A monitor of the claims of ``cell`` on one stream.

    Each line waits until the times in the stream have advanced by ``wait_s``. A later line with an earlier
    time can therefore still be used in the right order. The monitor writes the samples that it uses to
    ``journal``. It raises FormulaError if it cannot watch a claim. If ``some`` is True, it adds such claims
    to ``unwatched`` instead, and raises the error only if it can watch no claim.
    """

    cell: WatchedCell
    wait_s: float = 0.0
    some: bool = False
    unwatched: dict[str, FormulaError] = field(default_factory=dict)
    journal: Journal | None = None
    counts: StreamCounts = field(default_factory=StreamCounts)

    def __post_init__(self) -> None:
        cell = self.cell
        self._joints = JointTrack(cell.joint_facts, cell.period_ns, cell.arm)
        self._with_speeds = cell.joint_facts.speeds_known_to_radps is not None
        self._hands: dict[str, HandTracks] = {}
        for hand in cell.hands:
            own, elbow = (BodyTrack(cell.hand_facts, cell.clock_known_to_s, cell.period_ns) for _ in range(2))
            self._hands[hand.name] = HandTracks(own, elbow if hand.elbow else None if hand.forearm else own)
        self._sensing = Sensing(cell, tuple(self._hands.values()))
        revisable = int((cell.hand_facts.longest_gap_s + LATENCY_S) / cell.period_s) + 4
        self.claims: list[WatchedClaim] = []
        for claim in cell.scenario.claims:
            try:
                self.claims.append(self._watched(claim.sentence, revisable))
            except FormulaError as error:
                self.unwatched[claim.sentence] = error
        if self.unwatched and not (self.some and self.claims):
            raise next(iter(self.unwatched.values()))
        self.time_s = 0.0
        period = Fraction(repr(cell.period_s))  # the decimal as written, as for the signal elapsed time
        self._exact = float(period.numerator), float(period.denominator)
        self._told: list[tuple[Verdict, Verdict] | None] = [None] * len(self.claims)
        self._better_since_s = [inf] * len(self.claims)
        self._waiting: list[tuple[float, int, Sample]] = []
        self._newest_s = -inf  # on the joints' clock
        self._latest_of: dict[str, float] = {}  # the latest times of the joints and of each hand
        self._origin_ns: int | None = None
        self._early: deque[tuple[int, Sample]] = deque(maxlen=WAITING_HANDS)
        self._moments: deque[TickSeen] = deque(maxlen=revisable + 1)
        self._next = 0  # the number of the next tick
        self._stale = 0  # the first tick to judge again
        self._silent = False
        self._unused = 0  # lines since the last used joints, without lines that have only hands

    def _watched(self, sentence: str, revisable: int) -> WatchedClaim:
        measured = all(hand.elbow or not hand.forearm for hand in self.cell.hands)
        known = [signal for signal in MEASURED if measured or signal is not hand_distance]
        try:
            return WatchedClaim(sentence, known, self.cell.period_s, revisable)
        except FormulaError as error:
            hint = error.hint
            if not measured and hand_distance.words in error.got:
                hint = "the forearm is not measured, and may be anywhere about the hand"
            got = error.got if sentence in error.got else f'{error.got}, in "{sentence}"'
            raise FormulaError(place=error.place, expected=error.expected, got=got, hint=hint) from None

    def take(self, line: bytes) -> Iterator[VerdictLine]:
        """Process the next line, and yield the verdicts that change.

        If the line or a part of it cannot be used, count it as refused and raise StreamError.
        """
        self.counts.lines += 1
        self._unused += 1
        number = self.counts.lines
        try:
            count, speeds = len(self.cell.arm.joint_names), self._with_speeds
            sample = read_sample(line, number, joints=count, hands=self._hands.keys(), speeds=speeds)
            time_s = sample.time_s - self._ahead_s(sample)
            if -inf < self._newest_s + FARTHEST_AHEAD_S < time_s:
                expected = f"a time within {FARTHEST_AHEAD_S:g} s of the latest one, {self._newest_s:.10g} s"
                hint = "a clock that jumped is another run: begin again"
                raise line_error(number, "time_s", expected, f"{sample.time_s:.10g} s", hint)
        except StreamError:
            self.counts.refused += 1
            raise
        kinds = {"joints"} if sample.joint_position_rad is not None else set()
        self._unused -= not kinds
        for kind in kinds | sample.hands.keys():
            self.counts.out_of_order += sample.time_s < self._latest_of.get(kind, -inf)
            self._latest_of[kind] = max(sample.time_s, self._latest_of.get(kind, -inf))
        self._newest_s = max(self._newest_s, time_s)
        heapq.heappush(self._waiting, (time_s, number, sample))
        # No line with an earlier time can still come within ``wait_s``, so these lines are used in order of
        # time.
        while self._waiting and self._waiting[0][0] <= self._newest_s - self.wait_s:
            yield from self._use(*heapq.heappop(self._waiting)[1:])

    def _ahead_s(self, sample: Sample) -> float:
        """Return by how much [s] the clock of ``sample`` is ahead of the joints' clock.

        If a line has joints, its time is on the joints' clock; otherwise it is on the hands' clock.
        """
        return self.cell.hands_ahead_ns / NS if sample.joint_position_rad is None else 0.0

    def silent(self) -> Iterator[VerdictLine]:
        """Yield the verdicts that become unknown because no joints came for their longest gap."""
        if not self._silent and self.counts.ticks:
            self._silent, self.counts.silent = True, self.counts.silent + 1
            yield from self._changes(self._silence)

    def end(self) -> Iterator[VerdictLine]:
        """Use the waiting lines, and yield the last verdicts that change.

        If the last part of the stream has no joints for longer than the longest gap, the state at the end is
        unknown.
        """
        while self._waiting:
            yield from self._use(*heapq.heappop(self._waiting)[1:])
        yield from self._judge_again()
        if self._joints.last is not None and self._origin_ns is not None:
            without_s = self._newest_s - (self._origin_ns + self._joints.last[0]) / NS
            gap_s = self.cell.joint_facts.longest_gap_s
            if max(without_s, self._unused * self.cell.period_s) > gap_s:
                yield from self.silent()

    @property
    def _silence(self) -> str:
        """Return the reason why the present state is unknown, or an empty text if it is known."""
        gap_s = self.cell.joint_facts.longest_gap_s
        return f"no joints that can be used came for {gap_s * 1e3:g} ms" if self._silent else ""

    def verdicts(self) -> list[VerdictLine]:
        """Return the present line of every claim; during a silence, the present state is unknown."""
        return [self._change(claim, self._silence) for claim in self.claims]

    def _use(self, number: int, sample: Sample) -> Iterator[VerdictLine]:
        """Use all valid parts of ``sample``; then raise StreamError if some part was not usable."""
        time_ns, problems = round(sample.time_s * NS), []
        if sample.joint_position_rad is not None and self._origin_ns is None:
            self._origin_ns = time_ns
            for early in self._early:
                problems += self._use_hands(*early)
            self._early.clear()
        if self._origin_ns is None:
            self._early.append((time_ns, sample))
            return
        problems += self._use_hands(time_ns, sample)
        grown = sample.joint_position_rad is not None
        if grown:
            try:
                self._use_joints(time_ns - self._origin_ns, sample)
            except Jump as error:
                problems.append(("joint_position_rad", str(error)))
        if grown:  # hands without joints affect verdicts when the next joints come
            yield from self._judge()
        if problems:
            self.counts.refused += 1
            name, got = problems[0]
            hint = 'another unit, marker or clock from here on? faster than is said? or "repeats: at rest"'
            raise line_error(number, name, "a sample that the stated speeds allow", got, hint)

    def _use_hands(self, time_ns: int, sample: Sample) -> list[tuple[str, str]]:
        """Use the hands of ``sample``; return (field, reason) for each position that cannot be used."""
        assert self._origin_ns is not None
        problems = []
        at_ns = time_ns - self.cell.hands_ahead_ns - self._origin_ns
        for name, hand in sample.hands.items() if self._hands else ():
            tracks = self._hands[name]
            if hand is None or not any(hand.hand_position_in_base_m):  # trackers send zeros if they see none
                for track in tracks:
                    if track is not None and track.takes(at_ns):
                        track.lost = True
                self._stale = min(self._stale, max(self._next - 1, 0))
                continue
            last_ns = [track.samples[-1][0] for track in tracks if track is not None and track.samples]
            if last_ns and at_ns - max(last_ns) < SHORTEST_STEP_NS:
                self._count_late(at_ns - max(last_ns))
                continue
            used: list[bool] = []
            for body, track, place in (
                ("hand", tracks.hand, hand.hand_position_in_base_m),
                ("elbow", tracks.elbow, hand.elbow_position_in_base_m),
            ):
                used.append(False)
                again = body == "elbow" and track is tracks.hand
                if track is None or place is None or again or not any(place):
                    continue
                position_m = np.array(place)
                try:
                    track.refuse_jump(at_ns, position_m)
                except Jump as error:
                    problems.append((f"hands.{name}.{body}_position_in_base_m", str(error)))
                    track.lost = True
                    continue
                # The new sample changes the line from the last sample on, so all ticks since then are stale.
                since_ns = track.samples[-1][0] if track.samples else at_ns - track.reaches_ns
                if (frozen_ns := track.add(at_ns, position_m)) is not None:
                    problems.append((f"hands.{name}.{body}_position_in_base_m", self._frozen(frozen_ns)))
                    since_ns = min(since_ns, frozen_ns)
                self._stale = max(min(self._stale, since_ns // self.cell.period_ns), 0)
                used[-1] = True
            if self.journal is not None and any(used):
                elbow = hand.elbow_position_in_base_m
                place = hand.hand_position_in_base_m if used[0] else None
                self.journal.hand(name, time_ns, place, elbow if used[1] else None)
        return problems

    def _count_late(self, later_ns: int) -> None:
        self.counts.repeated += later_ns > -SHORTEST_STEP_NS
        self.counts.late += later_ns <= -SHORTEST_STEP_NS

    def _use_joints(self, time_ns: int, sample: Sample) -> None:
        """Add the joints of ``sample`` to their track; raise Jump if they cannot follow the last joints."""
        track, position_rad = self._joints, sample.joint_position_rad
        assert position_rad is not None
        if track.last is not None and time_ns - track.last[0] < SHORTEST_STEP_NS:
            self._count_late(time_ns - track.last[0])
            return
        position = track.unwrapped(time_ns, np.array(position_rad))
        before_ns = track.last[0] if track.last is not None else time_ns
        rates = np.array(sample.joint_velocity_radps) if self._with_speeds else None
        frozen_ns = track.add(time_ns, position, rates)
        if self.journal is not None:
            assert self._origin_ns is not None
            self.journal.joints(time_ns + self._origin_ns, position_rad, sample.joint_velocity_radps)
        self._silent, self._unused = False, 0
        period_ns = self.cell.period_ns
        since_ns = before_ns if frozen_ns is None else frozen_ns
        self._stale = max(min(self._stale, since_ns // period_ns), 0)
        # A tick at a sample's time has the speed of the span that begins there, and this span is known only
        # now.
        if self._moments and before_ns % period_ns == 0 and self._moments[-1].tick == before_ns // period_ns:
            self._moments[-1].rates_radps = track.at(before_ns)[1]
        self.counts.missing += max((time_ns - before_ns) // period_ns - 1, 0)
        if frozen_ns is not None:
            raise Jump(self._frozen(frozen_ns))

    def _frozen(self, since_ns: int) -> str:
        """Return a message about a stream that has repeated its numbers since a certain time.

        This time is ``since_ns`` on the joints' clock.
        """
        assert self._origin_ns is not None
        since_s = (self._origin_ns + since_ns) / NS
        return (
            f"the same numbers to the last bit from {since_s:.3f} s on, though the stream has noise elsewhere"
        )

    def _judge(self) -> Iterator[VerdictLine]:
        """Judge each new tick up to the time of the last joints."""
        assert self._joints.last is not None
        while self._next * self.cell.period_ns <= self._joints.last[0]:
            tick = self._next
            position, rates = self._joints.at(tick * self.cell.period_ns)
            elapsed_s = float(tick) * self._exact[0] / self._exact[1]
            self._moments.append(TickSeen(tick, elapsed_s, position, rates))
            self._next, self.counts.ticks = tick + 1, self.counts.ticks + 1
            yield from self._judge_again(grown=True)
            self.counts.lost += self._moments[-1].lost

    def _judge_again(self, *, grown: bool = False) -> Iterator[VerdictLine]:
        """Repeat the judgement of the ticks about which new samples give more information.

        ``grown`` is True if the last tick is new.
        """
        moments = [moment for moment in self._moments if moment.tick >= self._stale]
        if not moments:
            return
        assert self._origin_ns is not None
        self.time_s = (self._origin_ns + moments[-1].tick * self.cell.period_ns) / NS
        errors = [self._joints.errors_at(moment.tick) for moment in moments]
        first = len(self._moments) - len(moments)
        # The bounds of a tick extend to the next tick, so the tick before the first stale tick changes too.
        if first > 0:
            moments.insert(0, self._moments[first - 1])
        seen = self._sensing.see(moments, len(moments) - len(errors), errors)
        for claim in self.claims:
            claim.see(seen, moments[0].tick, grown=grown)
        self._stale = self._next
        if (oldest := self._moments[0].tick) % FORGETS_EVERY == 0:
            self._forget(oldest)
        yield from self._changes()

    def _forget(self, first_kept: int) -> None:
        self._joints.forget(first_kept)
        for tracks in self._hands.values():
            for track in tracks:
                if track is not None:
                    track.forget(first_kept)

    def _changes(self, silence: str = "") -> Iterator[VerdictLine]:
        """Yield the verdicts that have changed.

        A worse verdict is reported immediately. A better verdict is reported after a delay, which is the
        hands' longest gap. Without this delay, a claim near its limit could change its verdict with every
        sample of a hand.
        """
        for number, claim in enumerate(self.claims):
            now, reported = _verdicts_of(claim, silence), self._told[number]
            if now == reported:
                self._better_since_s[number] = inf
                continue
            since_s = self._better_since_s[number] = min(self._better_since_s[number], self.time_s)
            worse = reported is None or any(map(_worse, now, reported))
            if worse or self.time_s - since_s >= self.cell.hand_facts.longest_gap_s:
                self._told[number], self._better_since_s[number] = now, inf
                yield self._change(claim, silence)

    def _change(self, claim: WatchedClaim, silence: str = "") -> VerdictLine:
        """Return the output line of ``claim`` at the latest tick.

        ``silence`` is the reason why the present state is unknown, or empty if the state is known.
        """
        part = claim.deciding
        verdict, latest = _verdicts_of(claim, silence)
        signals = self._moments[-1].signals if self._moments else None
        return VerdictLine(
            time_s=self.time_s,
            claim=claim.sentence,
            verdict=verdict,
            latest=latest,
            margin=None if part.margin is None else part.margin * part.unit.per_si,
            unit=part.unit.symbol,
            reason=silence or (part.reason(signals) if signals is not None else "nothing came yet"),
        )


def _worse(now: Verdict, reported: Verdict) -> bool:
    return WORST_FIRST.index(now) < WORST_FIRST.index(reported)


def _verdicts_of(claim: WatchedClaim, silence: str) -> tuple[Verdict, Verdict]:
    """Return the verdicts of ``claim`` on the run and at the latest tick.

    During a ``silence``, both verdicts are inconclusive. However, if the run has already violated the claim,
    the verdict on the run remains a violation.
    """
    verdict = claim.verdict
    if silence:
        return Verdict.VIOLATED if verdict is Verdict.VIOLATED else Verdict.INCONCLUSIVE, Verdict.INCONCLUSIVE
    return verdict, claim.latest
