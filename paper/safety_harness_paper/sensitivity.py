"""Which conclusions of the paper hang on what it leaves open: one choice varied at a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.extensions.lab.learning.dataset import space_named
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness_paper.avoiders import BAYESIAN, OPPOSITE, with_networks
from safety_harness_paper.intervals import differences, mean_of
from safety_harness_paper.networks import training
from safety_harness_paper.part import Found, Part
from safety_harness_paper.predictions import SEEN, TCP
from safety_harness_paper.predictions import measure as evaluate
from safety_harness_paper.result import (
    PaperClaim,
    PaperVerdict,
    Result,
    Table,
    above_zero,
    below_zero,
)
from safety_harness_paper.scale import Scale
from safety_harness_paper.variants import BASE, VARIANTS, RecipeVariant
from safety_harness_paper.work import Done, Json, Task

SAYS = (
    "The control period, the radius and spread of the candidates, the triangle, how intervals are made, the "
    "weight decay's formula, where dropout acts and whether data are normalised are not given, or not "
    "unambiguously."
)
DRAWS = 2000  # test samples, and TCPs for the iterations
_DRAW = 11


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """One a variant and training seed; variants that train alike share their networks."""
    return {
        f"{variant.name} {k}": _measurement(variant, scale, root, k)
        for variant in VARIANTS
        for k in range(scale.sensitivity_seeds)
    }


def _measurement(variant: RecipeVariant, scale: Scale, root: int, k: int) -> Task:
    # What only concerns the robot's time or the reading of intervals needs no networks of its own.
    trained_with = replace(variant.settings, clock=BASE.settings.clock)
    networks = tuple(
        training(label, _short(variant.recipe(recipe), scale), scale, root, k, settings=trained_with)
        for label, recipe in (("DNN of a variant", scale.deterministic), ("DO of a variant", scale.inter))
    )
    return Task(
        f"sensitivity: {variant.name}, seed {k}",
        measure,
        (
            ("samples", min(DRAWS, scale.test_samples)),
            ("draw_seed", leaf(root, _DRAW, k)),
            ("settings", variant.settings),
        ),
        networks,
        seconds=6.0,
    )


def _short(recipe: Recipe, scale: Scale) -> Recipe:
    """The sensitivity's own number of epochs; the name has no part in what comes out."""
    return replace(recipe, epochs=scale.sensitivity_epochs, name="variant")


def measure(
    folder: Path, dnn: Done, bayesian: Done, *, samples: int, draw_seed: int, settings: Settings
) -> Json:
    """Errors and intervals as in tables 1 to 3, iterations as in table 5 by the closed form."""
    found = evaluate(
        folder, dnn, bayesian, samples=samples, draw_seed=draw_seed, passes=(5, 10), settings=settings
    )
    return {"models": found["models"], "iterations": _iterations(settings, dnn, bayesian, samples, draw_seed)}


def _iterations(settings: Settings, dnn: Done, bayesian: Done, count: int, seed: int) -> dict[str, float]:
    """Mean of ln(d / 70.7 mm) / (lambda dt), none below zero, from each pose; the hand as in table 5."""
    rng = np.random.default_rng(seed)
    tcps = space_named("unseen tcp", settings).tcp.draw(rng, count)
    hand = np.array(settings.avoidance.nominal_hand_position_in_base_m)
    goal = np.array(settings.cell.desired_tcp_position_in_base_m)
    servo, period_s = settings.servo, settings.clock.control_period_s
    found = {}
    for name, avoider in with_networks(settings, dnn, bayesian).items():
        if isinstance(avoider, LearnedAvoider):
            hands = np.broadcast_to(hand, tcps.shape)
            ends, _ = avoider.propose_many(hands, tcps, np.arange(count, dtype=np.uint64))
        else:
            proposals = [
                avoider.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=number)
                for number, tcp in enumerate(tcps)
            ]
            ends = np.array([one.position_in_base_m for one in proposals])
        ratio = np.linalg.norm(ends - goal, axis=1) / np.sqrt(servo.gain_switch_sse)
        found[name] = float(np.maximum(np.log(ratio), 0.0).mean() / (servo.gain_far * period_s))
    return found


