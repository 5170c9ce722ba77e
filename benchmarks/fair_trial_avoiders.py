"""Fourteen faulty avoiders and sixty harmless changes, written from the documents alone.

Try one: ``safety-harness evaluate benchmarks/fair_trial_avoiders.py:NAME``.  Those in
FILES are model or ONNX files, which ``make_file(NAME, folder)`` writes.  Every entry says what it changes.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness import AvoiderAround, Proposal, shipped_avoider

MC, STUDENT, STUDENTS, PLAIN, FIVE, AWAY = (
    "mc-dropout",
    "student",
    "student-ensemble",
    "deterministic",
    "ensemble",
    "opposite pose",
)
log = logging.getLogger("fair trial")


def same(value: Any, *_: Any) -> Any:
    """Change nothing."""
    return value


@dataclass(frozen=True)
class Change:
    """What is changed of a reference: its questions, its answers, or the asking itself."""

    about: str
    of: str = MC
    ask: Callable[..., Any] | None = None  # (h, t, s) -> (h, t, s)
    answer: Callable[..., Any] | None = None  # (p, d, h, t, s) -> (p, d)
    whole: Callable[..., Any] | None = None  # (asked, h, t, s) -> (p, d), in place of both
    members: dict[str, Any] | None = None  # what the avoider declares beside


class Changed(AvoiderAround):
    """An avoider of ours with one change around it."""

    def __init__(self, change: Change) -> None:
        super().__init__(shipped_avoider(change.of))
        self.change = change

    def asked(self, h: Any, t: Any, s: Any) -> Any:
        """Ask the reference, one by one where it has no batch."""
        if hasattr(self.avoider, "propose_many"):
            return self.avoider.propose_many(h, t, s)
        every = [
            self.avoider.propose(hand_position_in_base_m=a, tcp_position_in_base_m=b, seed=int(c))
            for a, b, c in zip(h, t, s, strict=True)
        ]
        return np.array([one.position_in_base_m for one in every]), None

    def propose_many(self, h: Any, t: Any, s: Any) -> Any:
        """Answer many questions."""
        if self.change.whole is not None:
            return self.change.whole(self.asked, h, t, s)
        position, spread = self.asked(*(self.change.ask(h, t, s) if self.change.ask else (h, t, s)))
        return self.change.answer(position, spread, h, t, s) if self.change.answer else (position, spread)

    def propose(self, *, hand_position_in_base_m: Any, tcp_position_in_base_m: Any, seed: int) -> Proposal:
        """Answer one, as the batch would."""
        position, spread = self.propose_many(
            hand_position_in_base_m[None], tcp_position_in_base_m[None], np.array([seed], np.uint64)
        )
        return Proposal(position[0]) if spread is None else Proposal(position[0], spread[0])


class Alone(Changed):
    """The same, asked one by one."""

    propose_many = None  # type: ignore[assignment]

    def propose(self, *, hand_position_in_base_m: Any, tcp_position_in_base_m: Any, seed: int) -> Proposal:
        """Answer one."""
        self_many = Changed.propose_many
        position, spread = self_many(
            self, hand_position_in_base_m[None], tcp_position_in_base_m[None], np.array([seed], np.uint64)
        )
        return Proposal(position[0]) if spread is None else Proposal(position[0], spread[0])


class Seeing(Alone):
    """The same, which sees more, and may use it."""

    def propose(self, *, seen: Any, **question: Any) -> Proposal:  # type: ignore[override]
        """Answer one, about the hand that ``change.members['looks']`` makes of what is seen."""
        return super().propose(**self.looks(seen, question))  # type: ignore[attr-defined]


def to_step(value: Any, step: float) -> Any:
    """Round to multiples of a step."""
    return np.round(value / step) * step


def noise(s: Any, sigma_m: float) -> Any:
    """Draw three normal numbers for each seed."""
    return np.array([np.random.default_rng(int(one)).normal(0.0, sigma_m, 3) for one in s]).reshape(-1, 3)


def a_tenth(h: Any, salt: int) -> Any:
    """Say which hands are in the tenth of all 100 mm cells that a hash chooses."""
    cells = np.floor(np.atleast_2d(h) * 10.0).astype(int) + 1000
    keys = (cells * [73856093, 19349663, 83492791]).sum(axis=1) + salt * 15485863
    return ((keys * 2654435761) % 2**32) / 2**32 < 0.1


def where(mask: Any, wrong: Any, right: Any) -> Any:
    """Take the wrong rows where the mask says so."""
    return np.where(np.reshape(mask, (-1, 1)), wrong, right)


def turned(degrees: float) -> Any:
    """Turn about z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# ---- fourteen faults

