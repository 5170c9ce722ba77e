"""Parse a sentence to its formula.

    claim    := operand ("and" operand)* | operand ("or" operand)* | operand "until" operand [window] | far
    far      := ("always" [lasting] | "eventually" ["from" t "to" t] | "within" t | "initially" | "not") reach
              | "whenever" claim "then" (reach | operand "until" operand [window])
    reach    := operand | far
    operand  := "not" operand | "(" claim ")" | signal | signal ("<" | "<=" | ">" | ">=") quantity
    lasting  := "for" t | "from" t "to" t
    window   := "within" t | "from" t "to" t

Ambiguous sentences are refused. Parentheses are needed around an operand if a claim mixes "and" and "or".
They are also needed around a ``far`` operator such as "always" that is joined to another operand. The case of
words does not matter.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from safety_harness.base.exceptions import FormulaError, InputError, Place, near_miss, refuse_other_type
from safety_harness.claims.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Or,
    Relation,
    Truth,
    Until,
    conjunction,
    disjunction,
    parts_of,
)
from safety_harness.claims.formulas.quantities import NOW, Quantity, Span, read_quantity
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.signals.signal import Signal
from safety_harness.scenario.units import TIME, Dimension

FIRST = ("always", "eventually", "whenever", "within", "initially", "not")
KEYWORDS = (*FIRST, "and", "or", "until", "then", "for", "from", "to")
MAX_DEPTH = 30  # parentheses and operators within one another


def parse_formula(sentence: str, place: Place | None = None) -> Formula:
    """Return the formula of ``sentence``.

    If the sentence is not valid, raise FormulaError at ``place`` with the column of the wrong word.
    """
    refuse_other_type("parse_formula(sentence)", sentence, str, expected="a sentence")
    place = place or Place(field="formula")
    parser = _Parser(sentence, place, tokens_of(sentence, place))
    formula = parser.claim(0)
    if parser.now.kind != "end":
        raise parser.error('the end of the claim, "and", "or" or "until"')
    try:
        parts_of(formula)
    except FormulaError as error:
        raise FormulaError(place=place, expected=error.expected, got=error.got, hint=error.hint) from error
    return formula


def looks_like_formula(sentence: str) -> bool:
    """Return whether a ``sentence`` that is not in the catalogue is likely to be a formula."""
    if any(sign in sentence for sign in "<>≤≥=()"):
        return True
    tokens = sentence.lower().split()
    names = {signal.words.lower() for signal in SIGNALS}
    return bool(tokens) and (tokens[0] in FIRST or "until" in tokens or " ".join(tokens) in names)


ALL_CLAIMS = "safety-harness claims"  # the command that lists the catalogue and the signals


@dataclass
class _Parser:
    sentence: str
    place: Place
    tokens: list[Token]
    at: int = 0

    @property
    def now(self) -> Token:
        return self.tokens[self.at]

    def take(self, *texts: str) -> Token | None:
        """Return the current token and advance past it, if its text is in ``texts``.

        Otherwise return None.
        """
        token = self.now
        if token.text not in texts or token.kind == "end":
            return None
        self.at += 1
        return token

    def need(self, text: str, expected: str) -> None:
        if self.take(text) is None:
            raise self.error(expected)

    def error(self, expected: str, token: Token | None = None, hint: str = "", got: str = "") -> FormulaError:
        token = token or self.now
        where = f'at column {token.column} of "{self.sentence}"'
        got_text = (
            f'"{got or token.written}" {where}' if token.kind != "end" else f'the end of "{self.sentence}"'
        )
        return FormulaError(place=self.place, expected=expected, got=got_text, hint=hint)

    def made(self, token: Token, make: type[Formula], *parts: object) -> Formula:
        """Return ``make(*parts)``.

        If the call raises FormulaError, raise this error again with ``token`` as its place.
        """
        try:
            return make(*parts)
        except FormulaError as error:
            raise self.error(error.expected, token, error.hint, error.got) from error

    def claim(self, depth: int) -> Formula:
        begins = self.now
        self.refuse_deeper(depth)
        if self.far_begins():
            formula = self.far(depth)
            self.refuse_more(begins)
            return formula
        first = self.operand(depth)
        joint = self.take("and", "or", "until")
        if joint is None:
            return first
        if joint.text == "until":
            return self.until(joint, first, depth)
        members = [first, self.operand(depth)]
        while self.take(joint.text):
            members.append(self.operand(depth))
        self.refuse_more(joint)
        join, make = (conjunction, And) if joint.text == "and" else (disjunction, Or)
        self.made(joint, make, tuple(members))
        return join(*members)

    def refuse_deeper(self, depth: int) -> None:
        if depth > MAX_DEPTH:
            raise self.error(f"at most {MAX_DEPTH} parentheses and operators within one another")

    def refuse_more(self, begins: Token) -> None:
        """Raise FormulaError if another "and", "or" or "until" follows, which would be ambiguous."""
        if self.now.text in ("and", "or", "until") and self.now.kind == "word":
            text = begins.text
            hint = f'"{text} (...)" with what belongs to it, or "({text} ...)" around it'
            if text in ("and", "or", "until"):
                hint = f'such as "(a {text} b) {self.now.text} c"'
            raise self.error(f'parentheses that say how far "{text}" reaches', hint=hint)

    def until(self, token: Token, first: Formula, depth: int) -> Formula:
        formula = self.made(token, Until, first, self.operand(depth), self.window("within"))
        self.refuse_more(token)
        return formula

    def far_begins(self) -> bool:
        """Return whether the next operator applies to all the text that follows it.

        If the next operator is "not", the answer depends on the operator after it.
        """
        ahead = self.at
        while self.tokens[ahead].text == "not":
            ahead += 1
        return self.tokens[ahead].text in FIRST

    def far(self, depth: int) -> Formula:
        token = self.now
        self.at += 1
        if token.text == "whenever":
            trigger = self.claim(depth + 1)
            self.need("then", '"then" and what is to hold whenever the first part does')
            return self.made(token, Globally, trigger, self.reach(depth, until=True))
        if token.text in ("not", "initially"):
            return self.made(token, Not if token.text == "not" else Initially, self.reach(depth))
        if token.text == "within":
            span = Span(NOW, self.later(NOW))
            return self.made(token, Eventually, self.reach(depth), span)
        make, lasting = (Always, "for") if token.text == "always" else (Eventually, "within")
        lasts = self.window(lasting)
        return self.made(token, make, self.reach(depth), lasts)

    def reach(self, depth: int, *, until: bool = False) -> Formula:
        """Parse the operand of an operator: a plain operand, or another operator with its own operand."""
        self.refuse_deeper(depth)
        if self.far_begins():
            return self.far(depth + 1)
        first = self.operand(depth)
        token = self.take("until") if until else None
        return first if token is None else self.until(token, first, depth)

    def operand(self, depth: int) -> Formula:
        if (token := self.take("not")) is not None:
            return self.made(token, Not, self.operand(depth + 1))
        if self.take("("):
            formula = self.claim(depth + 1)
            self.need(")", '")"')
            return formula
        if self.now.text in FIRST:
            token = self.now
            raise self.error(
                f'parentheses around the part that begins with "{token.text}"',
                hint=f'write "({token.text} ...)"',
            )
        self.refuse_deeper(depth)
        return self.atom()

    def atom(self) -> Formula:
        name, signal = self.now, self.signal()
        dimension = signal.dimension
        sign = self.now
        if sign.kind == "sign" and sign.text not in "()":
            if dimension is None:
                raise self.error(f'"{signal.words}" without a comparison: it is true or false')
            if sign.text not in {relation.value for relation in Relation}:
                raise self.error("<, <=, > or >=")
            self.at += 1
            limit = self.quantity(dimension)
            return self.made(sign, Comparison, signal, Relation(sign.text), limit)
        if dimension is not None:
            raise self.error(f"<, <=, > or >= after {signal.words}, and {dimension.expected}")
        return self.made(name, Truth, signal)

    def signal(self) -> Signal:
        """Parse the longest name of a signal that begins at the current token, and advance past it."""
        ahead = [token.text for token in self.tokens[self.at :]]
        matches = [signal for signal in SIGNALS if ahead[: len(_words_of(signal))] == _words_of(signal)]
        if matches:
            signal = max(matches, key=lambda match: len(_words_of(match)))
            self.at += len(_words_of(signal))
            return signal
        first, last = self.at, self.at
        while self.tokens[last].kind == "word" and (last == first or self.tokens[last].text not in KEYWORDS):
            last += 1
        end = self.tokens[last - 1]
        ends = end.column - 1 + len(end.written) if last > first else 0
        written = self.sentence[self.now.column - 1 : ends]
        names = [signal.words for signal in SIGNALS]
        raise self.error(
            "a signal or an operator",
            got=written,
            hint=near_miss(written, (*names, *FIRST), most=3, all_of_them=ALL_CLAIMS),
        )

    def quantity(self, dimension: Dimension) -> Quantity:
        token = self.now
        text = token.written
        if token.kind != "end" and token.text not in ("(", ")"):
            self.at += 1
        if self.now.kind == "word" and self.now.text not in KEYWORDS and token.kind == "number":
            text += f" {self.now.written}"
            self.at += 1
        try:
            return read_quantity(text, dimension, self.place)
        except InputError as error:
            raise self.error(error.expected, token, error.hint, text) from error

    def window(self, from_now: str) -> Span | None:
        """Parse the window at the current token.

        Return None if no window begins there. A window has the form ``from 0.1 s to 0.5 s``, or it consists
        of the word ``from_now`` and a time.
        """
        token = self.take(from_now, "from")
        if token is None:
            return None
        if token.text == from_now:
            return Span(NOW, self.later(NOW))
        begin = self.quantity(TIME)
        self.need("to", '"to" and when the window ends')
        if begin.value < 0.0:
            raise self.error("a window that does not begin before now", token)
        return Span(begin, self.later(begin))

    def later(self, begin: Quantity) -> Quantity:
        """Parse the time at the current token, which must be later than ``begin``."""
        token = self.now
        end = self.quantity(TIME)
        if not end.value > begin.value:
            raise self.error(f"a time after {begin}", token, got=str(end))
        return end


def _words_of(signal: Signal) -> list[str]:
    return signal.words.lower().split()


_TOKEN = re.compile(
    r"(?P<number>[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<sign><=|>=|==|!=|[<>≤≥=()])"
    r"|(?P<word>[^\s<>≤≥=()0-9.+\-][^\s<>≤≥=()]*)"
)
SAME = {"≤": "<=", "≥": ">="}


@dataclass(frozen=True)
class Token:
    """A word, a number, a sign or the end of a sentence.

    ``written`` is the token's text in the sentence, and ``text`` is its usual form.
    """

    kind: str  # "number", "sign", "word" or "end"
    written: str
    column: int  # counted from 1

    @property
    def text(self) -> str:
        """Return the token in its usual form: in lower case, with <= and >= for their symbols."""
        return SAME.get(self.written, self.written.lower())


def tokens_of(sentence: str, place: Place) -> list[Token]:
    """Return the tokens of ``sentence``, followed by an end token.

    Raise FormulaError for an unknown character.
    """
    tokens, at = [], 0
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
        tokens.append(Token(match.lastgroup or "", match.group(), at + 1))
        at = match.end()
    return [*tokens, Token("end", "", len(sentence) + 1)]
