"""Samples in, ticks made of them, verdicts out: what a stream does, and what was missing in it."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction

import numpy as np

from safety_harness.monitoring.sample import HandSample, Sample, StreamError, read_sample
from safety_harness.monitoring.sensing import Bodies, CellAt, HandAt, Sensing, Signals
from safety_harness.monitoring.watched import WatchedClaim
from safety_harness.scenario.model import Scenario, Verdict

NO_SAFETY_FUNCTION = (
    "this monitor is no safety function: it stops nothing, and nothing may rely on it to protect a person"
)
MOST_MISSING_S = 60.0
SAME_TIME = 1e-6  # of a control period: times are written in decimals


@dataclass
class StreamCounts:
    """What came of a stream, in lines, and in ticks that had none."""

    lines: int = 0
    bad: int = 0  # that could not be read
    late: int = 0  # of a tick that was over
    extra: int = 0  # of a tick that had one already
    out_of_order: int = 0  # that came after later ones, and were put in order
    ticks: int = 0
    missing: int = 0  # ticks without joints
    lost: int = 0  # ticks at which the arm or a hand was lost


@dataclass(frozen=True, kw_only=True)
class Change:
    """A claim's verdict on the run so far, or what it says of the latest tick, is another one from here on."""

    time_s: float
    claim: str
    verdict: Verdict
    latest: Verdict
    margin: float | None
    unit: str
    reason: str

    @property
    def told(self) -> dict[str, object]:
        """For programs."""
        return asdict(self) | {"verdict": self.verdict.value, "latest": self.latest.value}


@dataclass(kw_only=True)
class Monitor:
    """Watches ``claims`` on the stream of one cell, whose arm and settings ``scenario`` has.

    What is held for ``longest_gap_s`` is lost after it; lines wait ``wait_s`` of the stream's time for earlier
    ones.
    """

    scenario: Scenario
    claims: Sequence[str]
    bodies: Bodies = field(default_factory=Bodies)
    longest_gap_s: float = 0.2
    wait_s: float = 0.0
    counts: StreamCounts = field(default_factory=StreamCounts)

    def __post_init__(self) -> None:
        self._sensing = Sensing(self.scenario, self.bodies)
        self.period_s = self._sensing.period_s
        period = Fraction(repr(self.period_s))  # as it is written, in decimals: so elapsed time has it
        self._exact = float(period.numerator), float(period.denominator)
        self.watched = [WatchedClaim(sentence, self.period_s) for sentence in self.claims]
        self.signals: Signals = {}
        self.time_s = 0.0
        self._told: list[tuple[Verdict, Verdict] | None] = [None] * len(self.watched)
        self._waiting: list[tuple[float, int, Sample]] = []
        self._newest_s = -np.inf
        self._began_s: float | None = None
        self._tick = -1
        self._joints: Sample | None = None
        self._given: Sample | None = None
        self._hands: dict[str, tuple[float, HandSample | str | None]] = {}

    def take(self, line: bytes) -> Iterator[Change]:
        """The next line; StreamError if it cannot be used, which is counted."""
        self.counts.lines += 1
        try:
            sample = read_sample(line, self.counts.lines, self._sensing.joints)
        except StreamError:
            self.counts.bad += 1
            raise
        if sample.time_s < self._newest_s:
            self.counts.out_of_order += 1
        self._newest_s = max(self._newest_s, sample.time_s)
        heapq.heappush(self._waiting, (sample.time_s, self.counts.lines, sample))
        while self._waiting and self._waiting[0][0] <= self._newest_s - self.wait_s:
            yield from self._use(heapq.heappop(self._waiting)[2])

    def end(self) -> Iterator[Change]:
        """The stream is over: what waits is used."""
        while self._waiting:
            yield from self._use(heapq.heappop(self._waiting)[2])

    def _use(self, sample: Sample) -> Iterator[Change]:
        for name, hand in sample.hands.items():
            if sample.time_s >= self._hands.get(name, (-np.inf, None))[0]:
                self._hands[name] = sample.time_s, hand
        if sample.joint_position_rad is None:
            return
        if self._began_s is None:
            self._began_s = sample.time_s
        tick = round((sample.time_s - self._began_s) / self.period_s)
        if tick <= self._tick:
            self.counts.extra += tick == self._tick
            self.counts.late += tick < self._tick
            return
        missing = tick - self._tick - 1
        if missing * self.period_s > MOST_MISSING_S:
            before_s = self._began_s + self._tick * self.period_s
            raise StreamError.of_option(
                f"line {self.counts.lines} of the stream, time_s",
                f"a time within {MOST_MISSING_S:g} s of the latest sample, {before_s:g} s",
                f"{sample.time_s:g} s",
                "a clock that jumps is another run: begin again",
            )
        self.counts.missing += missing
        for number in range(self._tick + 1, tick):
            yield from self._step(number, {})
        self._joints = sample
        yield from self._step(tick, sample.signals)

    def _step(self, tick: int, given: dict[str, float | bool]) -> Iterator[Change]:
        assert self._began_s is not None
        self._tick, self.counts.ticks = tick, self.counts.ticks + 1
        self.time_s = self._began_s + tick * self.period_s
        cell = self._cell(tick, given)
        self.counts.lost += cell.joints_rad is None or None in cell.hands.values()
        self.signals, before = self._sensing.step(cell)
        for number, claim in enumerate(self.watched):
            claim.step(self.signals, before)
            now = claim.verdict, claim.latest
            if now != self._told[number]:
                self._told[number] = now
                yield self.change(claim)

    def change(self, claim: WatchedClaim, reason: str = "") -> Change:
        """A claim's words at the latest tick."""
        part = claim.deciding
        return Change(
            time_s=self.time_s,
            claim=claim.sentence,
            verdict=claim.verdict,
            latest=claim.latest,
            margin=None if part.margin is None else part.margin * part.unit.per_si,
            unit=part.unit.symbol,
            reason=reason or part.reason(self.signals),
        )

    def _cell(self, tick: int, given: dict[str, float | bool]) -> CellAt:
        """What is known at a tick, by the latest samples."""
        sample, elapsed_s = self._joints, float(tick) * self._exact[0] / self._exact[1]
        hands = {name: self._hand(seen_s, hand) for name, (seen_s, hand) in self._hands.items()}
        values = {words: float(value) for words, value in given.items()}
        age_s = self._age(sample.time_s) if sample is not None else np.inf
        if sample is None or sample.joint_position_rad is None or age_s > self.longest_gap_s:
            return CellAt(elapsed_s=elapsed_s, hands=hands, given=values)
        fresh = age_s <= self.period_s / 2.0 and sample.joint_velocity_radps is not None
        return CellAt(
            elapsed_s=elapsed_s,
            joints_rad=np.array(sample.joint_position_rad),
            rates_radps=np.array(sample.joint_velocity_radps) if fresh else None,
            age_s=age_s,
            hands=hands,
            given=values,
        )

    def _hand(self, seen_s: float, hand: HandSample | str | None) -> HandAt | str | None:
        age_s = self._age(seen_s)
        if age_s > self.longest_gap_s or hand is None:
            return None
        if isinstance(hand, str):
            return hand
        elbow = hand.elbow_position_in_base_m
        bodies = np.array([hand.hand_position_in_base_m, elbow or hand.hand_position_in_base_m])
        return HandAt(bodies, age_s, elbow is not None)

    def _age(self, seen_s: float) -> float:
        age_s = abs(self.time_s - seen_s)
        return 0.0 if age_s <= SAME_TIME * self.period_s else age_s
