"""A sentence as words, numbers and signs, each with the column at which it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass

from safety_harness.exceptions import FormulaError, Place

_TOKEN = re.compile(
    r"(?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<sign><=|>=|==|!=|[<>≤≥=()])"
    r"|(?P<word>[^\s<>≤≥=()0-9.+\-][^\s<>≤≥=()]*)"
)
SAME = {"≤": "<=", "≥": ">="}


@dataclass(frozen=True)
class Token:
    """One word (in lower case as ``text``, as it is written in ``written``), number or sign; or the end."""

    kind: str  # "number", "sign", "word" or "end"
    written: str
    column: int  # counted from 1

    @property
    def text(self) -> str:
        """What it says, however it is written."""
        return SAME.get(self.written, self.written.lower())


def tokens_of(sentence: str, place: Place) -> list[Token]:
    """The tokens of a sentence, with one that says where it ends; FormulaError for what is none."""
    found, at = [], 0
    while at < len(sentence):
        if sentence[at].isspace():
            at += 1
            continue
        match = _TOKEN.match(sentence, at)
        if match is None:
            raise FormulaError(
                place=place,
                expected="words, numbers with units, <, <=, >, >= and parentheses",
                got=f'"{sentence[at]}" at column {at + 1} of "{sentence}"',
            )
        found.append(Token(match.lastgroup or "", match.group(), at + 1))
        at = match.end()
    return [*found, Token("end", "", len(sentence) + 1)]
