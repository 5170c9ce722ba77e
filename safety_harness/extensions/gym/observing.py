"""Describe an environment's observations as a space of Gymnasium."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.controller.arrays import SeenRows, observed
from safety_harness.seams.contract import IMAGE, SIGHTS


def observation_space(
    seen: SeenRows, sees: tuple[str, ...], image: tuple[int, int, int] | None = None
) -> spaces.Dict:
    """Return the space of the observations in one lane, including the image.

    Args:
        seen: A record (1,) of the dtype SEEN. It determines the shapes.
        sees: The observed quantities, in the words of a controller's contract.
        image: The shape (height, width, 3) of the observed image.

    Raises:
        InadmissibleError: ``sees`` is empty.

    """
    if not sees:
        known = ", ".join(sight.word for sight in SIGHTS)
        raise InadmissibleError.of_option("sees", f"at least one of: {known}", "none")
    rows = observed(seen, (sight for sight in sees if sight != IMAGE))
    shown: dict[str, spaces.Space[NDArray[np.generic]]] = {name: _space(row[0]) for name, row in rows.items()}
    return spaces.Dict(shown | ({IMAGE: spaces.Box(0, 255, image, np.uint8)} if image else {}))


def _space(like: NDArray[np.generic]) -> spaces.Space[NDArray[np.generic]]:
    if like.dtype == np.int8:
        return spaces.MultiBinary(like.shape)
    return spaces.Box(-np.inf, np.inf, like.shape, np.float64)
