"""Recipes for training networks: the paper's recipes, our own recipes, and recipes for quick trials.

The paper's recipes have the hyper-parameters of the paper (section 4.1, table 2), and inputs and targets in
millimetres without normalisation.  Our own recipes improve on this.  They normalise inputs and targets and
reduce the learning rate to zero.  In each epoch, they train on a new random part of the samples, and they
validate on TCPs that are not in the training part.
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
    """All settings of a training, except the data and the seed.

    For each epoch, a training draws ``training_samples`` new random samples. It draws ``validation_samples``
    random samples once, for all epochs. None means all samples. ``precision_per_mm2`` is tau in eq. 12, and
    ``length_scale`` is l in eq. 12. If ``normalise`` is True, inputs and targets are scaled to mean 0 and
    variance 1; otherwise they are in millimetres. If ``annealed`` is True, the learning rate decreases to
    zero over the epochs along a cosine. ``target`` is the ground truth of eq. 13 or a version without noise,
    in which the continuous optimum replaces the selected candidate. ``split`` is a random split either of the
    samples, as in the paper, or of the TCPs. After a split of the samples, each TCP occurs in all three
    parts, together with the noise of its label.
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
        """Return the weight decay lambda = (1 - p) l^2 / (2 N tau) of Gal and Ghahramani (2016).

        Here p is the probability to *drop* a unit (0 without dropout), and l is ``length_scale``.  The factor
        1 - p follows eq. 9 of the paper.  Eq. 12 omits the "1 -" and prints the square of l as an exponent of
        p.  The precision tau is ``precision_per_mm2``.  If the targets are normalised, the precision is tau
        times ``target_variance_mm2``.

        Args:
            samples: N, the size of the training set.
            target_variance_mm2: The mean of the targets' variances over the three axes.

        """
        drop = 0.0 if self.dropout is Dropout.NONE else self.dropout_probability
        precision = self.precision_per_mm2 * (target_variance_mm2 if self.normalise else 1.0)
        return (1.0 - drop) * self.length_scale**2 / (2.0 * samples * precision)


def _family(base: Recipe, *, full_epochs: int) -> tuple[Recipe, Recipe, Recipe, Recipe]:
    """Return recipes for the paper's four networks: one deterministic, two with dropout, and an ensemble."""
    return (
        replace(base, name=f"{base.name}deterministic"),
        replace(base, name=f"{base.name}mc-dropout", dropout=Dropout.INTER),
        # The paper trains this network for 1,200 epochs and the other one for 200 (Table 2).
        replace(base, name=f"{base.name}mc-dropout-full", dropout=Dropout.FULL, epochs=full_epochs),
        replace(base, name=f"{base.name}ensemble", members=5),
    )


PAPER = _family(Recipe(name="paper-"), full_epochs=1200)
PAPER_DETERMINISTIC, PAPER_MC_DROPOUT, PAPER_MC_DROPOUT_FULL, _ = PAPER

_BASE = Recipe(
    name="",
    training_samples=300_000,
    validation_samples=20_000,
    epochs=20,  # after some 15 epochs, a network begins to remember the noise in the training labels
    learning_rate=2e-3,
    annealed=True,
    normalise=True,
    split="by TCP",
)
OURS = _family(_BASE, full_epochs=20)
OURS_DETERMINISTIC, OURS_MC_DROPOUT, OURS_MC_DROPOUT_FULL, OURS_ENSEMBLE = OURS
OURS_OPTIMUM = replace(_BASE, name="optimum", target="continuous", epochs=40)

# Proofs bound the student's largest errors, so its recipe has the l2 loss and more steps than the others.
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

# For first trials: about two minutes (docs/how-to/train.md).
_TRIAL = replace(
    _BASE, name="trial-", training_samples=40_000, validation_samples=10_000, epochs=8, batch_size=1000
)
TRIAL = _family(_TRIAL, full_epochs=8)
TRIAL_MC_DROPOUT = TRIAL[1]

RECIPES = (*PAPER, *OURS, OURS_OPTIMUM, STUDENT, STUDENT_ENSEMBLE, *TRIAL)


def recipe_named(name: str) -> Recipe:
    """Return the recipe with ``name``.

    Raise ModelError for an unknown name; the error lists all names.
    """
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
