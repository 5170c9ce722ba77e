"""What the paper leaves open, one thing at a time: a variant differs from the default in a single choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi, sqrt

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness.extensions.lab.learning.recipes import Recipe

LITERAL_EQ12 = 0.122  # p^l / (2 N tau) at N = 4,000,000, with l read as an exponent


def _as_it_is(recipe: Recipe) -> Recipe:
    return recipe


@dataclass(frozen=True)
class RecipeVariant:
    """``recipe`` bends a training recipe; ``picp`` is the reading of the PICP; dt is in the settings."""

    name: str
    what: str
    settings: Settings = DEFAULTS
    recipe: Callable[[Recipe], Recipe] = _as_it_is
    picp: str = "spread"


def _avoidance(**values: float) -> Settings:
    return replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, **values))  # type: ignore[arg-type]


def _period(seconds: float) -> Settings:
    return replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=seconds))


def _polygon(*corners: tuple[float, float]) -> Settings:
    return replace(DEFAULTS, object=replace(DEFAULTS.object, polygon_m=corners))


def _drop(probability: float) -> Callable[[Recipe], Recipe]:
    def bend(recipe: Recipe) -> Recipe:
        if recipe.dropout is Dropout.NONE:
            return recipe
        return replace(recipe, dropout_probability=probability)

    return bend


def _decay(value: float) -> Callable[[Recipe], Recipe]:
    """The length scale that gives this weight decay, whatever the rest of the formula is."""

    def bend(recipe: Recipe) -> Recipe:
        per_square = recipe.weight_decay(DECAY_SAMPLES, DECAY_VARIANCE_MM2) / recipe.length_scale**2
        return replace(recipe, length_scale=sqrt(value / per_square))

    return bend


# For the weight decay of a variant: 8,000 TCPs x 500 hands, and the mean variance of targets [mm^2], about.
DECAY_SAMPLES, DECAY_VARIANCE_MM2 = 4_000_000, 7_000.0


def _full(recipe: Recipe) -> Recipe:
    return recipe if recipe.dropout is Dropout.NONE else replace(recipe, dropout=Dropout.FULL)


def _raw(recipe: Recipe) -> Recipe:
    return replace(recipe, normalise=False)


def _by_sample(recipe: Recipe) -> Recipe:
    return replace(recipe, split="by sample")


BASE = RecipeVariant("the default", "nothing is changed")
VARIANTS = (
    BASE,
    RecipeVariant("dt 4 ms", "control period", _period(0.004)),
    RecipeVariant("dt 16 ms", "control period", _period(0.016)),
    RecipeVariant("R 75 mm", "radius of the sphere of candidates", _avoidance(radius_m=0.075)),
    RecipeVariant("R 150 mm", "radius of the sphere of candidates", _avoidance(radius_m=0.150)),
    RecipeVariant("sigma 30 deg", "spread of the candidates", _avoidance(candidate_sigma_rad=pi / 6)),
    RecipeVariant("sigma 60 deg", "spread of the candidates", _avoidance(candidate_sigma_rad=pi / 3)),
    RecipeVariant(
        "triangle of 120 x 90 mm",
        "the object",
        _polygon((-0.040, -0.030), (0.080, -0.030), (-0.040, 0.060)),
    ),
    RecipeVariant("no weight decay", "weight decay 1e-12", recipe=_decay(1e-12)),
    RecipeVariant("eq. 12 read literally", f"weight decay {LITERAL_EQ12}", recipe=_decay(LITERAL_EQ12)),
    RecipeVariant("dropout 0.05", "probability to drop a unit", recipe=_drop(0.05)),
    RecipeVariant("dropout 0.2", "probability to drop a unit", recipe=_drop(0.2)),
    RecipeVariant("dropout before every layer", "places of dropout", recipe=_full),
    RecipeVariant("raw millimetres", "no normalisation", recipe=_raw),
    RecipeVariant("split by sample", "the paper's split", recipe=_by_sample),
    RecipeVariant("PICP with residuals", "residuals' variance added", picp="spread and residuals"),
    RecipeVariant("PICP with 1/tau", "1/tau added to the variance", picp="spread and 1/tau"),
    RecipeVariant("PICP by eq. 11 as printed", "no mean taken off", picp="eq. 11 as printed"),
)
