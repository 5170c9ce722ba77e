"""A scenario space: one text that defines a set of scenarios and a distribution over this set.

Programs search the set, draw samples from the distribution, and use the scenarios as inputs of tests.

The text is parsed to a tree, and the tree is converted to a template with parameters (``reading``).  A
scenario is defined by values of the parameters.  Scenarios with the same structure share a form, which makes
them faster to create (``tracing``).  The function ``matches`` recovers the values from a given scenario.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial, reduce
from operator import and_, or_
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.base.elementary import log_sum_exp
from safety_harness.base.exceptions import InputError, Place, ScenarioError
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.seeds import seed as leaf
from safety_harness.scenario.decision_times import refuse_wall_clock
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.nodes import Node
from safety_harness.scenario.read import scenario_of
from safety_harness.scenario.settings_keys import TOP_GROUPS
from safety_harness.scenario.write import tree_of
from safety_harness.space.distributions import Choice, InShell, Rows
from safety_harness.space.template import Condition, Keyed, Parameter, filled, matches
from safety_harness.space.tracing import Form, Values

Vector = NDArray[np.float64]

_MOST_READINGS = 1000  # of one scenario, where alternatives look alike
_MOST_FORMS = 1000  # in memory
_UNUSED = 0.5  # the cube coordinate of a value that a scenario does not use


@dataclass(frozen=True, eq=False, repr=False)
class ScenarioSpace:
    """A set of scenarios with a distribution.

    Such an object comes from ``read_space``, ``parse_space`` or ``space_from``.  The expected verdict of a
    claim in a space applies to every scenario of the space.

    Args:
        name: The name.
        title: The title, one line.
        file: The file, or None if the space was read from a text.
        tree: The tree of the file.
        template: The tree of the scenarios, with a gap for each value that varies.
        parameters: The parameters, in the order of the unit cube's coordinates.
        notes: Notes for people.  They state whether the named regions use the seen space of the avoider or of
            the paper.
        recordings: Contents of recordings, which replace files.  The keys are the SHA-256 hashes of the
            contents.

    """

    name: str
    title: str
    file: Path | None
    tree: Node
    template: Keyed
    parameters: tuple[Parameter, ...]
    notes: tuple[str, ...] = ()
    recordings: Mapping[str, bytes] | None = None  # by their SHA-256, in place of files
    _forms: dict[bytes, Form | None] = field(default_factory=dict, init=False)  # by the choices' values

    def __repr__(self) -> str:
        """Return the name and the title, because Hypothesis shows this text as the name of a strategy."""
        return f"<scenario space {self.name}: {self.title}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    @cached_property
    def dimension(self) -> int:
        """The dimension d of the unit cube, which is the same for every scenario of the space."""
        return sum(parameter.distribution.columns for parameter in self.parameters)

    @property
    def simplest(self) -> Scenario:
        """The scenario with the first alternatives, the fewest repetitions and the values nearest to zero."""
        return self.scenario(self.simplest_values, name=f"{self.name}#simplest")

    @property
    def simplest_values(self) -> Vector:
        """The values (d,) of the scenario ``simplest``, with NaN for unused values."""
        values = np.concatenate([parameter.distribution.simplest for parameter in self.parameters])
        row: Vector = self.without_unused(values[None])[0]
        return row

    def draw(self, seed: int, k: int, values: Vector | None = None) -> Scenario:
        """Return draw ``k`` of the stream ``seed``.

        Draws are independent, and the same in every process.

        Args:
            seed: The root of the random numbers.
            k: The number of the draw, from 0.
            values: The row (d,) of ``values_of_draws`` for this draw, if the caller already has it.

        """
        if values is None:
            values = self.values_of_draws([seed], k)[0]
        return self.scenario(values, seed=leaf(seed, Branch.SPACE_DRAW, k, 1), name=f"{self.name}#{k}")

    def values_of_draws(self, seeds: Sequence[int], k: int) -> Vector:
        """Return the values (n, d) of draw ``k`` for each of n streams.

        The values of a stream have the same bits for every n.  To ensure this, the function computes points
        in shells one by one.  Otherwise numpy might round the sine of a number differently if the number is
        in an array.

        Args:
            seeds: The n streams.
            k: The number of the draw, from 0.

        """
        u = np.empty((len(seeds), self.dimension))
        for row, seed in zip(u, seeds, strict=True):
            row[:] = generator(seed, Branch.SPACE_DRAW, k, 0).random(self.dimension)
        values = np.empty_like(u)
        for parameter in self.parameters:
            distribution, own = parameter.distribution, u[:, parameter.columns]
            parts = np.split(own, len(own)) if isinstance(distribution, InShell) and len(own) else [own]
            values[:, parameter.columns] = np.concatenate([distribution.values_at(part) for part in parts])
        return self.without_unused(values)

    def draws(self, seed: int, count: int) -> Iterator[Scenario]:
        """Yield the first draws of a stream.

        Args:
            seed: The stream.
            count: The number of draws.

        """
        return (self.draw(seed, k) for k in range(count))

    def at(self, u: ArrayLike, *, seed: int = 0, name: str | None = None) -> Scenario:
        """Return the scenario at a point of the unit cube.

        Args:
            u: The point (d,).
            seed: The seed of the scenario.
            name: The name of the scenario.  None means the name of the space.

        Raises:
            ScenarioError: The point is outside the cube, or the reader refuses this combination of values.

        """
        return self.scenario(self.values_at(np.asarray(u, float)[None])[0], seed=seed, name=name)

    def values_at(self, u: Rows) -> Vector:
        """Return the values (n, d) in SI at the points ``u`` (n, d) of the unit cube.

        Unused values are NaN.
        """
        self._refuse_other_shape(u)
        if not np.all((u >= 0.0) & (u <= 1.0)):
            raise self._error("coordinates from 0 to 1", f"{u.min()} to {u.max()}")
        values = np.empty_like(u)
        for parameter in self.parameters:
            values[:, parameter.columns] = parameter.distribution.values_at(u[:, parameter.columns])
        return self.without_unused(values)

    def cube_at(self, values: Rows) -> Vector:
        """Return the points (n, d) of the unit cube that ``values_at`` maps to ``values`` (n, d).

        Raise ScenarioError if the values are outside the space.
        """
        outside = np.flatnonzero(~np.isfinite(self.log_density_at(values)))
        if len(outside):
            raise self._error("values within their distributions", f"others in row {outside[0]}")
        u = np.full_like(values, _UNUSED)
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            if used.any():
                u[used, parameter.columns] = parameter.distribution.cube_at(values[used, parameter.columns])
        return u

    def log_density_at(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, d).

        Outside the space, it is -inf.  The density is relative to a product over all used parameters.  Each
        parameter contributes a length, a volume or a count, in SI units.
        """
        self._refuse_other_shape(values)
        density = np.zeros(len(values))
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            if used.any():
                density[used] += parameter.distribution.log_density(values[used, parameter.columns])
        return density

    def without_unused(self, values: Rows) -> Vector:
        """Return ``values`` (n, d), with NaN in place of all values that are unused.

        The choices in a row determine which of its values are used.
        """
        cleared = values.copy()
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            cleared[~used, parameter.columns] = np.nan
        return cleared

    def used_by(self, values: Rows, parameters: Sequence[Parameter] | None = None) -> list[NDArray[np.bool_]]:
        """Return the scenarios in ``values`` (n, d) that use each parameter, as one mask (n,) per parameter.

        Args:
            values: The values of n scenarios.
            parameters: The parameters for which masks are needed.  None means all parameters.

        """

        @cache
        def holds(condition: Condition) -> NDArray[np.bool_]:
            number = values[:, self.parameters[condition.parameter].column]
            return (number >= condition.least) & (number <= condition.most)  # NaN: no

        always, never = np.ones(len(values), bool), np.zeros(len(values), bool)
        every = self.parameters if parameters is None else parameters
        return [
            reduce(or_, (reduce(and_, map(holds, when), always) for when in p.when), never) for p in every
        ]

    def scenario(self, values: Vector, *, seed: int = 0, name: str | None = None) -> Scenario:
        """Return the scenario that has the given values.

        The reader makes the first scenario of each structure.  For further scenarios of the structure, the
        values are inserted into a form.

        Args:
            values: The values (d,), in the format of ``values_at``.
            seed: The seed of the scenario.
            name: The name of the scenario.  None means the name of the space.

        """
        row, name = values.tolist(), name or self.name
        form = self._form(values[self._choices].tobytes(), row)
        made = None if form is None else form.filled(row, name, seed)
        if made is None:
            made = replace(self._read(row, name=name), seed=seed)
        return made

    def _form(self, structure: bytes, row: Values) -> Form | None:
        """Return the form of a structure, or None.

        There is no form for the first scenario of a structure, or if no form fits the structure.
        """
        if structure not in self._forms:
            if len(self._forms) >= _MOST_FORMS:
                self._forms.clear()
            # A form costs more than a reading, so a structure gets one at its second scenario.
            self._forms[structure] = None
        elif self._forms[structure] is None:
            with suppress(InputError):  # the reading without marks raises it again
                self._forms[structure] = Form.read(row, partial(self._read, row))
        return self._forms.get(structure)

    def _read(self, row: Values, known: Sequence[Any] | None = None, *, name: str = "") -> Scenario:
        """Return the scenario that the reader makes from the values ``row``.

        In the reader, the numbers ``known`` replace the numbers in the written text.
        """
        tree = filled(self.template, self.parameters, row, known)
        read = scenario_of(tree, self.file, self.recordings, name=name)
        refuse_wall_clock(read, ScenarioError, runs="the runs of a space")
        return read

    @cached_property
    def _choices(self) -> NDArray[np.int64]:
        """The coordinates of all choices.

        The values of the choices determine which other coordinates a scenario uses, and where the scenario
        uses them.
        """
        choices = (p.column for p in self.parameters if isinstance(p.distribution, Choice))
        return np.fromiter(choices, np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """Return the data without the forms, because another process creates its own forms."""
        return vars(self) | {"_forms": {}}

    def values_of(self, scenario: Scenario) -> Vector:
        """Return values (d,) that produce ``scenario``, ignoring its name and seed.

        Raise ScenarioError if the scenario is not in the space.
        """
        for values in self._readings(scenario):
            return values
        raise self._error("a scenario of the space", f"{scenario.name}, which is none")

    def cube_of(self, scenario: Scenario) -> Vector:
        """Return the point (d,) of the unit cube that produces ``scenario``, ignoring its name and seed.

        The coordinate of a choice is the middle of its interval, and the coordinate of an unused value is
        0.5.  Raise ScenarioError if the scenario is outside the space.
        """
        row: Vector = self.cube_at(self.values_of(scenario)[None])[0]
        return row

    def log_density(self, scenario: Scenario) -> float:
        """Return the natural logarithm of the density at ``scenario``, as in ``log_density_at``.

        Outside the space, it is -inf.  If overlapping alternatives produce the scenario in several ways, the
        densities of the ways are added.  Only the ways with the fewest continuous coordinates are used,
        because any further continuous coordinate would match only by coincidence.
        """
        readings = list(self._readings(scenario))
        if not readings:
            return -np.inf
        values = np.array(readings)
        lengths = np.array([self._free_coordinates(row) for row in values])
        densities = self.log_density_at(values)[lengths == lengths.min()]
        return float(log_sum_exp(densities))

    def __contains__(self, scenario: Scenario) -> bool:
        return any(True for _ in self._readings(scenario))

    def _readings(self, scenario: Scenario) -> Iterator[Vector]:
        """Yield all possible values (d,) that produce ``scenario``."""
        own_settings = not self._keys.isdisjoint((*TOP_GROUPS, "settings"))
        written = tree_of(scenario, all_settings=own_settings)
        for count, matched in enumerate(matches(self.template, written, self.parameters)):
            if count == _MOST_READINGS:
                raise self._error(f"a scenario that comes about in at most {_MOST_READINGS:,} ways", "more")
            values = np.full(self.dimension, np.nan)
            for number, of_parameter in matched.items():
                values[self.parameters[number].columns] = of_parameter
            if np.isfinite(self.log_density_at(values[None])[0]) and self._gives(values, scenario):
                yield values

    def _gives(self, values: Vector, scenario: Scenario) -> bool:
        """Return whether the values (d,) produce ``scenario``."""
        try:
            made = self.scenario(values, seed=scenario.seed, name=scenario.name)
        except InputError:
            return False
        return made == scenario

    def _free_coordinates(self, values: Vector) -> int:
        """Return the number of used coordinates that belong to continuous distributions."""
        return sum(
            parameter.distribution.columns
            for parameter in self.parameters
            if not isinstance(parameter.distribution, Choice) and np.isfinite(values[parameter.column])
        )

    @cached_property
    def _keys(self) -> frozenset[str]:
        """The top-level keys of the text."""
        return frozenset(key.text for key, _ in self.template.entries)

    def _refuse_other_shape(self, array: Vector) -> None:
        """Raise ScenarioError unless ``array`` has the shape (n, d)."""
        if array.ndim != 2 or array.shape[1] != self.dimension:
            shape = " x ".join(map(str, array.shape))
            raise self._error(f"rows of {self.dimension} coordinates", f"an array of {shape}")

    def _error(self, expected: str, got: str) -> ScenarioError:
        """Return an error that states this space as its place."""
        return ScenarioError(place=Place(file=self.file, field=self.name), expected=expected, got=got)


def each_to_hold(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims of a space for a single scenario.

    The expected verdict "violated" is replaced by "holds".  A space may expect that some scenario violates a
    claim, but a single scenario should not violate it.
    """
    violated = Verdict.VIOLATED
    return tuple(replace(c, expected=Verdict.HOLDS) if c.expected is violated else c for c in claims)
