"""Read a scenario space: convert the tree of its file to a template and its parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.base.exceptions import ScenarioError, near_miss
from safety_harness.base.settings import Vector3
from safety_harness.scenario.compose import SPACE_KEY
from safety_harness.scenario.fields import Field
from safety_harness.scenario.model import LARGEST_SEED
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence
from safety_harness.space.distributions import Choice, Distribution, InBox, InRegion, InShell
from safety_harness.space.regions import REGIONS
from safety_harness.space.sentences import fixed_quantity, listed_options, options_of, sentence, times
from safety_harness.space.template import (
    Alternatives,
    Condition,
    Given,
    Keyed,
    Listing,
    Parameter,
    Repeated,
    Template,
)

MOST_COLUMNS = 256  # of the unit cube
MOST_MEMBERS = 5_000  # members of lists that repetitions make
MOST_USES = 2_000  # uses of parameters through named values
CHOICES, SEED = "choices", "seed"
_FIXED = ("scenario", "about", "claims")  # texts for people and sentences looked up elsewhere

_Use = tuple[int, tuple[Condition, ...]]  # a parameter, and the conditions of its use here


@dataclass
class _Named:
    """A named value, which is defined below the key ``choices``."""

    place: Field
    template: Template
    uses: list[_Use]  # the uses that one use of this value causes, of its own parameters first
    used: bool = False


class TemplateReader:
    """The reader of a single file.

    Each object reads one file from beginning to end.
    """

    def __init__(self) -> None:
        self._drafts: list[Parameter] = []  # their conditions and columns are known at the end
        self._named: dict[str, _Named] = {}
        self._uses: list[_Use] = []  # of the current named value, or of the scenario
        self._time = ""  # the current repetition, for names
        self._members = 0  # the number of members that repetitions have made so far

    def whole(self, root: Field) -> tuple[Keyed, tuple[Parameter, ...]]:
        """Return the template of a scenario and its parameters.

        Raise ScenarioError if the text is not valid.
        """
        entries = dict(root.entries("a mapping with the keys of a scenario"))
        if SPACE_KEY not in entries:
            expected = f'the key "{SPACE_KEY}"'
            raise ScenarioError(place=root.place, expected=expected, got=", ".join(entries) or "no keys")
        if "scenario" in entries:
            raise entries["scenario"].error(f'the key "{SPACE_KEY}" alone', got='"scenario" as well')
        if SEED in entries:  # from an extended scenario; each draw needs its own seed
            entries[SEED].integer(least=0, most=LARGEST_SEED)
        if CHOICES in entries:
            self._choices(entries[CHOICES])
        assert isinstance(root.node, Mapping)
        gaps = []
        for key, _ in root.node.entries:
            named = Scalar("scenario", key.line) if key.text == SPACE_KEY else key
            if key.text not in (CHOICES, SEED):
                below = entries[key.text]
                gaps.append((named, below.node if named.text in _FIXED else self._template(below, ())))
        for named_value in self._named.values():
            if not named_value.used:
                raise named_value.place.error("a choice that is used below", got="one that is not")
        return Keyed(tuple(gaps), root.line), self._parameters(root)

    def _choices(self, below: Field) -> None:
        """Read the named values below ``choices``."""
        for name, value in below.entries("a mapping of names and values"):
            outer, self._uses = self._uses, []
            template = self._template(value, ())
            self._named[name] = _Named(value, template, self._uses)
            self._uses = outer
            if not self._named[name].uses:
                raise value.error('a value that varies, such as "one of left, right"')

    def _parameters(self, root: Field) -> tuple[Parameter, ...]:
        """Return the parameters.

        Each parameter gets its columns, and the conditions under which it is used.
        """
        whens: list[dict[tuple[Condition, ...], None]] = [{} for _ in self._drafts]
        for number, conditions in self._uses:
            whens[number][conditions] = None
        parameters: list[Parameter] = []
        column = 0
        for draft, when in zip(self._drafts, whens, strict=True):
            parameters.append(replace(draft, column=column, when=((),) if () in when else tuple(when)))
            column += draft.distribution.columns
        if not 0 < column <= MOST_COLUMNS:
            hint = 'for example "from 200 ms to 1 s" or "one of 1, 2"; else begin with scenario:'
            raise root.error(f"from 1 to {MOST_COLUMNS} values that vary", got=f"{column}", hint=hint)
        return tuple(parameters)

    def _parameter(self, at: Field, distribution: Distribution, context: tuple[Condition, ...]) -> int:
        """Add a parameter and return its number."""
        if len(self._drafts) >= MOST_COLUMNS:
            raise at.error(f"at most {MOST_COLUMNS} values that vary", got="more")
        self._drafts.append(Parameter(at.path + self._time, distribution, 0, (), at.place))
        self._uses.append((len(self._drafts) - 1, context))
        return len(self._drafts) - 1

    def _template(self, at: Field, context: tuple[Condition, ...]) -> Template:
        """Return the template of a field.

        ``context`` contains the conditions under which the field is used.
        """
        if isinstance(at.node, Scalar):
            return self._scalar(at, context)
        if isinstance(at.node, Sequence):
            return self._list(at, context)
        keys = {key for key, _ in at.entries("a mapping")}
        if "one of" in keys:
            return self._one_of(at, context)
        if "by" in keys:
            return self._switch(at, context)
        if keys == {"box"} or keys == {"in"} or "shell" in keys:
            return Given(self._parameter(at, _point(at), context), at.line)
        gaps = [self._template(child, context) for _, child in at.entries("a mapping")]
        if all(isinstance(gap, Node) for gap in gaps):
            return at.node
        return Keyed(
            tuple((key, gap) for (key, _), gap in zip(at.node.entries, gaps, strict=True)), at.node.line
        )

    def _scalar(self, at: Field, context: tuple[Condition, ...]) -> Template:
        """Return the template of a text, which depends on its first words.

        The text is a reference to a named value, a choice of alternatives, a distribution, or a fixed text.
        """
        text = " ".join(at.scalar("a value").split())
        if text.startswith("the "):
            return self._use(at, text.removeprefix("the ").strip(), context).template
        if text.startswith("one of "):
            options = options_of(at, text.removeprefix("one of "))
            number = self._parameter(at, Choice.even(options), context)
            return Alternatives(number, tuple(Scalar(option, at.line) for option in options), at.line)
        distribution = sentence(at, text)
        return at.node if distribution is None else Given(self._parameter(at, distribution, context), at.line)

    def _use(self, at: Field, name: str, context: tuple[Condition, ...]) -> _Named:
        """Return a named value.

        Record that its parameters are used under the conditions ``context``.
        """
        if name not in self._named:
            known = ", ".join(self._named)
            expected = f"one of the choices {known}" if known else "a name below choices, which has none"
            raise at.error(expected, hint=near_miss(name, self._named))
        named = self._named[name]
        named.used = True
        if len(self._uses) + len(named.uses) > MOST_USES:
            raise at.error(f"at most {MOST_USES:,} uses of named values", got="more")
        self._uses += [(number, context + conditions) for number, conditions in named.uses]
        return named

    def _list(self, at: Field, context: tuple[Condition, ...]) -> Template:
        """Return the template of a list."""
        items: list[Template] = []
        for item in at.items("a list"):
            if isinstance(item.node, Mapping) and any(key.text == "repeat" for key, _ in item.node.entries):
                items += self._repeat(item, context)
            else:
                items.append(self._template(item, context))
        assert isinstance(at.node, Sequence)
        if tuple(items) == at.node.items:
            return at.node
        return Listing(tuple(items), at.node.line)

    def _repeat(self, at: Field, context: tuple[Condition, ...]) -> list[Template]:
        """Return the members of a list that a mapping with the key ``repeat`` describes."""
        given = at.fields(("repeat", "moves"))
        least, most = times(given.required("repeat"))
        moves = given.required("moves").items("the list that is repeated", least=1)
        number = -1
        if least < most:
            labels = tuple(f"{count} times" for count in range(least, most + 1))
            number = self._parameter(given.required("repeat"), Choice.even(labels), context)
        outer, copies = self._time, []
        for copy in range(most):
            self._members += len(moves)
            if self._members > MOST_MEMBERS:
                raise at.error(f"at most {MOST_MEMBERS:,} moves by repeating", got="more")
            self._time = f"{outer}, time {copy + 1}"
            here = context
            if copy >= least:
                here = (*context, Condition(number, copy - least + 1, most - least))
            copies.append(tuple(self._template(move, here) for move in moves))
        self._time = outer
        if number < 0:
            return [move for copy_ in copies for move in copy_]
        return [Repeated(number, least, tuple(copies), at.line)]

    def _one_of(self, at: Field, context: tuple[Condition, ...]) -> Template:
        """Return the template of a mapping with the key ``one of``."""
        given = at.fields(("one of", "chances"))
        options = listed_options(given.required("one of"))
        chances = (1.0,) * len(options)
        if "chances" in given:
            chances = _chances(given.required("chances"), len(options))
        labels = tuple(
            option.node.text if isinstance(option.node, Scalar) else f"option {number + 1}"
            for number, option in enumerate(options)
        )
        number = self._parameter(at, Choice(labels, chances), context)
        return self._alternatives(at, number, options, context)

    def _switch(self, at: Field, context: tuple[Condition, ...]) -> Template:
        """Return the template of a mapping with the key ``by``.

        The mapping contains a value for each word of a named choice.
        """
        entries = dict(at.entries("a mapping"))
        choice = entries.pop("by")
        name = choice.scalar("the name of a choice").removeprefix("the ")
        chosen = self._use(choice, name, context).template
        if not isinstance(chosen, Alternatives) or not all(isinstance(o, Scalar) for o in chosen.options):
            raise choice.error("a choice of words", got=f"{name}, which is something else")
        labels = [option.text for option in chosen.options if isinstance(option, Scalar)]
        for label, child in entries.items():
            if label not in labels:
                expected = f"one of the keys {', '.join(labels)}"
                raise child.error(expected, got=f'the key "{label}"', hint=near_miss(label, labels))
        missing = [label for label in labels if label not in entries]
        if missing:
            raise at.error(f"a value for each of {', '.join(labels)}", got=f"none for {missing[0]}")
        options = tuple(entries[label] for label in labels)
        return self._alternatives(at, chosen.parameter, options, context)

    def _alternatives(
        self, at: Field, number: int, options: tuple[Field, ...], context: tuple[Condition, ...]
    ) -> Alternatives:
        """Return ``options`` as alternatives.

        The value of the parameter ``number`` is the index of the alternative to use.
        """
        templates = (
            self._template(option, (*context, Condition(number, choice, choice)))
            for choice, option in enumerate(options)
        )
        return Alternatives(number, tuple(templates), at.line)


def _chances(at: Field, count: int) -> tuple[float, ...]:
    """Return the relative probabilities of ``count`` alternatives."""
    expected = f"a list of {count} chances, numbers from 0.000001 to 1000000 such as 3 or 25 %"
    chances = []
    for item in at.items(expected, count=count):
        value, unit = fixed_quantity(item)
        if unit or not 1e-6 <= value <= 1e6:
            raise item.error(expected)
        chances.append(value)
    return tuple(chances)


def _point(at: Field) -> Distribution:
    """Return the distribution of the point that a mapping describes: a region, a box or a shell."""
    entries = dict(at.entries("a mapping"))
    if "in" in entries:
        return _region(at, entries["in"])
    if "box" in entries:
        return _box(entries["box"])
    given = at.fields(("shell", "from", "to"))
    centre, unit = _corner(given.required("shell"))
    (inner, inner_unit), (outer, outer_unit) = (fixed_quantity(given.required(key)) for key in ("from", "to"))
    if not (inner_unit == outer_unit == unit and 0.0 <= inner < outer):
        raise at.error("a centre, and two radii of which the second is larger, all of them lengths")
    return InShell(centre, inner, outer, unit)


def _box(at: Field) -> InBox:
    """Return the distribution of a point in a box given by two corners."""
    (low, unit), (high, high_unit) = (_corner(corner) for corner in at.items("two corners", count=2))
    if unit != high_unit or not all(a < b for a, b in zip(low, high, strict=True)):
        raise at.error("two corners, each coordinate of the second larger, all of one kind")
    return InBox(low, high, unit)


def _region(at: Field, name: Field) -> InRegion:
    """Return the distribution of a point in a named region."""
    text = name.scalar("the name of a region")
    if text not in REGIONS:
        raise name.error(f"one of {', '.join(REGIONS)}", hint=near_miss(text, REGIONS))
    if at.path.startswith(f"{CHOICES}."):
        raise name.error("a region where the point itself stands, not below choices")
    return InRegion(text)


def _corner(at: Field) -> tuple[Vector3, str]:
    """Return three quantities of the same dimension as numbers in SI, and their SI unit."""
    (x, unit), (y, y_unit), (z, z_unit) = (fixed_quantity(c) for c in at.items("a list of three", count=3))
    if not unit == y_unit == z_unit:
        raise at.error("three quantities of one kind")
    return (x, y, z), unit
