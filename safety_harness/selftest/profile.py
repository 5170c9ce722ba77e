"""How much is tried: ``quick`` in a couple of minutes on two idle cores, ``nightly`` everything there is."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.exceptions import Place, ScenarioError

# Those that tell most come first; measured, see docs/selftest.md.
TELLING = (
    "hand-visits-and-leaves",
    "second-hand",
    "hesitating-reach",
    "hand-stays",
    "overhead-camera",
    "own-formulas",
    "network-certain",
    "network-in-doubt",
    "cornered",
    "between-two-hands",
    "servoing-alone",
    "stops-in-time",
    "nothing-reachable",
    "lost-between-two-hands",
    "object-lost-and-found",
    "fault-camera-hidden-by-a-hand",
    "fault-camera-blind",
    "tilted-start",
    "over-the-shoulder",
    "hidden-for-a-moment",
)


@dataclass(frozen=True, kw_only=True)
class SelfTestProfile:
    """``first`` are the scenarios tried before the others, ``others`` whether those are tried at all.

    ``draws`` of each space come after them.
    """

    name: str
    first: tuple[str, ...]
    others: bool
    draws: int


QUICK = SelfTestProfile(name="quick", first=TELLING, others=False, draws=2)
NIGHTLY = SelfTestProfile(name="nightly", first=TELLING, others=True, draws=30)
PROFILES = (QUICK, NIGHTLY)


def profile_named(name: str) -> SelfTestProfile:
    """One of them; ScenarioError for any other name."""
    for profile in PROFILES:
        if profile.name == name:
            return profile
    names = " or ".join(profile.name for profile in PROFILES)
    raise ScenarioError(place=Place(field="--profile"), expected=names, got=repr(name))
