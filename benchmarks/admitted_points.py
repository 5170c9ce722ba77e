"""Points of a space's unit cube as scenarios that are ready to be run, or why they cannot be tried."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.base.exceptions import InputError
from safety_harness.space.space import ScenarioSpace


def admit_points(
    space: ScenarioSpace, u: NDArray[np.float64], seeds: Iterable[int]
) -> Iterator[Admitted | InputError]:
    """Yield for each point ``u`` (n, d) its scenario, or the error; ``seeds`` (n,) are the scenarios' own."""
    admitter = Admitter()
    for k, (values, seed) in enumerate(zip(space.values_at(u), seeds, strict=True)):
        try:
            yield admitter.admit(space.scenario(values, seed=seed, name=f"{space.name}#{k}"))
        except InputError as error:
            yield error
