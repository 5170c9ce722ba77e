"""Define the streams of a log. A stream is a part of a file, with samples and their places in the file.

LOG.yaml refers to a stream as ``FILE`` or ``FILE#WHAT``. In a table (CSV, Parquet), WHAT is the text with
which the columns' names begin. In a bag (MCAP, ROS) WHAT is a topic such as ``/poses``. After the topic,
``[2]`` selects one of several poses, and ``:path`` selects a field of the messages. Times are nanoseconds on
the stream's own clock. The reader does not sort, drop or repair samples.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Iterator
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
SHORTEST_STEP_NS = 1_000  # samples that are nearer in time count as simultaneous
NS = 1e9
LATEST_S = 3e9  # the latest time of a clock or statement; 64 bits of nanoseconds hold three times as much
_TOPIC = re.compile(r"(?P<topic>/[^\[\]:]*)(?:\[(?P<index>[0-9]{1,4})\])?(?::(?P<path>.+))?")
TABLES, BAGS = (".csv", ".parquet"), (".mcap", ".db3", ".bag")


def strides(count: int) -> Iterator[int]:
    """Yield 1, 2, 4 and so on below ``count``: the distances of samples that a check compares."""
    stride = 1
    while stride < count:
        yield stride
        stride *= 2


@dataclass(frozen=True)
class LogSource:
    """A stream in a file.

    ``what`` specifies the part of the file, and ``place`` is the place in LOG.yaml that refers to the stream.
    ``seen`` lists all columns, topics and joints in the file, and ``used`` lists only those that the reader
    used.
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
        """The name of the stream in messages."""
        return f"{self.file.name}#{self.what}" if self.what else self.file.name

    @property
    def ending(self) -> str:
        """The ending of the file's name, in lower case."""
        return self.file.suffix.lower()

    @property
    def is_bag(self) -> bool:
        """Return True if the file is an MCAP file or a ROS bag, and False if it is a table."""
        return bool(self.topic)

    @property
    def counts(self) -> str:
        """The word for a numbered place in the file: message, line or row."""
        return "message" if self.is_bag else "line" if self.ending == ".csv" else "row"

    @property
    def files(self) -> tuple[Path, ...]:
        """The file of the stream, or all files in it if it is a folder."""
        if self.file.is_dir():
            return tuple(sorted(file for file in self.file.iterdir() if file.is_file()))
        return (self.file,)


def read_source(stream: Field) -> LogSource:
    """Return the stream that a text describes; raise LogError for a missing file or an unknown kind."""
    text = stream.scalar("a stream: FILE.csv, FILE.parquet#right_hand or FILE.mcap#/topic").strip()
    parent = stream.file.parent if stream.file else Path()
    ends = [at for at, letter in enumerate(text) if letter == "#"]
    splits = [(text[:at], text[at + 1 :]) for at in ends] or [(text, "")]
    # if a file exists whose own name has a "#", the text means this file
    there = [pair for pair in ((text, ""), *reversed(splits)) if pair[0] and (parent / pair[0]).exists()]
    name, part = (there or splits)[0]
    file = located(parent / name, stream.place)
    folder, ending = file.is_dir(), file.suffix.lower()
    if not name or (not folder and ending not in (*TABLES, *BAGS)):
        expected = f"a file that ends in {', '.join((*TABLES, *BAGS))}, or the folder of a ROS 2 bag"
        raise LogError(place=stream.place, expected=expected, got=name or "no name")
    if not folder and not file.is_file():
        raise LogError(place=stream.place, expected="a file that can be read", got=f"no such file: {file}")
    if not folder and ending in TABLES:
        return LogSource(file=file, what=part, place=stream.place)
    match = _TOPIC.fullmatch(part)
    if match is None:
        expected = (
            "a topic after the file, such as run.mcap#/joint_states, /poses[1] or /tracker:wrist.position"
        )
        raise LogError(place=stream.place, expected=expected, got=part or "none")
    index = match["index"]
    return LogSource(
        file=file,
        what=part,
        place=stream.place,
        topic=match["topic"],
        index=None if index is None else int(index),
        path=match["path"] or "",
    )


