"""Describe an environment's observations as a space of Gymnasium."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.controller.arrays import SeenRows, observed
from safety_harness.seams.contract import IMAGE, SIGHTS


def observation_space(seen: SeenRows, sees: tuple[str, ...]) -> spaces.Dict:
    """Return the space of one lane of ``observed``; raise InadmissibleError without ``sees`` or for pixels.

    Args:
        seen: (1,) SEEN, which determines the shapes.
        sees: Words of a controller's contract, which name the observed quantities.

    """
    if not sees:
        known = ", ".join(sight.word for sight in SIGHTS if sight.word != IMAGE)
        raise InadmissibleError.of_option("sees", f"at least one of: {known}", "none")
    if IMAGE in sees:
        raise InadmissibleError.of_option("sees", "what an environment can show", repr(IMAGE))
    return spaces.Dict({name: _space(array[0]) for name, array in observed(seen, sees).items()})


def _space(like: NDArray[np.generic]) -> spaces.Space[NDArray[np.generic]]:
    if like.dtype == np.int8:
        return spaces.MultiBinary(like.shape)
    return spaces.Box(-np.inf, np.inf, like.shape, np.float64)
