"""All parts, in the order of the page, and in the order in which they are best measured."""

from __future__ import annotations

from collections.abc import Sequence

from safety_harness.base.exceptions import Place, SettingsError
from safety_harness_paper.decision_times import PART as TIMING
from safety_harness_paper.figure5 import PART as FIGURE5
from safety_harness_paper.figure6 import PART as FIGURE6
from safety_harness_paper.figure7 import PART as FIGURE7
from safety_harness_paper.figure8 import PART as FIGURE8
from safety_harness_paper.keeping_clear import PART as SAFETY
from safety_harness_paper.object_pose import PART as OUTLOOK
from safety_harness_paper.part import Part
from safety_harness_paper.sensitivity import PART as SENSITIVITY
from safety_harness_paper.table1 import PART as TABLE1
from safety_harness_paper.table2 import PART as TABLE2
from safety_harness_paper.table3 import PART as TABLE3
from safety_harness_paper.table4 import PART as TABLE4
from safety_harness_paper.table5 import PART as TABLE5

ALL = "all"
PARTS = (
    TABLE1,
    TABLE2,
    TABLE3,
    TABLE4,
    TABLE5,
    FIGURE5,
    FIGURE6,
    FIGURE7,
    FIGURE8,
    TIMING,
    OUTLOOK,
    SAFETY,
)
ON_THEIR_OWN = (SENSITIVITY,)  # not part of "all"
LAST = (TABLE2,)  # its long trainings take as much time as everything else together


def parts_named(names: Sequence[str]) -> list[Part]:
    """The parts that a user names, each once, in the order of the page; SettingsError for any other name."""
    known = {part.name: part for part in (*PARTS, *ON_THEIR_OWN)}
    wanted: set[str] = set()
    for name in names:
        if name == ALL:
            wanted |= {part.name for part in PARTS}
        elif name in known:
            wanted.add(name)
        else:
            raise SettingsError(
                place=Place(field="WHAT"),
                expected=f"{ALL}, or any of {', '.join(known)}",
                got=repr(name),
            )
    if not wanted:
        raise SettingsError(
            place=Place(field="WHAT"), expected=f"{ALL}, or any of {', '.join(known)}", got="nothing"
        )
    return [part for name, part in known.items() if name in wanted]


def measuring_order(parts: Sequence[Part]) -> list[Part]:
    """What takes longest and is needed least comes last."""
    return sorted(parts, key=lambda part: part in LAST)
