"""Outlook: the ground truth by least object-pose error, and the trigger by a plane of two hands."""

from __future__ import annotations

from typing import Any

import numpy as np

from safety_harness.base.settings import DEFAULTS
from safety_harness_paper.intervals import Paired, bootstrap_of
from safety_harness_paper.networks import inter
from safety_harness_paper.outlook import IMAGE, POSE, measurement
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import (
    PaperClaim,
    PaperVerdict,
    Result,
    Table,
    below_zero,
    estimate_words,
    every,
    fewer,
)
from safety_harness_paper.scale import Scale
from safety_harness_paper.two_hands import EITHER, PLANE, TRIGGERS, WALL
from safety_harness_paper.two_hands import measurement as plane_trigger
from safety_harness_paper.work import Task

SAYS = (
    "When PBVS is used instead of IBVS, the ground truth can be the candidate with the least object-pose "
    "error. (Proposed, not tried.)"
)
BOOTSTRAP_SEED = 6


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """Selections and trials; episodes with two hands."""
    episodes = max(scale.episodes // 5, 2)
    return {
        "pose": measurement(tcps=scale.pairs // 2, trials=scale.few_trials, root=root, settings=DEFAULTS),
        "plane": plane_trigger(inter(scale, root, 0), episodes=episodes, root=root, settings=DEFAULTS),
    }


def result(scale: Scale, found: Found) -> Result:
    """No figure of the paper: what we found."""
    one = found["pose"].result
    upright = one["selections"][0]
    claims: list[PaperClaim] = [
        every(
            "with exact images of an upright camera both select the same candidate",
            upright["same"],
            upright["tcps"],
        )
    ]
    rows = []
    for trial in one["trials"]:
        pairs = [
            (a[1], b[1])
            for a, b in zip(trial["systems"][IMAGE], trial["systems"][POSE], strict=True)
            if a[1] is not None and b[1] is not None
        ]
        tilt = trial["tilt_deg"]
        cells = [
            f"{sum(fate == 'converged' for fate, _ in trial['systems'][name])}" for name in (IMAGE, POSE)
        ]
        if pairs:
            gained = np.array([b - a for a, b in pairs], dtype=np.float64)
            difference = bootstrap_of(gained, "mean", seed=BOOTSTRAP_SEED)
            claims.append(
                below_zero(
                    f"tilted by {tilt:g} degrees, servoing on from the least object-pose error is quicker",
                    difference,
                    unit="iterations",
                    digits=1,
                )
            )
            means = np.array(pairs, dtype=np.float64).mean(axis=0)
            rows.append(
                (
                    f"{tilt:g} deg",
                    f"{means[0]:.1f}",
                    f"{means[1]:.1f}",
                    estimate_words(difference, digits=1),
                    *cells,
                )
            )
        else:
            rows.append((f"{tilt:g} deg", "-", "-", "-", *cells))
    episodes = found["plane"].result["triggers"]
    for trigger in (PLANE, WALL):
        pairs_of = Paired.of(_nearer(episodes[trigger]), _nearer(episodes[EITHER]))
        claims.append(
            fewer(
                f"two hands: fewer episodes below 50 mm when triggered by the {trigger}",
                f"the {trigger}",
                f"the {EITHER}",
                pairs_of,
            )
        )
    return Result(
        name="outlook",
        title="Ground truth by object-pose error; a plane for two hands",
        source="Section 6, outlook",
        paper_says=SAYS,
        word=PaperVerdict.NO_VERDICT,
        why="A proposal of the paper, tried: "
        + ("nothing changes" if upright["same"] == upright["tcps"] else "the selection changes")
        + " while the tool is upright and images are exact. The claims below are ours.",
        claims=tuple(claims),
        tables=(_selections(one["selections"]), _trials(rows), _triggers(episodes)),
        notes=(
            "Upright, the image error of a candidate is exactly its displacement from the desired position, "
            "so that a network trained for either ground truth is the same network.",
        ),
    )


def _selections(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "How often least image error and least object-pose error select the same of 100 candidates, how far "
        "apart the two are, and how much farther from the desired position the image's choice is. Candidates "
        "without the whole object in view are left out.",
        ("images", "the same", "apart, RMS", "farther, mean", "TCPs without view"),
        tuple(
            (
                row["name"],
                f"{100.0 * row['same'] / row['tcps']:.1f} % of {row['tcps']:,}",
                f"{1e3 * row['apart_rms_m']:.2f} mm",
                f"{1e3 * row['farther_from_goal_m']:.2f} mm",
                str(row["without_view"]),
            )
            for row in rows
        ),
    )


def _nearer(episodes: list[dict[str, Any]]) -> list[bool]:
    return [one["verdict"] == "violated" for one in episodes]


def _triggers(episodes: dict[str, list[dict[str, Any]]]) -> Table:
    rows = []
    for trigger in TRIGGERS:
        found = episodes[trigger]
        violated = sum(_nearer(found))
        exercised = sum(one["verdict"] != "inconclusive" for one in found)
        first = [one["first_decision_s"] for one in found if one["first_decision_s"] is not None]
        rows.append(
            (
                trigger,
                f"{violated} of {exercised}",
                f"{np.mean([one['decisions'] for one in found]):.1f}",
                f"{np.mean(first):.2f} s" if first else "-",
                f"{100.0 * np.mean([one['share_stopped'] for one in found]):.0f} %",
                f"{100.0 * np.mean([one['share_servoing'] for one in found]):.0f} %",
            )
        )
    return Table(
        f"{len(episodes[EITHER])} PyBullet episodes of ten seconds in which two hands come near, stay and "
        f"leave, "
        "the same draws for each trigger; the Bayesian DNN behind the full gate. Plane: vertical, through "
        "both predicted hands; wall: its part between them.",
        ("trigger", "nearer than 50 mm", "decisions", "first one", "stopped", "servoing"),
        tuple(rows),
    )


def _trials(rows: list[tuple[str, ...]]) -> Table:
    return Table(
        "PyBullet trials from seen TCPs that start tilted: iterations from arrival to the gain switch, where "
        "both converged; the difference with a bootstrap interval.",
        ("tilt", IMAGE, POSE, "difference", "converged (image)", "converged (pose)"),
        tuple(rows),
    )


PART = Part("outlook", tasks, result)
