"""One stream of a log: which file and what of it, and the samples that stand there, with their places.

A stream is written ``FILE`` or ``FILE#WHAT``: in a table (CSV, Parquet) WHAT is what its columns begin with,
in a bag (MCAP, ROS) a topic, ``/poses``, with ``[2]`` for one of several and ``:path`` for a field within.
Times are kept to the nanosecond on the stream's own clock; nothing is sorted, left out or mended.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import LogError, Place, near_miss
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import shown

MOST_SAMPLES = 4_000_000  # of one stream within the window: 400 MB of joints
SHORTEST_STEP_NS = 1_000
NS = 1e9
LATEST_S = 3e9  # of a clock, or a time that is said: nanoseconds have room for three of them
_TOPIC = re.compile(r"(?P<topic>/[^\[\]:]*)(?:\[(?P<index>[0-9]{1,4})\])?(?::(?P<path>.+))?")
TABLES, BAGS = (".csv", ".parquet"), (".mcap", ".db3", ".bag")


@dataclass(frozen=True)
class LogSource:
    """What a log's file says of a stream: the file, and what of it; ``place`` is where that is said.

    ``seen`` are the columns, topics and joints that its reader came across, ``used`` those that it took.
    """

    file: Path
    what: str
    place: Place
    topic: str = ""
    index: int | None = None
    path: str = ""
    seen: set[str] = field(default_factory=set, compare=False)
    used: set[str] = field(default_factory=set, compare=False)

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"{self.file.name}#{self.what}" if self.what else self.file.name

    @property
    def ending(self) -> str:
        """Of the file's name, in small letters."""
        return self.file.suffix.lower()

    @property
    def is_bag(self) -> bool:
        """MCAP or a bag of ROS, and no table?"""
        return bool(self.topic)

    @property
    def counts(self) -> str:
        """What its places are counted in."""
        return "message" if self.is_bag else "line" if self.ending == ".csv" else "row"

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it reads: of a folder all in it."""
        if self.file.is_dir():
            return tuple(sorted(one for one in self.file.iterdir() if one.is_file()))
        return (self.file,)


def read_source(said: Field) -> LogSource:
    """The stream that a text names; LogError for a file of no kind that can be read, or that is not there."""
    text = said.scalar("a stream: FILE.csv, FILE.parquet#right_hand or FILE.mcap#/topic").strip()
    parent = said.file.parent if said.file else Path()
    ends = [at for at, one in enumerate(text) if one == "#"]
    splits = [(text[:at], text[at + 1 :]) for at in ends] or [(text, "")]
    # a file whose own name has a "#" counts as that file, where it is there
    there = [pair for pair in ((text, ""), *reversed(splits)) if pair[0] and (parent / pair[0]).exists()]
    name, what = (there or splits)[0]
    file = located(parent / name, said.place)
    folder, ending = file.is_dir(), file.suffix.lower()
    if not name or (not folder and ending not in (*TABLES, *BAGS)):
        expected = f"a file that ends in {', '.join((*TABLES, *BAGS))}, or the folder of a ROS 2 bag"
        raise LogError(place=said.place, expected=expected, got=name or "no name")
    if not folder and not file.is_file():
        raise LogError(place=said.place, expected="a file that can be read", got=f"no such file: {file}")
    if not folder and ending in TABLES:
        return LogSource(file=file, what=what, place=said.place)
    found = _TOPIC.fullmatch(what)
    if found is None:
        expected = (
            "a topic after the file, such as run.mcap#/joint_states, /poses[1] or /tracker:wrist.position"
        )
        raise LogError(place=said.place, expected=expected, got=what or "none")
    index = found["index"]
    return LogSource(
        file=file,
        what=what,
        place=said.place,
        topic=found["topic"],
        index=None if index is None else int(index),
        path=found["path"] or "",
    )


@dataclass(frozen=True, eq=False)
class LogSamples:
    """The samples of a stream within a window, in the order of the file.

    ``time_ns`` (n,) on its own clock; ``values`` (n, k) in SI, NaN where there is none; ``at`` (n,) the line,
    row or message that each stands in; ``known_to_m`` (n,) within how much
    each is known, where the log says it of each, NaN where it does not; ``speeds_mps`` (n, 3) are those that
    the log has beside the positions; ``frozen`` (n,) is where a sample repeats the one before it although
    the stream has noise.  ``notes`` say what was left out.
    """

    source: LogSource
    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    at: NDArray[np.int64]
    known_to_m: NDArray[np.float64] | None = None
    speeds_mps: NDArray[np.float64] | None = None
    frozen: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()
    span_ns: tuple[int, int] | None = None  # of the whole stream, beyond the window too

    def noted(self, note: str) -> LogSamples:
        """Return the same with one more word on what was left out."""
        return replace(self, notes=(*self.notes, f"{self.source.name}: {note}"))

    @property
    def measured(self) -> LogSamples:
        """Those that do not repeat frozen ones."""
        return self if self.frozen is None else self.of(~self.frozen)

    def place(self, index: int) -> Place:
        """Of one sample, for errors."""
        number = int(self.at[index])
        if self.source.counts == "line":
            return Place(file=self.source.file, line=number, field=self.source.what or None)
        what = f"{self.source.counts} {number}" + (f" of {self.source.what}" if self.source.what else "")
        return Place(file=self.source.file, field=what)

    def error(self, index: int, expected: str, got: str, hint: str = "") -> LogError:
        """LogError at one sample."""
        return LogError(place=self.place(index), expected=expected, got=got, hint=hint)

    def shifted(self, by_ns: int) -> LogSamples:
        """The same on a clock that shows ``by_ns`` more."""
        return replace(self, time_ns=self.time_ns + by_ns)

    def of(self, there: NDArray[np.bool_]) -> LogSamples:
        """Those that are ``there`` (n,)."""
        names = ("time_ns", "values", "at", "known_to_m", "speeds_mps", "frozen")
        kept = {name: one[there] for name in names if (one := getattr(self, name)) is not None}
        return replace(self, **kept)


@dataclass
class Collector:
    """Takes samples one by one and keeps those from ``begin_ns`` to ``end_ns``; LogError for too many."""

    source: LogSource
    width: int
    begin_ns: int | None = None
    end_ns: int | None = None
    begin: Callable[[int], list[int | None]] | None = None  # the window, by the first time
    least: int = 2
    unstamped_before: bool = False  # may samples before the window lack a valid time?
    notes: list[str] = field(default_factory=list)  # on what was left out
    bodies: set[str] = field(default_factory=set)  # all that its messages show, as streams name them
    frames: set[str] = field(default_factory=set)  # of its messages in which the stream's is not
    _time: array[int] = field(default_factory=lambda: array("q"))
    _values: array[float] = field(default_factory=lambda: array("d"))
    _at: array[int] = field(default_factory=lambda: array("q"))
    _first_ns: float = inf
    _last_ns: float = -inf
    seen: int = 0
    _unstamped: int = 0

    def unstamped(self, refused: LogError) -> None:
        """Count a sample without a valid time; raise ``refused`` unless it may stand before the window."""
        if not self.unstamped_before or self._time:
            raise refused
        self._unstamped += 1

    def add(self, time_ns: int, values: Iterable[float], at: int) -> None:
        """One more."""
        if self.seen == 0 and self.begin is not None:
            self.begin_ns, self.end_ns = self.begin(time_ns)
        self.seen += 1
        self._first_ns = min(self._first_ns, time_ns)
        self._last_ns = max(self._last_ns, time_ns)
        if self.begin_ns is not None and time_ns < self.begin_ns:
            return
        if self.end_ns is not None and time_ns > self.end_ns:
            return
        if len(self._time) >= MOST_SAMPLES:
            raise LogError(
                place=self.source.place,
                expected=f"at most {MOST_SAMPLES:,} samples of a stream",
                got="more",
                hint='choose a part with "from" and "to"',
            )
        self._time.append(time_ns)
        self._values.extend(values)
        self._at.append(at)

    def samples(self) -> LogSamples:
        """All that were kept; LogError for fewer than ``least``, and for times that do not rise."""
        n = len(self._time)
        found = LogSamples(
            self.source,
            np.array(self._time, np.int64),
            np.array(self._values, np.float64).reshape(n, self.width),
            np.array(self._at, np.int64),
        )
        if n < self.least:
            words = "two samples" if self.least == 2 else "a sample"
            got = f"{n} of {self.seen} in the file" if self.seen else "none in the file"
            expected = f"{words} at least of {self.source.name}"
            raise LogError(place=self.source.place, expected=expected, got=got, hint=self._elsewhere())
        refuse_disorder(found)
        if self._unstamped:
            self.notes.append(f'{self._unstamped} samples before "from" have no valid time, and are left out')
        for note in self.notes:
            found = found.noted(note)
        return found if n == 0 else replace(found, span_ns=(int(self._first_ns), int(self._last_ns)))

    def _elsewhere(self) -> str:
        """Where the samples are, if none was in the window, or which frames, if none was of the stream's."""
        if not self.seen and self.frames:
            names = sorted(self.frames)
            meant = near_miss(self.source.path.lstrip("/"), names)
            return f"{meant} its messages have the frames {shown(', '.join(names))}".strip()
        if not self.seen or self.begin_ns is None or self.end_ns is None:
            return ""
        own, asked = (
            f"{begin / NS:.3f} to {end / NS:.3f} s"
            for begin, end in ((self._first_ns, self._last_ns), (self.begin_ns, self.end_ns))
        )
        return f"its times are {own}, those of the joints on its clock {asked}: the offset, or a time's unit?"


def refuse_disorder(samples: LogSamples) -> None:
    """LogError at the first sample whose time is not later than that of the one before."""
    steps = np.diff(samples.time_ns)
    for index in np.flatnonzero(steps < SHORTEST_STEP_NS)[:1].tolist():
        before, now = (samples.time_ns[i] / NS for i in (index, index + 1))
        twice = abs(int(steps[index])) < SHORTEST_STEP_NS
        same = np.array_equal(samples.values[index], samples.values[index + 1], equal_nan=True)
        got = f"{now:.9f} s after {before:.9f} s, in {samples.source.counts} {int(samples.at[index])}"
        hint = "sort it by time, in a copy: nothing is sorted here, since it may be two recordings in one"
        if twice:
            hint = "the same sample twice" if same else "two samples of one time that are not the same"
            hint += ": leave one of them out, in a copy"
        raise samples.error(index + 1, "a time later than the one before, by 1 us at least", got, hint)
