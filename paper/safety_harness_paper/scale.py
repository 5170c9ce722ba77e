"""How much is trained and tried: three scales, and where their numbers come from.

The *default* is cut to two cores and 90 minutes; its training recipe is the package's own
(``extensions.lab.learning.recipes``: 20 epochs, step 0.002 falling to zero, batches of 2,000, normalised
variables, split by
TCP), with 200,000 in place of 300,000 samples an epoch.  The *paper*'s takes the paper's recipes as they
stand (4,000,000 samples, 200 epochs, 1,200 for DO-full, raw millimetres, split by sample): weeks.  *quick*
exists to see that everything runs; nothing follows from its numbers.  No number here was chosen by what the
tables show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.base.exceptions import Place, SettingsError
from safety_harness.extensions.lab.learning.recipes import (
    OURS_DETERMINISTIC,
    OURS_MC_DROPOUT,
    OURS_MC_DROPOUT_FULL,
    PAPER_DETERMINISTIC,
    PAPER_MC_DROPOUT,
    PAPER_MC_DROPOUT_FULL,
    Recipe,
)

FULL_EPOCHS_RATIO = 6  # table 2: 1,200 against 200 epochs
PASSES = (5, 10, 15, 20, 25)  # table 1


@dataclass(frozen=True, kw_only=True)
class Scale:
    """One scale; counts of trials are a training seed's own where it says so."""

    name: str
    seeds: int  # trainings of each kind
    tcps: int
    hands: int
    deterministic: Recipe
    inter: Recipe
    full: Recipe  # as many epochs as the others
    full_long: Recipe  # six times as many
    calibration_samples: int
    test_samples: int  # of each set, for each training seed
    reach_tcps: int  # table 4: the paper has 50; for each training seed
    trials: int  # table 5: for each training seed, on TCPs of its own
    few_trials: int  # the paper's 20, the same TCPs for every training seed
    episodes: int  # of the nominal hand space, for each system
    pairs: int  # of hand and TCP, for the question whether giving way leads away
    calls: int  # timed
    sensitivity_seeds: int
    sensitivity_epochs: int


_CUT = {"training_samples": 200_000}

DEFAULT = Scale(
    name="default",
    seeds=5,
    tcps=10_000,
    hands=500,
    deterministic=replace(OURS_DETERMINISTIC, **_CUT),  # type: ignore[arg-type]
    inter=replace(OURS_MC_DROPOUT, **_CUT),  # type: ignore[arg-type]
    full=replace(OURS_MC_DROPOUT_FULL, **_CUT),  # type: ignore[arg-type]
    full_long=replace(OURS_MC_DROPOUT_FULL, training_samples=200_000, epochs=20 * FULL_EPOCHS_RATIO),
    calibration_samples=10_000,
    test_samples=10_000,
    reach_tcps=50,
    trials=100,
    few_trials=20,
    episodes=300,
    pairs=10_000,
    calls=2000,
    sensitivity_seeds=3,
    sensitivity_epochs=10,
)

PAPER = replace(
    DEFAULT,
    name="paper",
    deterministic=PAPER_DETERMINISTIC,
    inter=PAPER_MC_DROPOUT,
    full=replace(PAPER_MC_DROPOUT_FULL, epochs=PAPER_MC_DROPOUT.epochs),
    full_long=PAPER_MC_DROPOUT_FULL,
    test_samples=100_000,
    episodes=3000,
    sensitivity_seeds=5,
    sensitivity_epochs=200,
)

_TINY = {"training_samples": 2_000, "validation_samples": 500, "epochs": 2, "batch_size": 200}

QUICK = Scale(
    name="quick",
    seeds=2,
    tcps=200,
    hands=20,
    deterministic=replace(OURS_DETERMINISTIC, **_TINY),  # type: ignore[arg-type]
    inter=replace(OURS_MC_DROPOUT, **_TINY),  # type: ignore[arg-type]
    full=replace(OURS_MC_DROPOUT_FULL, **_TINY),  # type: ignore[arg-type]
    full_long=replace(OURS_MC_DROPOUT_FULL, **_TINY | {"epochs": 3}),  # type: ignore[arg-type]
    calibration_samples=300,
    test_samples=200,
    reach_tcps=10,
    trials=2,
    few_trials=2,
    episodes=2,
    pairs=200,
    calls=20,
    sensitivity_seeds=2,
    sensitivity_epochs=2,
)

SCALES = (QUICK, DEFAULT, PAPER)


def scale_named(name: str) -> Scale:
    """The scale that a user names; SettingsError with the three names for any other."""
    for scale in SCALES:
        if scale.name == name:
            return scale
    raise SettingsError(
        place=Place(field="--scale"),
        expected=f"one of {', '.join(one.name for one in SCALES)}",
        got=repr(name),
    )
