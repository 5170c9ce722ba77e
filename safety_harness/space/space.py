"""A scenario space: one text that is a set to search, a distribution to estimate from, and every test in it.

Data flow: text -> tree -> template and parameters (``reading``) -> values -> scenario (the form
of its structure, filled in, ``tracing``); and back by ``matches``.
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
_MOST_FORMS = 1000  # that are kept
_UNUSED = 0.5  # the cube coordinate of what a scenario does not use


@dataclass(frozen=True, eq=False, repr=False)
class ScenarioSpace:
    """What varies, and the text around it; made by ``read_space``, ``parse_space`` or ``space_from``.

    ``tree`` is the file's own, ``template`` the scenario's with gaps where it varies.
    ``parameters`` are in the order of the unit cube's coordinates; ``notes`` are for people: whose seen
    space was meant.  A claim's expected verdict is the one that every scenario of the space should get.
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
        """Name and title only: a strategy that is made of a space is named by it."""
        return f"<scenario space {self.name}: {self.title}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    @cached_property
    def dimension(self) -> int:
        """How many coordinates the unit cube has: the same for every scenario of the space."""
        return sum(parameter.distribution.columns for parameter in self.parameters)

    @property
    def simplest(self) -> Scenario:
        """Every value its simplest: first alternatives, fewest repetitions, values nearest to zero."""
        return self.scenario(self.simplest_values, name=f"{self.name}#simplest")

    @property
    def simplest_values(self) -> Vector:
        """(d,) values of ``simplest``, NaN where it does not use them."""
        values = np.concatenate([parameter.distribution.simplest for parameter in self.parameters])
        row: Vector = self.without_unused(values[None])[0]
        return row

    def draw(self, seed: int, k: int, values: Vector | None = None) -> Scenario:
        """Draw ``k`` of the stream ``seed``: independent of all others, the same wherever it is made.

        ``values`` (d,): its row of ``values_of_draws``, if that is there.
        """
        if values is None:
            values = self.values_of_draws([seed], k)[0]
        return self.scenario(values, seed=leaf(seed, Branch.SPACE_DRAW, k, 1), name=f"{self.name}#{k}")

    def values_of_draws(self, seeds: Sequence[int], k: int) -> Vector:
        """(n, d) values of draw ``k`` of each stream, the same bits however many are made at once.

        So points in shells are made one by one: numpy may round a sine of many otherwise than that of one.
        """
        u = np.empty((len(seeds), self.dimension))
        for row, seed in zip(u, seeds, strict=True):
            row[:] = generator(seed, Branch.SPACE_DRAW, k, 0).random(self.dimension)
        values = np.empty_like(u)
        for parameter in self.parameters:
            of, own = parameter.distribution, u[:, parameter.columns]
            parts = np.split(own, len(own)) if isinstance(of, InShell) and len(own) else [own]
            values[:, parameter.columns] = np.concatenate([of.values_at(part) for part in parts])
        return self.without_unused(values)

    def draws(self, seed: int, count: int) -> Iterator[Scenario]:
        """The first ``count`` draws of the stream ``seed``."""
        return (self.draw(seed, k) for k in range(count))

    def at(self, u: ArrayLike, *, seed: int = 0, name: str | None = None) -> Scenario:
        """The scenario of a point (d,) of the unit cube.

        ``seed`` is the scenario's own.  ScenarioError where the point is outside the cube, or where the
        reader refuses what values make together.
        """
        return self.scenario(self.values_at(np.asarray(u, float)[None])[0], seed=seed, name=name)

    def values_at(self, u: Rows) -> Vector:
        """(n, d) points of the unit cube -> (n, d) values in SI, NaN where a scenario does not use them."""
        self._refuse_other_shape(u)
        if not np.all((u >= 0.0) & (u <= 1.0)):
            raise self._error("coordinates from 0 to 1", f"{u.min()} to {u.max()}")
        values = np.empty_like(u)
        for parameter in self.parameters:
            values[:, parameter.columns] = parameter.distribution.values_at(u[:, parameter.columns])
        return self.without_unused(values)

    def cube_at(self, values: Rows) -> Vector:
        """(n, d) values -> (n, d) points of the unit cube; ScenarioError for values outside the space."""
        outside = np.flatnonzero(~np.isfinite(self.log_density_at(values)))
        if len(outside):
            raise self._error("values within their distributions", f"others in row {outside[0]}")
        u = np.full_like(values, _UNUSED)
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            if used.any():
                u[used, parameter.columns] = parameter.distribution.cube_at(values[used, parameter.columns])
        return u

    def log_density_at(self, values: Rows) -> Vector:
        """(n, d) values -> (n,) natural logarithm of the density, -inf outside.

        The measure is the product of lengths, volumes (SI) and counts over the parameters that are used.
        """
        self._refuse_other_shape(values)
        density = np.zeros(len(values))
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            if used.any():
                density[used] += parameter.distribution.log_density(values[used, parameter.columns])
        return density

    def without_unused(self, values: Rows) -> Vector:
        """(n, d) -> (n, d) with NaN in place of what the choices among the values leave unused."""
        cleared = values.copy()
        for parameter, used in zip(self.parameters, self.used_by(values), strict=True):
            cleared[~used, parameter.columns] = np.nan
        return cleared

    def used_by(self, values: Rows, of: Sequence[Parameter] | None = None) -> list[NDArray[np.bool_]]:
        """For each parameter (``of`` those) of values (n, d) -> (n,): which of the scenarios use it."""

        @cache
        def holds(condition: Condition) -> NDArray[np.bool_]:
            number = values[:, self.parameters[condition.parameter].column]
            return (number >= condition.least) & (number <= condition.most)  # NaN: no

        always, never = np.ones(len(values), bool), np.zeros(len(values), bool)
        every = self.parameters if of is None else of
        return [
            reduce(or_, (reduce(and_, map(holds, when), always) for when in one.when), never) for one in every
        ]

    def scenario(self, values: Vector, *, seed: int = 0, name: str | None = None) -> Scenario:
        """The scenario of ``values`` (d,), as ``values_at`` gives them.

        Of each structure one is read; in the others the values are filled in at their paths.
        """
        row, name = values.tolist(), name or self.name
        form = self._form(values[self._choices].tobytes(), row)
        made = None if form is None else form.filled(row, name, seed)
        if made is None:
            made = replace(self._read(row, name=name), seed=seed)
        return made

    def _form(self, structure: bytes, row: Values) -> Form | None:
        """The form of a structure; None where there is none yet, which is when it is met first."""
        if structure not in self._forms:
            if len(self._forms) >= _MOST_FORMS:
                self._forms.clear()
            self._forms[structure] = None
        elif self._forms[structure] is None:
            with suppress(InputError):  # it is for the reading without marks to say
                self._forms[structure] = Form.read(row, partial(self._read, row))
        return self._forms.get(structure)

    def _read(self, row: Values, known: Sequence[Any] | None = None, *, name: str = "") -> Scenario:
        tree = filled(self.template, self.parameters, row, known)
        read = scenario_of(tree, self.file, self.recordings, name=name)
        refuse_wall_clock(read, ScenarioError, runs="the runs of a space")
        return read

    @cached_property
    def _choices(self) -> NDArray[np.int64]:
        """The coordinates that decide which of the others are used, and where they stand."""
        choices = (one.column for one in self.parameters if isinstance(one.distribution, Choice))
        return np.fromiter(choices, np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """Without the forms: another process makes its own."""
        return vars(self) | {"_forms": {}}

    def values_of(self, scenario: Scenario) -> Vector:
        """(d,) values that give ``scenario`` up to its name and seed; ScenarioError if none do."""
        for values in self._readings(scenario):
            return values
        raise self._error("a scenario of the space", f"{scenario.name}, which is none")

    def cube_of(self, scenario: Scenario) -> Vector:
        """(d,) the point of the unit cube whose scenario is ``scenario``, up to its name and seed.

        The middle of its interval for a choice, 0.5 for what is not used.  ScenarioError for a scenario
        that is not of the space.
        """
        row: Vector = self.cube_at(self.values_of(scenario)[None])[0]
        return row

    def log_density(self, scenario: Scenario) -> float:
        """The natural logarithm of the density, as ``log_density_at``; -inf for a scenario outside.

        Where alternatives overlap, so that a scenario comes about in several ways, theirs are added; ways
        with a value that is hit exactly outweigh those where it would be a coincidence.
        """
        ways = list(self._readings(scenario))
        if not ways:
            return -np.inf
        values = np.array(ways)
        lengths = np.array([self._free_coordinates(row) for row in values])
        densities = self.log_density_at(values)[lengths == lengths.min()]
        return float(np.logaddexp.reduce(densities))

    def __contains__(self, scenario: Scenario) -> bool:
        return any(True for _ in self._readings(scenario))

    def _readings(self, scenario: Scenario) -> Iterator[Vector]:
        """The values (d,) that give ``scenario``, every way that there is."""
        own_settings = not self._keys.isdisjoint((*TOP_GROUPS, "settings"))
        written = tree_of(scenario, all_settings=own_settings)
        for count, found in enumerate(matches(self.template, written, self.parameters)):
            if count == _MOST_READINGS:
                raise self._error(f"a scenario that comes about in at most {_MOST_READINGS:,} ways", "more")
            values = np.full(self.dimension, np.nan)
            for number, of_parameter in found.items():
                values[self.parameters[number].columns] = of_parameter
            if np.isfinite(self.log_density_at(values[None])[0]) and self._gives(values, scenario):
                yield values

    def _gives(self, values: Vector, scenario: Scenario) -> bool:
        try:
            found = self.scenario(values, seed=scenario.seed, name=scenario.name)
        except InputError:
            return False
        return found == scenario

    def _free_coordinates(self, values: Vector) -> int:
        return sum(
            parameter.distribution.columns
            for parameter in self.parameters
            if not isinstance(parameter.distribution, Choice) and np.isfinite(values[parameter.column])
        )

    @cached_property
    def _keys(self) -> frozenset[str]:
        """At the top of the text."""
        return frozenset(key.text for key, _ in self.template.entries)

    def _refuse_other_shape(self, array: Vector) -> None:
        if array.ndim != 2 or array.shape[1] != self.dimension:
            shape = " x ".join(map(str, array.shape))
            raise self._error(f"rows of {self.dimension} coordinates", f"an array of {shape}")

    def _error(self, expected: str, got: str) -> ScenarioError:
        return ScenarioError(place=Place(file=self.file, field=self.name), expected=expected, got=got)


def each_to_hold(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """The claims of one scenario of a space: what the space has violated somewhere should hold in each."""
    violated = Verdict.VIOLATED
    return tuple(replace(c, expected=Verdict.HOLDS) if c.expected is violated else c for c in claims)
