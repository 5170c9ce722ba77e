"""One part of the reproduction: what has to be measured for it, and what follows from the measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from safety_harness_paper.result import Result
from safety_harness_paper.scale import Scale
from safety_harness_paper.work import Done, Task

Found = Mapping[str, Done]


@dataclass(frozen=True)
class Part:
    """``tasks`` names the measurements of a scale and root seed, ``result`` is a function of them alone."""

    name: str
    tasks: Callable[[Scale, int], dict[str, Task]]
    result: Callable[[Scale, Found], Result]
