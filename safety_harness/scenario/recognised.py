"""Is a file one of ours?  Told by its keys, before anything in it is believed or shown.

Other programs have files with a ``scenario:`` or a ``seed:`` too.  And a name may lead to a file that is not
for everybody's eyes (``scenario.yaml`` a link to ``/etc/shadow``, or ``extends: ~/.netrc``), while errors go
into the log of a build: none quotes a file that has none of these keys.
"""

from __future__ import annotations

import re
from pathlib import Path

from safety_harness.exceptions import Place, ScenarioError

TITLES = ("scenario", "scenario space", "suite")
# Keys that few others have.
KEYS = (
    *("extends", "without", "matrix", "tcp start", "avoider", "hands", "faults", "hand sensor", "claims"),
    *("scenarios", "plan", "strata"),
)
COMMON = ("about", "duration", "seed", "robot", "object", "camera", "settings")  # ours beside a title only
ALL = (*TITLES, *KEYS, *COMMON)
_KEY = re.compile(rf"^[\"']?({'|'.join(ALL)})[\"']?[ \t]*:(?:[ \t]+(\S)|[ \t]*\r?$)", re.MULTILINE)


def is_titled(text: str) -> bool:
    """Has a text the title of a scenario, a space or a suite, and one more key of ours?"""
    keys, titles = _keys_of(text)
    return bool(titles) and bool(keys) and "plan" not in keys


def has_a_key(text: str) -> bool:
    """Has a text a title or a key that few others have, at the beginning of a line?"""
    keys, titles = _keys_of(text)
    return bool(titles | keys - {*COMMON})


def _keys_of(text: str) -> tuple[set[str], set[str]]:
    """The keys, and the titles, which have a text on their line."""
    found = _KEY.findall(text)
    return {key for key, _ in found} - {*TITLES}, {key for key, value in found if value} & {*TITLES}


def foreign(file: Path, place: Place | None) -> ScenarioError:
    """What is said of a file that is not ours: nothing of what is in it."""
    return ScenarioError(
        place=place or Place(file=file),
        expected=f"a scenario file, with keys such as {', '.join((*TITLES, 'hands'))}",
        got=f"{file}, which is none",
        hint="nothing of it is shown here: it may be anybody's",
    )
