"""Describe the counterexamples that a search has written, and their causes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from safety_harness.search.counterexample import Counterexample
from safety_harness.search.findings import Group
from safety_harness.search.result_lines import counted

AS_EXPECTED = " (as the space expects)"


@dataclass(frozen=True, eq=False)
class WrittenCounterexample:
    """A counterexample that has a file.

    The object has the case, the groups of violations that led to it, the searcher, and the files. All
    ``groups`` were shrunk to the same structure, and ``searcher`` found the first of them. ``expected`` marks
    a claim that the space expects to be violated.
    """

    one: Counterexample
    groups: list[Group]
    searcher: str
    path: Path
    trace_file: Path | None
    text: str
    expected: bool

    @property
    def lines(self) -> list[str]:
        """The lines on a counterexample: its claim, margin and cause, and the command that runs the file."""
        example = self.one
        margin = "-" if example.evaluation is None else example.evaluation.margin_text()
        return [
            f"violated {margin:>13}  {example.complaint.summary}{AS_EXPECTED if self.expected else ''}",
            f"  {self.found_words}; {example.shrunk.summary}" + f", {example.contact}" * example.shrunk.done,
            *(f"  {line}" for line in example.circumstances[: example.complaint.reference is not None]),
            *(f"  {line}" for line in example.attribution),
            f"  safety-harness run {shlex.quote(str(self.path))}",
        ]

    @property
    def found_words(self) -> str:
        """A text with the number of violations that led to this file.

        The text also states the confirmed margin, and whether a hand touched the arm, before shrinking.
        """
        example, count = self.one, sum(group.count for group in self.groups)
        parts = [f"{counted(count)} led to it"]
        if example.evaluation is not None and example.found_margin is not None:
            parts.append(f"the worst by {example.evaluation.unit.margin_text(example.found_margin)}")
        return ", ".join([*parts, example.found_contact])


@dataclass(frozen=True)
class Causes:
    """The causes of a search's violations.

    Each cause has the files of its examples. An example is one group of violations. ``not_explained`` counts
    the examples without a known cause. ``unasked`` counts the examples without a known cause that the search
    did not try to explain.
    """

    explained: Mapping[str, Sequence[str]] = field(default_factory=dict)
    not_explained: int = 0
    unasked: int = 0

    @property
    def summary(self) -> str:
        """A text with the number of causes and the number of examples without a cause."""
        explained = f"{counted(len(self.explained), 'cause')} explained"
        rest = f"{counted(self.not_explained, 'example')} not explained{' yet' * bool(self.unasked)}"
        return f"{explained}, {rest}" if self.not_explained else explained
