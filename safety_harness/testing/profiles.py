"""How much a session tries: examples of each test, and runs to make a failure smaller."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """``examples`` scenarios of each test that draws them, ``shrinking_runs`` simulations after a failure."""

    name: str
    examples: int
    shrinking_runs: int


QUICK = Profile("quick", 50, 60)  # while one works, and on every push
NIGHTLY = Profile("nightly", 500, 400)
CERTIFY = Profile("certify", 3000, 2000)
PROFILES = (QUICK, NIGHTLY, CERTIFY)


def profile_named(name: str) -> Profile:
    """The profile of that name; KeyError if there is none."""
    return {profile.name: profile for profile in PROFILES}[name]