last: list[Any] = []


def stale(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Answer the question before."""
    p, d = asked(h, t, s)
    before = last[-1] if last else (p[:1], d[:1])
    last[:] = [(p[-1:].copy(), d[-1:].copy())]
    return np.concatenate((before[0], p[:-1])), np.concatenate((before[1], d[:-1]))


def raises(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Raise in one tenth of all places."""
    if a_tenth(h, 5).any():
        raise KeyError("no entry in the table for this hand")
    return asked(h, t, s)


def unseen(h: Any) -> Any:
    """Say which hands are outside the paper's space."""
    return ((h < [0.54, -0.65, -0.295]) | (h > [1.14, -0.05, 0.305])).any(axis=1)


def farthest(seen: Any, question: dict[str, Any]) -> dict[str, Any]:
    """Ask about the hand that is farthest."""
    tcp = question["tcp_position_in_base_m"]
    hands = [one.position_in_base_m for one in seen.predicted_hands]
    far = max(
        hands, key=lambda one: float(np.linalg.norm(one - tcp)), default=question["hand_position_in_base_m"]
    )
    return {**question, "hand_position_in_base_m": np.array(far)}


FAULTS: dict[str, Change] = {
    "towards_by_seed": Change(
        "heads for the hand in a tenth of all seeds",
        answer=lambda p, d, h, t, s: (where(np.asarray(s) % 10 == 3, t + (h - t) * 0.5, p), d),
    ),
    "towards_by_place": Change(
        "heads for the hand in a tenth of all places",
        answer=lambda p, d, h, t, s: (where(a_tenth(h, 1), t + (h - t) * 0.5, p), d),
    ),
    "stays_by_place": Change(
        "answers the TCP itself in a tenth of all places",
        answer=lambda p, d, h, t, s: (where(a_tenth(h, 2), t, p), d),
    ),
    "nan_by_place": Change(
        "answers NaN in a tenth of all places",
        answer=lambda p, d, h, t, s: (where(a_tenth(h, 3), np.nan, p), d),
    ),
    "raises_by_place": Change("raises in a tenth of all places", whole=raises),
    "one_answer_behind": Change("answers the question before", whole=stale),
    "noise_without_seed": Change(
        "adds noise of 40 mm that no seed repeats",
        answer=lambda p, d, h, t, s: (
            p + np.frombuffer(os.urandom(p.size), np.uint8).reshape(p.shape) / 3200 - 0.04,
            d,
        ),
    ),
    "sure_where_unseen": Change(
        "says a spread of 1 mm for hands outside the seen space",
        answer=lambda p, d, h, t, s: (p, where(unseen(h), 0.001, d)),
    ),
    "stale_normalisation": Change(
        "normalises by another data set's mean and deviation: TCP 60 mm off, hands 15 % farther",
        ask=lambda h, t, s: (0.84 + (h - 0.84) * 1.15, t + [0.06, 0.0, -0.03], s),
    ),
    "x_and_y_swapped": Change(
        "swaps the hand's x and y, in the frame of the cell's middle",
        ask=lambda h, t, s: (np.stack((h[:, 1] + 1.19, h[:, 0] - 1.19, h[:, 2]), axis=1), t, s),
    ),
    "into_the_table": Change(
        "leads 400 mm down in a tenth of all places",
        answer=lambda p, d, h, t, s: (where(a_tenth(h, 6), p - [0.0, 0.0, 0.4], p), d),
    ),
    "too_far": Change(
        "gives a way ten times as long in a tenth of all places",
        answer=lambda p, d, h, t, s: (where(a_tenth(h, 7), t + (p - t) * 10.0, p), d),
    ),
    "answers_after_96_ms": Change("declares 96 ms, honestly", members={"decision_time_s": 0.096}),
    "other_hand": Change(
        "answers for the farthest hand",
        members={"sees": ("predicted hands",), "looks": staticmethod(farthest)},
    ),
}


# ---- sixty harmless changes


def one_by_one(asked: Any, h: Any, t: Any, s: Any, n: int = 1) -> Any:
    """Ask in pieces of n."""
    pieces = [asked(h[i : i + n], t[i : i + n], s[i : i + n]) for i in range(0, len(h), n)]
    return np.concatenate([one[0] for one in pieces]), np.concatenate([one[1] for one in pieces])


def in_threads(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Ask two halves in two threads."""
    half = len(h) // 2 or 1
    with ThreadPoolExecutor(2) as pool:
        parts = list(
            pool.map(lambda rows: asked(h[rows], t[rows], s[rows]), (slice(0, half), slice(half, None)))
            if len(h) > 1
            else [asked(h, t, s)]
        )
    return tuple(np.concatenate([one[i] for one in parts]) for i in (0, 1))


def in_order(order: Callable[[int], Any]) -> Callable[..., Any]:
    """Ask in another order and put the answers back."""

    def ask(asked: Any, h: Any, t: Any, s: Any) -> Any:
        rows = order(len(h))
        p, d = asked(h[rows], t[rows], s[rows])
        back = np.argsort(rows)
        return p[back], d[back]

    return ask


def padded(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Fill up to a multiple of eight by copies of the last question."""
    rows = np.minimum(np.arange(-(-len(h) // 8) * 8), len(h) - 1)
    p, d = asked(h[rows], t[rows], s[rows])
    return p[: len(h)], d[: len(h)]


cache: dict[bytes, Any] = {}


def cached(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Keep every answer by its exact question."""
    keys = [a.tobytes() + b.tobytes() + str(int(c)).encode() for a, b, c in zip(h, t, s, strict=True)]
    new = [i for i, key in enumerate(keys) if key not in cache]
    if new:
        p, d = asked(h[new], t[new], s[new])
        cache.update({keys[i]: (p[j], d[j]) for j, i in enumerate(new)})
    return np.array([cache[key][0] for key in keys]), np.array([cache[key][1] for key in keys])


def logged(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Log every batch."""
    log.debug("asked %d questions, the first about %s", len(h), h[0])
    return asked(h, t, s)


def slept(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Take half a millisecond more."""
    time.sleep(0.0005)
    return asked(h, t, s)


def asked_twice(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Ask twice, and give the second answer."""
    asked(h, t, s)
    return asked(h, t, s)


def two_asks(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Give the mean of two askings with different seeds: twenty passes in all."""
    (p, d), (q, e) = asked(h, t, s), asked(h, t, np.asarray(s, np.uint64) ^ np.uint64(1 << 20))
    return (p + q) / 2.0, np.sqrt((d**2 + e**2) / 2.0 + ((p - q) / 2.0) ** 2)


def polar(p: Any, d: Any, h: Any, t: Any, s: Any) -> Any:
    """Go to spherical coordinates about the TCP and back."""
    x, y, z = (p - t).T
    r, azimuth, rise = np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    return t + (
        r * np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
    ).T, d


def framed(p: Any, d: Any, h: Any, t: Any, s: Any) -> Any:
    """Go to another frame by a homogeneous transform, and back by its inverse."""
    there = np.eye(4)
    there[:3, :3], there[:3, 3] = turned(37.0), [0.3, -0.2, 0.8]
    at = np.linalg.inv(there) @ (there @ np.concatenate((p, np.ones((len(p), 1))), axis=1).T)
    return at[:3].T, d


def own_opposite(length_m: float = 0.1, kind: type = np.float64) -> Callable[..., Any]:
    """Go straight away from the hand, written anew."""

    def answer(asked: Any, h: Any, t: Any, s: Any) -> Any:
        way = np.asarray(t, kind) - np.asarray(h, kind)
        return t + length_m * way / (np.sqrt((way**2).sum(axis=1, keepdims=True)) + 1e-12), None

    return answer


def mirrored(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Ask in the mirror image of the cell, and mirror the answer."""
    across = np.array([1.0, -1.0, 1.0])
    return asked(h * across, t * across, s)[0] * across, None


def by_angles(asked: Any, h: Any, t: Any, s: Any) -> Any:
    """Go straight away by azimuth and elevation."""
    x, y, z = (t - h).T
    a, e = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    return t + 0.1 * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]).T, None


def a_tick_ahead(seen: Any, question: dict[str, Any]) -> dict[str, Any]:
    """Ask about the hand as it will be one tick of 8 ms later."""
    at = question["hand_position_in_base_m"]
    one = min(
        seen.predicted_hands,
        key=lambda hand: float(np.linalg.norm(hand.position_in_base_m - at)),
        default=None,
    )
    return (
        question
        if one is None
        else {**question, "hand_position_in_base_m": at + 0.008 * one.velocity_in_base_mps}
    )


def hashed(s: Any) -> Any:
    """Make another seed of each."""
    return np.array(
        [int.from_bytes(hashlib.sha256(str(int(one)).encode()).digest()[:8], "big") for one in s], np.uint64
    )


def rounded(step_m: float) -> Callable[..., Any]:
    """Round answers."""
    return lambda p, d, h, t, s: (to_step(p, step_m), d)


def through(*kinds: Any) -> Callable[..., Any]:
    """Convert answers and spreads to other number formats one after another, and back."""

    def answer(p: Any, d: Any, *_: Any) -> Any:
        for kind in kinds:
            p, d = p.astype(kind), None if d is None else d.astype(kind)
        return p.astype(float), None if d is None else d.astype(float)

    return answer


def clamped(p: Any, d: Any, h: Any, t: Any, s: Any) -> Any:
    """Keep answers within 1.3 m of the base, as a guard would."""
    far = np.linalg.norm(p, axis=1, keepdims=True)
    return p * np.minimum(1.0, 1.3 / far), d


HARMLESS: dict[str, Change] = {
    "to_10_um": Change("answers rounded to 0.01 mm", answer=rounded(1e-5)),
    "to_100_um": Change("answers rounded to 0.1 mm", answer=rounded(1e-4)),
    "to_500_um": Change("answers rounded to 0.5 mm", answer=rounded(5e-4)),
    "to_1_mm": Change("answers rounded to 1 mm", answer=rounded(1e-3)),
    "cut_to_100_um": Change(
        "answers cut off at 0.1 mm", answer=lambda p, d, *_: (np.floor(p * 1e4) / 1e4, d)
    ),
    "spread_to_100_um": Change(
        "spreads rounded up to 0.1 mm", answer=lambda p, d, *_: (p, np.ceil(d * 1e4) / 1e4)
    ),
    "hand_to_100_um": Change("hands rounded to 0.1 mm", ask=lambda h, t, s: (to_step(h, 1e-4), t, s)),
    "hand_to_1_mm": Change("hands rounded to 1 mm", ask=lambda h, t, s: (to_step(h, 1e-3), t, s)),
    "tcp_to_100_um": Change("TCPs rounded to 0.1 mm", ask=lambda h, t, s: (h, to_step(t, 1e-4), s)),
    "answer_float32": Change("answers in single precision", answer=through(np.float32)),
    "answer_float16": Change("answers in half precision", answer=through(np.float16)),
    "question_float32": Change(
        "questions in single precision",
        ask=lambda h, t, s: (*(one.astype("f4").astype(float) for one in (h, t)), s),
    ),
    "question_float16": Change(
        "questions in half precision",
        ask=lambda h, t, s: (*(one.astype("f2").astype(float) for one in (h, t)), s),
    ),
    "byte_order": Change("answers through the other byte order", answer=through(">f8", ">f4")),
    "column_order": Change(
        "answers in Fortran's order", answer=lambda p, d, *_: (np.asfortranarray(p), np.asfortranarray(d))
    ),
    "through_json": Change(
        "answers written as text and read again",
        answer=lambda p, d, *_: (np.array(json.loads(json.dumps(p.tolist()))), d),
    ),
    "millimetres": Change(
        "answers in millimetres and back", answer=lambda p, d, *_: (p * 1e3 / 1e3, d * 1e3 / 1e3)
    ),
    "inches": Change(
        "questions and answers in inches and back",
        ask=lambda h, t, s: (h / 0.0254 * 0.0254, t / 0.0254 * 0.0254, s),
        answer=lambda p, d, *_: (p / 0.0254 * 0.0254, d / 0.0254 * 0.0254),
    ),
    "spherical": Change("answers in spherical coordinates and back", answer=polar),
    "homogeneous": Change("answers by a 4 x 4 transform and back", answer=framed),
    "turned_base": Change(
        "questions turned by 180 degrees and back",
        ask=lambda h, t, s: (h @ turned(180.0) @ turned(180.0), t @ turned(180.0) @ turned(180.0), s),
    ),
    "relative": Change("answers relative to the TCP and back", answer=lambda p, d, h, t, s: ((p - t) + t, d)),
    "batch_reversed": Change("a batch asked in reverse", whole=in_order(lambda n: np.arange(n)[::-1])),
    "batch_shuffled": Change(
        "a batch asked in another order", whole=in_order(lambda n: np.random.default_rng(n).permutation(n))
    ),
    "batch_of_one": Change("a batch asked one by one", whole=one_by_one),
    "batch_of_seven": Change("a batch asked by sevens", whole=lambda a, h, t, s: one_by_one(a, h, t, s, 7)),
    "batch_padded": Change("a batch filled up to a multiple of eight", whole=padded),
    "two_threads": Change("two halves of a batch in two threads", whole=in_threads),
    "no_batch": Change("no propose_many"),
    "logs_batches": Change("logs each batch", whole=logged),
    "keeps_answers": Change("keeps answers by their exact question", whole=cached),
    "second_answer": Change("asks twice, gives the second answer", whole=asked_twice),
    "half_a_ms_slower": Change("takes 0.5 ms more", whole=slept),
    "declares_1_ms": Change("declares 1 ms", members={"decision_time_s": 0.001}),
    "declares_8_ms": Change("declares 8 ms: one tick", members={"decision_time_s": 0.008}),
    "hand_a_tick_later": Change(
        "asks about the hand one tick later",
        members={"sees": ("predicted hands",), "looks": staticmethod(a_tick_ahead)},
    ),
    "sees_joints": Change(
        "sees joints, and looks at none",
        members={"sees": ("joints",), "looks": staticmethod(lambda seen, q: q)},
    ),
    "seed_plus_1": Change(
        "other seeds: one more", ask=lambda h, t, s: (h, t, np.asarray(s, np.uint64) + np.uint64(1))
    ),
    "seed_xor": Change(
        "other seeds: bits flipped",
        ask=lambda h, t, s: (h, t, np.asarray(s, np.uint64) ^ np.uint64(0xA5A5A5)),
    ),
    "seed_hashed": Change("other seeds: hashed", ask=lambda h, t, s: (h, t, hashed(s))),
    "twenty_passes": Change("the mean of two askings: twenty passes", whole=two_asks),
    "noise_100_um": Change(
        "noise of 0.1 mm from the seed", answer=lambda p, d, h, t, s: (p + noise(s, 1e-4), d)
    ),
    "spread_plus_100_um": Change("spreads 0.1 mm larger", answer=lambda p, d, *_: (p, d + 1e-4)),
    "kept_within_reach": Change("answers kept within 1.3 m of the base", answer=clamped),
    "hand_1_mm_off": Change("hands 1 mm off: calibration", ask=lambda h, t, s: (h + [0.0, 0.001, 0.0], t, s)),
    "opposite_anew": Change("the opposite pose written anew", of=AWAY, whole=own_opposite()),
    "opposite_mirrored": Change("mirrored arithmetic", of=AWAY, whole=mirrored),
    "opposite_by_angles": Change("the opposite pose by azimuth and elevation", of=AWAY, whole=by_angles),
    "opposite_half_mm_longer": Change("the opposite pose at 100.5 mm", of=AWAY, whole=own_opposite(0.1005)),
}


# ---- eleven harmless files


def _model(of: str) -> Any:
    import safety_harness
    from safety_harness.cell.avoidance.model_file import load_model

    return load_model(Path(safety_harness.__file__).parent / "models" / f"{of}.safetensors")


def _tensors(change: Callable[[str, Any], Any]) -> Callable[[Any], Any]:
    return lambda model: replace(
        model,
        tensors={
            name: np.ascontiguousarray(change(name, one), np.float32) for name, one in model.tensors.items()
        },
    )


def _member(index: int) -> Callable[[Any], Any]:
    def take(model: Any) -> Any:
        several = _model(STUDENTS)
        kept = {
            f"0/{name.split('/')[1]}": one for name, one in several.tensors.items() if name[0] == str(index)
        }
        return replace(several, tensors=kept, members=1, passes=model.passes, calibration=model.calibration)

    return take


def _bfloat16(name: str, one: Any) -> Any:
    bits = np.ascontiguousarray(one, np.float32).view(np.uint32)
    return ((bits + np.uint32(0x8000)) & np.uint32(0xFFFF0000)).view(np.float32)


def _hidden_permuted(model: Any) -> Any:
    order, one = np.random.default_rng(1).permutation(32), dict(model.tensors)
    one["0/fc1.weight"], one["0/fc1.bias"] = one["0/fc1.weight"][order], one["0/fc1.bias"][order]
    one["0/fc2.weight"] = np.ascontiguousarray(one["0/fc2.weight"][:, order])
    return replace(model, tensors=one)


def _onnx(path: Path, of: str, change: str) -> None:
    import subprocess

    plain = path.with_name(f"{of}.onnx")
    if not plain.exists():
        subprocess.run(["safety-harness", "export", of, "--out", str(plain)], check=True, capture_output=True)
    if change == "int8":
        from onnxruntime.quantization import quantize_dynamic

        quantize_dynamic(plain, path)
        return
    import onnx

    net = onnx.load(str(plain))
    if change == "no-op":
        name = net.graph.output[0].name
        for node in net.graph.node:
            node.output[:] = ["before" if one == name else one for one in node.output]
            node.input[:] = ["before" if one == name else one for one in node.input]
        net.graph.node.append(onnx.helper.make_node("Identity", ["before"], [name]))
    onnx.save(net, str(path))


FILES: dict[str, tuple[str, str, Any]] = {  # what it is, what it is compared with, how it is made
    "eleven_passes": ("one pass more", MC, lambda model: replace(model, passes=11)),
    "nine_passes": ("one pass less", MC, lambda model: replace(model, passes=9)),
    "weights_float16": ("weights in half precision", MC, _tensors(lambda name, one: one.astype(np.float16))),
    "weights_bfloat16": ("weights in bfloat16", MC, _tensors(_bfloat16)),
    "rescaled": (
        "last layer four times as large, target deviation a quarter",
        MC,
        lambda model: replace(
            _tensors(lambda name, one: one * 4 if "fc_out" in name else one)(model),
            target_std=tuple(one / 4 for one in model.target_std),
        ),
    ),
    "member_order": (
        "members in reverse order",
        FIVE,
        lambda model: replace(
            model, tensors={f"{4 - int(name[0])}{name[1:]}": one for name, one in model.tensors.items()}
        ),
    ),
    "hidden_permuted": ("hidden units in another order", STUDENT, _hidden_permuted),
    "onnx": ("exported to ONNX", MC, "plain"),
    "onnx_no_op": ("exported to ONNX with a layer that does nothing", MC, "no-op"),
    "onnx_int8": ("the student exported and quantised to int8", STUDENT, "int8"),
    "retrained": ("trained from another seed: a member of the student ensemble", STUDENT, _member(1)),
}


def make_file(name: str, folder: Path) -> Path:
    """Write one of FILES, and say where."""
    from safety_harness.cell.avoidance.model_file import save_model

    _, of, change = FILES[name]
    path = folder / f"{name}{'.onnx' if isinstance(change, str) else '.safetensors'}"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        if isinstance(change, str):
            _onnx(path, of, change)
        else:
            save_model(change(_model(of)), path)
    return path


def __getattr__(name: str) -> Any:
    change = (FAULTS | HARMLESS).get(name)
    if change is None:
        raise AttributeError(name)
    alone = change.of == AWAY or name in ("no_batch", "raises_by_place")  # the opposite pose has no spread
    kind = Alone if alone else Changed
    kind = Seeing if "sees" in (change.members or {}) else kind
    return type(name, (kind,), {"name": name, **(change.members or {})})(change)
