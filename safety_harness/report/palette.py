"""The colours of the figures: drawn as sentinel hex values, shown as CSS variables.

matplotlib can only draw fixed colours, but a page that follows the reader's light or dark scheme
needs variables.  So every ink has a sentinel that nothing else uses, which ``svg`` replaces by
``var(--fig-...)``; the style sheet gives the variables their values (Okabe and Ito's colours,
safe for colour-blind readers, darkened or lightened for contrast with the page).
"""

from __future__ import annotations

from enum import Enum


class Ink(Enum):
    """One colour role each; the value is its number in the sentinel."""

    PAPER = 1
    TEXT = 2
    MUTED = 3
    GRID = 4
    TCP = 5
    HAND_1 = 6
    HAND_2 = 7
    PREDICTED = 8
    GREEN = 9
    SKY = 10
    LIMIT = 11
    REPULSING = 12
    STOPPED = 13
    LOST = 14
    MISSING = 15
    ARM = 16
    OBJECT = 17
    CHOSEN = 18
    SERVOING = 19

    @property
    def sentinel(self) -> str:
        """The colour to hand to matplotlib."""
        return f"#a1b3{self.value:02x}"

    @property
    def variable(self) -> str:
        """The CSS variable's name."""
        return "--fig-" + self.name.lower().replace("_", "-")


BY_SENTINEL = {ink.sentinel: f"var({ink.variable})" for ink in Ink}
HANDS = (Ink.HAND_1, Ink.HAND_2)
