"""How a network is trained: the paper's recipes, ours, and a trial of a few seconds each.

The paper's recipes take its hyper-parameters (section 4.1, table 2) in its unit, raw millimetres.
Ours differ where that is known to go wrong: inputs and targets are normalised, the step size
falls to zero, each epoch sees a fresh random part of the combinations, and validation is on new TCPs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from safety_harness.base.exceptions import ModelError, Place, near_miss
from safety_harness.cell.avoidance.model_file import PERCEPTRON, RESNET, Dropout

Target = Literal["eq13", "continuous"]
SplitKind = Literal["by TCP", "by sample"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Everything that decides a training besides data and seed.

    ``training_samples`` are drawn afresh for each epoch, ``validation_samples`` once; ``None``
    takes all of them.  ``precision_per_mm2`` is tau and ``length_scale`` l of eq. 12.  With
    ``normalise`` the network sees variables of mean 0 and variance 1, without it millimetres.
    ``annealed``: the learning rate falls from its value to zero over the epochs, as a cosine.
    ``target``: eq. 13's ground truth, or the one with the continuous optimum in place of the
    selected candidate, which has no noise.  ``split``: at random over the samples, as the paper has
    it, which leaves every TCP (and its label's noise) in all three parts, or over the TCPs.
    """

    name: str
    kind: str = RESNET
    dropout: Dropout = Dropout.NONE
    dropout_probability: float = 0.1
    members: int = 1
    training_samples: int | None = None
    validation_samples: int | None = None
    epochs: int = 200
    batch_size: int = 2000
    learning_rate: float = 1e-3
    annealed: bool = False
    loss: Literal["l1", "l2"] = "l1"
    optimiser: Literal["adam"] = "adam"
    length_scale: float = 0.01
    precision_per_mm2: float = 1e-6
    normalise: bool = False
    target: Target = "eq13"
    split: SplitKind = "by sample"
    passes: int = 10

    def weight_decay(self, samples: int, target_variance_mm2: float) -> float:
        """The lambda = (1 - p) l^2 / (2 N tau) of Gal and Ghahramani (2016), in the network's unit.

        ``samples`` is N, the size of the training set.  p is the probability to *drop* a unit
        (eq. 9 has 1 - p; eq. 12 leaves out the "1 -" and prints the square of l as an exponent of
        p); it is 0 without dropout.  tau is a precision in 1/mm^2: a target divided by its
        standard deviation has tau times ``target_variance_mm2`` (the mean over the axes).
        """
        drop = 0.0 if self.dropout is Dropout.NONE else self.dropout_probability
        precision = self.precision_per_mm2 * (target_variance_mm2 if self.normalise else 1.0)
        return (1.0 - drop) * self.length_scale**2 / (2.0 * samples * precision)


def _family(base: Recipe, *, full_epochs: int) -> tuple[Recipe, Recipe, Recipe, Recipe]:
    """The paper's networks: deterministic, dropout after each stage, before every layer, an ensemble."""
    return (
        replace(base, name=f"{base.name}deterministic"),
        replace(base, name=f"{base.name}mc-dropout", dropout=Dropout.INTER),
        replace(base, name=f"{base.name}mc-dropout-full", dropout=Dropout.FULL, epochs=full_epochs),
        replace(base, name=f"{base.name}ensemble", members=5),
    )


PAPER = _family(Recipe(name="paper-"), full_epochs=1200)
PAPER_DETERMINISTIC, PAPER_MC_DROPOUT, PAPER_MC_DROPOUT_FULL, _ = PAPER

_BASE = Recipe(
    name="",
    training_samples=300_000,
    validation_samples=20_000,
    epochs=20,  # beyond some 15 a network begins to remember the labels' noise of the training TCPs
    learning_rate=2e-3,
    annealed=True,
    normalise=True,
    split="by TCP",
)
OURS = _family(_BASE, full_epochs=20)
OURS_DETERMINISTIC, OURS_MC_DROPOUT, OURS_MC_DROPOUT_FULL, OURS_ENSEMBLE = OURS
OURS_OPTIMUM = replace(_BASE, name="optimum", target="continuous", epochs=40)

# Its bounds matter, so its largest errors do: l2, and more steps than the others take.
STUDENT = replace(
    _BASE,
    name="student",
    kind=PERCEPTRON,
    target="continuous",
    epochs=80,
    batch_size=500,
    learning_rate=5e-3,
    loss="l2",
)
STUDENT_ENSEMBLE = replace(STUDENT, name="student-ensemble", members=5)

_TRIAL = replace(
    _BASE, name="trial-", training_samples=40_000, validation_samples=10_000, epochs=8, batch_size=1000
)
TRIAL = _family(_TRIAL, full_epochs=8)
TRIAL_MC_DROPOUT = TRIAL[1]

RECIPES = (*PAPER, *OURS, OURS_OPTIMUM, STUDENT, STUDENT_ENSEMBLE, *TRIAL)


def recipe_named(name: str) -> Recipe:
    """The recipe of that name; ModelError lists them all if there is none."""
    for recipe in RECIPES:
        if recipe.name == name:
            return recipe
    names = [recipe.name for recipe in RECIPES]
    raise ModelError(
        place=Place(field="recipe"),
        expected="the name of a recipe",
        got=repr(name),
        hint=f"{near_miss(name, names)} there are {', '.join(names)}".strip(),
    )