def result(scale: Scale, found: Found) -> Result:
    """Each conclusion under each variant, by the same rule; what changes against the default is told."""
    by_variant = {
        variant.name: conclusions(
            [found[f"{variant.name} {k}"].result for k in range(scale.sensitivity_seeds)], variant.picp
        )
        for variant in VARIANTS
    }
    base = by_variant[BASE.name]
    changed = [
        (variant.name, claim.sentence, claim.state)
        for variant in VARIANTS
        for claim, before in zip(by_variant[variant.name], base, strict=True)
        if claim.state is not before.state
    ]
    rows = tuple(
        (variant.name, *(claim.state.value for claim in by_variant[variant.name])) for variant in VARIANTS
    )
    numbers = tuple(
        (variant.name, *(claim.evidence.removeprefix("difference ") for claim in by_variant[variant.name]))
        for variant in VARIANTS
    )
    head = ("variant", *(claim.sentence for claim in base))
    why = (
        f"{len(changed)} of {(len(VARIANTS) - 1) * len(base)} conclusions come out otherwise than by "
        f"default: " + "; ".join(f"{name}: {sentence} ({state.value})" for name, sentence, state in changed)
        if changed
        else "No conclusion changes under any variant"
    )
    return Result(
        name="sensitivity",
        title="What hangs on what the paper leaves open",
        source="Sensitivity",
        paper_says=SAYS,
        word=PaperVerdict.NO_VERDICT,
        why=f"{why}.",
        tables=(
            Table("The paper's conclusions under each variant, by the rule of the verdicts.", head, rows),
            Table("The differences that this rests on, with 95 % intervals over trainings.", head, numbers),
            Table(
                "What was varied.",
                ("variant", "what"),
                tuple((variant.name, variant.what) for variant in VARIANTS),
            ),
        ),
        notes=(
            f"{scale.sensitivity_seeds} trainings of {scale.sensitivity_epochs} epochs each: less than the "
            f"tables "
            "have, so that a conclusion may be undecided here and decided there.",
            "Iterations by the closed form of eq. 1, which PyBullet follows within a few ticks, from TCPs "
            "outside the training range.",
        ),
    )


def conclusions(rows: list[dict[str, Any]], picp: str) -> list[PaperClaim]:
    """The paper's six, from one variant's measurements."""
    dnn = [row["models"][0] for row in rows]
    bayesian = [row["models"][1] for row in rows]

    def rmse(models: list[dict[str, Any]], one: str, passes: str) -> list[float]:
        return [model[one][passes]["rmse"] for model in models]

    def share(one: str, axis: int) -> list[float]:
        return [model[one]["10"]["picp"][picp][axis] for model in bayesian]

    def lower(sentence: str, first: list[float], second: list[float]) -> PaperClaim:
        return below_zero(sentence, mean_of(differences(first, second)), unit="mm", scale=1e3)

    took = {name: [row["iterations"][name] for row in rows] for name in (BAYESIAN, OPPOSITE)}
    sooner = mean_of(differences(took[OPPOSITE], took[BAYESIAN]))
    return [
        lower("RMSE falls from 5 to 10 passes", rmse(bayesian, SEEN, "10"), rmse(bayesian, SEEN, "5")),
        below_zero("PICP in x below that in z", mean_of(differences(share(SEEN, 0), share(SEEN, 2)))),
        lower("DNN better in the seen space", rmse(dnn, SEEN, "1"), rmse(bayesian, SEEN, "10")),
        lower("Bayesian DNN better with the TCP unseen", rmse(bayesian, TCP, "10"), rmse(dnn, TCP, "1")),
        below_zero("PICP lower with the TCP unseen", mean_of(differences(share(TCP, 1), share(SEEN, 1)))),
        above_zero("quicker than the opposite pose", sooner, digits=0),
    ]


PART = Part("sensitivity", tasks, result)