@dataclass(frozen=True, eq=False)
class LogSamples:
    """The samples of a stream within a window, in the order of the file.

    Args:
        source: The stream.
        time_ns: (n,) the times on its own clock.
        values: (n, k) in SI, NaN where missing.
        at: (n,) the line, row or message of each sample.
        known_to_m: (n,) the uncertainty of each sample, NaN where missing, or None if the log has none.
        speeds_mps: (n, 3) the speeds beside the positions, or None if the log has none.
        frozen: (n,) true where a sample repeats the previous one although the stream has noise, or None if
            no sample does.
        notes: Notes on omitted parts.
        span_ns: The first and the last time in the stream, even if they are outside the window.

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
        """Return the samples with another note, which states that a part is omitted."""
        return replace(self, notes=(*self.notes, f"{self.source.name}: {note}"))

    @property
    def measured(self) -> LogSamples:
        """The samples without the frozen ones."""
        return self if self.frozen is None else self.chosen(~self.frozen)

    def place(self, index: int) -> Place:
        """Return the place of one sample, for error messages."""
        number = int(self.at[index])
        if self.source.counts == "line":
            return Place(file=self.source.file, line=number, field=self.source.what or None)
        field = f"{self.source.counts} {number}" + (f" of {self.source.what}" if self.source.what else "")
        return Place(file=self.source.file, field=field)

    def error(self, index: int, expected: str, got: str, hint: str = "") -> LogError:
        """Return a LogError with the place of the sample ``index``."""
        return LogError(place=self.place(index), expected=expected, got=got, hint=hint)

    def shifted(self, by_ns: int) -> LogSamples:
        """Return the samples with ``by_ns`` added to all times."""
        return replace(self, time_ns=self.time_ns + by_ns)

    def chosen(self, there: NDArray[np.bool_]) -> LogSamples:
        """Return the samples where ``there`` (n,) is true."""
        names = ("time_ns", "values", "at", "known_to_m", "speeds_mps", "frozen")
        kept = {name: array[there] for name in names if (array := getattr(self, name)) is not None}
        return replace(self, **kept)


@dataclass
class Collector:
    """A collector of the samples from ``begin_ns`` to ``end_ns``; it raises LogError for too many samples."""

    source: LogSource
    width: int
    begin_ns: int | None = None
    end_ns: int | None = None
    begin: Callable[[int], list[int | None]] | None = None  # returns the window for the first time
    least: int = 2
    unstamped_before: bool = False  # may samples before the window lack a valid time?
    notes: list[str] = field(default_factory=list)  # on omitted samples
    bodies: set[str] = field(default_factory=set)  # all bodies in the messages, by the names of streams
    frames: set[str] = field(default_factory=set)  # in the messages that lack the stream's own frame
    _time: array[int] = field(default_factory=lambda: array("q"))
    _values: array[float] = field(default_factory=lambda: array("d"))
    _at: array[int] = field(default_factory=lambda: array("q"))
    _first_ns: float = inf
    _last_ns: float = -inf
    seen: int = 0
    _unstamped: int = 0

    def unstamped(self, refused: LogError) -> None:
        """Count a sample without a valid time, or raise ``refused`` if it cannot be before the window."""
        if not self.unstamped_before or self._time:
            raise refused
        self._unstamped += 1

    def add(self, time_ns: int, values: Iterable[float], at: int) -> None:
        """Add one sample."""
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
        """Return the samples; raise LogError if they are fewer than ``least`` or if times do not increase."""
        n = len(self._time)
        read = LogSamples(
            self.source,
            np.array(self._time, np.int64),
            np.array(self._values, np.float64).reshape(n, self.width),
            np.array(self._at, np.int64),
        )
        if n < self.least:
            wanted = "two samples" if self.least == 2 else "a sample"
            got = f"{n} of {self.seen} in the file" if self.seen else "no sample in the file"
            expected = f"{wanted} at least of {self.source.name}"
            raise LogError(place=self.source.place, expected=expected, got=got, hint=self._elsewhere())
        refuse_disorder(read)
        if self._unstamped:
            self.notes.append(f'{self._unstamped} samples before "from" have no valid time and do not count')
        for note in self.notes:
            read = read.noted(note)
        return read if n == 0 else replace(read, span_ns=(int(self._first_ns), int(self._last_ns)))

    def _elsewhere(self) -> str:
        """Return a hint for an error about missing samples.

        The reason is either that all times are outside the window, or that the messages have other frames.
        """
        if not self.seen and self.frames:
            names = sorted(self.frames)
            meant = near_miss(self.source.path.lstrip("/"), names)
            return f"{meant} its messages have the frames {shown(', '.join(names))}".strip()
        if not self.seen or self.begin_ns is None or self.end_ns is None:
            return ""
        own, span = (
            f"{begin / NS:.3f} to {end / NS:.3f} s"
            for begin, end in ((self._first_ns, self._last_ns), (self.begin_ns, self.end_ns))
        )
        return f"its times are {own}, the joints' on its clock are {span}: a wrong offset or time unit?"


def refuse_disorder(samples: LogSamples) -> None:
    """Raise LogError if the time of a sample is not later than the time of the previous sample."""
    steps = np.diff(samples.time_ns)
    for index in np.flatnonzero(steps < SHORTEST_STEP_NS)[:1].tolist():
        last_s, now_s = (samples.time_ns[i] / NS for i in (index, index + 1))
        # Tell a repeated time from a time that goes back: the hints differ.
        twice = abs(int(steps[index])) < SHORTEST_STEP_NS
        same = np.array_equal(samples.values[index], samples.values[index + 1], equal_nan=True)
        got = f"{now_s:.9f} s after {last_s:.9f} s, in {samples.source.counts} {int(samples.at[index])}"
        hint = "sort it by time, in a copy; the harness does not, since it may be two recordings in one"
        if twice:
            hint = "the same sample twice" if same else "two samples of one time that are not the same"
            hint += ": leave one of them out, in a copy"
        raise samples.error(index + 1, "a time at least 1 us after the previous sample's", got, hint)
