"""An independent check of a certificate of ``prove``: numpy and ``check_network.py`` beside it, no more.

Run: python check.py CERTIFICATE MODEL.  It bounds the answers p to hands h and TCPs t (base frame) in each
box that is called proven or refuted, and refuses what it cannot confirm.  Bounds are forms (centre, symbols,
slack); a ReLU of l < 0 < u is s z + b +- b, s = u / (u - l), b = -s l / 2.  A sum of n terms is off by less
than (n + 17) u of their magnitudes, here and in the program: slack takes that, u above 2^-24 for ONNX files,
2^-53 for others; a claim has to be kept by MARGIN more (m, m2), 100 times what is left.  The optimum is t_opt
+ 0.05 (t - h), t_opt = t + 0.1 d, d the direction of DESIRED - t or the nearest to it on the rim of the cone
of 60 degrees about the way from NOMINAL to DESIRED.  The direction f of v has the derivative (1 - f f^T) /
|v|, and a second one of at most 2 / (sqrt(3) |v|^2).
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import runpy
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Steps = list[Any]  # (name, of which, weight, bias, its size), or (name, of which) for a ReLU
Network = tuple[list[Steps], float, float]  # members, unit roundoff, threshold of their spread
DESIRED, NOMINAL = np.array([0.7, 0.0, 0.35]), np.array([0.84, -0.35, 0.005])
RADIUS, CONE, PULL = 0.1, math.pi / 3.0, 0.05
NAMES = {6: "proven", 7: "refuted", 8: "undecided", 9: "outside"}
PROVEN, REFUTED, UNDECIDED, OUTSIDE = NAMES
KINDS = ("at most", "at least", "optimum", "away", "unsure")
HAND, TCP, ANSWER = "hand_position_in_base_m", "tcp_position_in_base_m", "position_in_base_m"
MARGIN, FARTHEST, AT_ONCE, MOST, LARGE, DOUBLE = 1e-9, 100.0, 2048, 2**28, 1e8, 2e-15


def need(held: bool | np.bool_, what: str) -> None:
    """Refuse unless it holds."""
    if not held:
        raise ValueError(what)


def answers(steps: Steps, u: float, centre: Array, half: Array) -> tuple[Array, ...]:
    """Forms in boxes ``centre`` +- ``half`` (n, 6): answers, symbols (n, k, 3), first the 6 axes', slack."""
    g, count = half[:, :, None] * np.eye(6), 6
    whole = centre, g, u * (u > DOUBLE) * (np.abs(centre) + half)  # which float32 may round
    forms = {name: tuple(x[..., p] for x in whole) for name, p in ((HAND, slice(3)), (TCP, slice(3, 6)))}
    for out, own, *affine in steps:
        wide = ((0, 0), (0, count), (0, 0))
        parts = [(z, np.pad(g, wide)[:, :count], r) for z, g, r in (forms[name] for name in own)]
        z, g, r = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        size = np.abs(z) + (radius := np.abs(g).sum(axis=1) + r)
        need((size < LARGE).all(), "a unit may be out of all bounds")
        if affine:
            weight, bias, most = affine
            r = r @ np.abs(weight) + u * (len(weight) + 17.0) * (size @ np.abs(weight) + most) + 1e-30
            forms[out] = z @ weight + bias, g @ weight, r
            continue
        low, high = z - radius, z + radius
        bent = (low < 0.0) & (high > 0.0)
        slope = np.where(bent, high / np.where(bent, high - low, 1.0), (high > 0.0).astype(float))
        add = np.where(bent, -slope * low / 2.0, 0.0)
        fresh = (add[:, :, None] * np.eye(add.shape[1]))[:, add.any(axis=0)]
        r = slope * r + 50.0 * DOUBLE * (slope * size + 2.0 * add)
        forms[out] = slope * z + add, np.concatenate([g * slope[:, None], fresh], axis=1), r
        count = forms[out][1].shape[1]
    return forms[ANSWER]


def mean_answers(members: list[Steps], u: float, centre: Array, half: Array) -> tuple[Array, ...]:
    """As ``answers``, ``centre`` and ``half`` (n, 6), of the mean; bounds (n,) of the largest spread."""
    forms, part = [answers(steps, u, centre, half) for steps in members], 1.0 / len(members)
    z, own = (part * np.sum(x, axis=0) for x in ([z for z, _, _ in forms], [g[:, :6] for _, g, _ in forms]))
    rests = [np.abs(g[:, 6:]).sum(axis=1) + r for _, g, r in forms]
    slack = part * sum(r + 50.0 * DOUBLE * (np.abs(c) + np.abs(g).sum(axis=1) + r) for c, g, r in forms)
    low = high = np.zeros(centre[:, :3].shape)
    for (middle, g, _), rest in zip(forms, rests, strict=True):
        far, off = np.abs(middle - z), np.abs(g[:, :6] - own).sum(axis=1) + rest + part * sum(rests)
        low, high = low + part * np.maximum(far - off, 0.0) ** 2, high + part * (far + off) ** 2
    g = np.concatenate([own, *(part * g[:, 6:] for _, g, _ in forms)], axis=1)
    return z, g, slack, np.sqrt(low).max(axis=1), np.sqrt(high).max(axis=1)


def lengths(c: Array, g: Array, slack: Array) -> tuple[Array, Array]:
    """Bounds (n,) of lengths of ``c`` (n, 3), ``g`` (n, k, 3), ``slack`` (n, 3) in 3 frames along c."""
    along = c / np.maximum(np.linalg.norm(c, axis=1), 1e-30)[:, None]
    along = np.where((np.linalg.norm(c, axis=1) < 1e-6)[:, None], [1.0, 0.0, 0.0], along)

    def reach(way: Array) -> tuple[Array, Array]:
        off = np.abs(np.einsum("nki,ni->nk", g, way)).sum(axis=1) + (slack * np.abs(way)).sum(axis=1)
        return (c * way).sum(axis=1), off

    (middle, off), highest = reach(along), np.full(len(c), np.inf)
    for axis in np.eye(3):
        side = axis - (along @ axis)[:, None] * along
        norm = np.linalg.norm(side, axis=1)
        ways = (unit := side / np.maximum(norm, 1e-30)[:, None]), np.cross(along, unit)
        squares = (np.abs(middle) + off) ** 2 + sum(sum(map(np.abs, reach(way))) ** 2 for way in ways)
        highest = np.where(norm > 0.1, np.minimum(highest, np.sqrt(squares)), highest)
    return middle - off, highest


def off_optimum(centre: Array, half: Array, z: Array, g: Array, r: Array) -> tuple[Array, Array]:
    """Bounds (n,) of |p - o|: ``centre``, ``half`` (n, 6), ``z`` (n, 3), ``g`` (n, k, 3), ``r`` (n, 3)."""
    axis = (DESIRED - NOMINAL) / np.linalg.norm(DESIRED - NOMINAL)
    tcp, way = centre[:, 3:], DESIRED - centre[:, 3:]
    rho, along, flat = np.linalg.norm(half[:, 3:], axis=1), way @ axis, np.eye(3) - np.outer(axis, axis)
    beyond = along - math.cos(CONE) * np.linalg.norm(way, axis=1)
    lowest, highest = np.full(len(z), np.inf), np.zeros(len(z))
    rim = way @ flat, flat, RADIUS * math.sin(CONE), RADIUS * math.cos(CONE)
    sides = (way, np.eye(3), RADIUS, 0.0), rim
    for sign, (vector, project, scale, up) in zip((1.0, -1.0), sides, strict=True):
        norm = np.linalg.norm(vector, axis=1)
        safe = np.where(clear := norm - rho > 1e-6, norm, 1.0)
        u = vector / safe[:, None]
        tangent = (project - u[:, :, None] * u[:, None, :]) * (scale / safe)[:, None, None]
        e = z - tcp - scale * u - up * axis - PULL * (tcp - centre[:, :3])
        own = g[:, :6].copy()
        own[:, :3] += PULL * half[:, :3, None] * np.eye(3)
        own[:, 3:] += half[:, 3:, None] * (tangent - (1.0 + PULL) * np.eye(3))
        part = np.where(clear, rho / safe, 0.0)
        rest = scale * 2.0 / math.sqrt(3.0) * (-np.log1p(-part) - part)
        low, high = lengths(e, np.concatenate([own, g[:, 6:]], axis=1), r)
        low, high = np.where(clear, low - rest, -np.inf), np.where(clear, high + rest, np.inf)
        applies = sign * beyond + (1.0 + math.cos(CONE)) * rho >= -MARGIN
        lowest = np.where(applies, np.minimum(lowest, low), lowest)
        highest = np.where(applies, np.maximum(highest, high), highest)
    return lowest, highest


def away(centre: Array, half: Array, z: Array, g: Array, r: Array) -> tuple[Array, Array]:
    """Bounds (n,) of products: ``centre``, ``half`` (n, 6), ``z`` (n, 3), ``g`` (n, k, 3), ``r`` (n, 3)."""
    q0, w0 = z - centre[:, 3:], centre[:, 3:] - centre[:, :3]
    own = g[:, :6].copy()
    own[:, 3:] -= half[:, 3:, None] * np.eye(3)
    w = np.concatenate([-half[:, :3, None] * np.eye(3), half[:, 3:, None] * np.eye(3)], axis=1)
    linear = np.einsum("nki,ni->nk", own, w0) + np.einsum("nki,ni->nk", w, q0)
    both = (half_of := np.einsum("nki,nmi->nkm", own, w)) + half_of.transpose(0, 2, 1)
    square, cross = np.einsum("nkk->nk", both) / 2.0, np.triu(np.abs(both), 1).sum(axis=(1, 2))
    off = np.abs(linear).sum(axis=1) + np.abs(square).sum(axis=1) / 2.0 + cross
    off = off + np.abs(np.einsum("nki,ni->nk", g[:, 6:], w0)).sum(axis=1) + (r * np.abs(w0)).sum(axis=1)
    off = off + ((np.abs(g[:, 6:]).sum(axis=1) + r) * np.abs(w).sum(axis=1)).sum(axis=1)
    middle = (q0 * w0).sum(axis=1) + square.sum(axis=1) / 2.0  # e^2 is in [0, 1]
    return middle - off, middle + off


def confirm(network: Network, claim: dict[str, Any], low: Array, high: Array, code: int) -> None:
    """Refused unless all boxes from ``low`` to ``high`` (n, 6) are what ``code`` says of them."""
    kind, limit, (near, far) = KINDS.index(claim["kind"]), claim["limit_m"], claim["region"]["apart_m"]
    half = np.maximum(high - (centre := (low + high) / 2.0), centre - low) * (1.0 + 1e-12)
    gap, wide = np.abs(centre[:, 3:] - centre[:, :3]), half[:, 3:] + half[:, :3]
    nearest, farthest = (np.linalg.norm(w, axis=1) for w in (np.maximum(gap - wide, 0.0), gap + wide))
    if code == OUTSIDE:
        need(((farthest < near - MARGIN) | (nearest > far + MARGIN)).all(), "a box is not outside")
        return
    z, g, r, least_spread, most_spread = mean_answers(*network[:2], centre, half)
    need((np.abs(z) + np.abs(g).sum(axis=1) + r < FARTHEST).all(), "an answer may be out of all bounds")
    if kind < 2:
        g[:, 3:6] -= half[:, 3:, None] * np.eye(3)
        least, most = lengths(z - centre[:, 3:], g, r)
    else:
        least, most = (away if kind == 3 else off_optimum)(centre, half, z, g, r)
    kept, broken = (least - limit, limit - most) if kind in (1, 3) else (limit - most, least - limit)
    if kind == 4:  # a spread above the threshold will do as well
        kept = np.maximum(kept, least_spread - network[2])
        broken = np.minimum(broken, network[2] - most_spread)
    fits = kept >= MARGIN if code == PROVEN else (broken >= MARGIN) & (nearest >= near) & (farthest <= far)
    need(fits.all(), f"a box is not {NAMES[code]}")


def check_claim(network: Network, claim: dict[str, Any]) -> str:
    """What the tree of one claim shows, in words of this file; refused if that is not what it says."""
    region, limit = claim["region"], claim["limit_m"]
    corner = [np.array([[*region[f"hand_{c}_m"], *region[f"tcp_{c}_m"]]], float) for c in ("low", "high")]
    low, high = corner
    need(low.shape == (1, 6) and (np.abs([low, high]) <= FARTHEST).all() and (low <= high).all(), "no box")
    need(0.0 <= limit <= FARTHEST and (claim["kind"] != "away" or limit == 0.0), "no limit")
    codes = np.frombuffer(zlib.decompressobj().decompress(base64.b64decode(claim["tree"]), MOST), np.uint8)
    shares, at, level = dict.fromkeys(NAMES.values(), 0.0), 0, 0
    while len(low):
        here = codes[at : at + len(low)]
        need(len(here) == len(low) and int(here.max()) <= OUTSIDE, "no whole tree")
        for code, name in NAMES.items():
            rows = np.flatnonzero(here == code)
            shares[name] += len(rows) * 2.0**-level
            for part in np.split(rows, range(AT_ONCE, len(rows), AT_ONCE)) if code != UNDECIDED else ():
                confirm(network, claim, low[part], high[part], code)
        rows = np.flatnonzero(here < PROVEN)
        axes, k = here[rows], np.arange(len(rows))
        middle = 0.5 * (low[rows, axes] + high[rows, axes])
        below, above = high[rows], low[rows]
        below[k, axes] = above[k, axes] = middle
        low, high = (np.stack(x, axis=1).reshape(-1, 6) for x in ((low[rows], above), (below, high[rows])))
        at, level = at + len(here), level + 1
    need(at == len(codes) and shares == claim["shares"], f"codes of no box, or the shares are {shares}")
    if (question := claim["question"]) is not None:
        point = np.array([[*question["hand_in_base_m"], *question["tcp_in_base_m"]]], float)
        need(bool(((point >= corner[0]) & (point <= corner[1])).all()), "a question out of the region")
        confirm(network, claim, point, point, REFUTED)
    whole = shares["proven"] > 0.0 and shares["refuted"] == shares["undecided"] == 0.0
    verdict = "refuted" if question else "proven" if whole else "undecided"
    need(claim["verdict"] == verdict, f"it is {verdict}")
    parts = ", ".join(f"{name} {share:.4%}" for name, share in shares.items())
    where = f"hand and TCP from {corner[0][0].tolist()} to {corner[1][0].tolist()}, {region['apart_m']} apart"
    return f"{verdict}: {claim['kind']} {limit:g} m; {where} (m): {parts}"


def check(certificate: bytes, model: bytes) -> list[str]:
    """What is confirmed, a line a claim; ValueError, or another exception, if anything is not."""
    found = json.loads(certificate)
    need(found["format"] == "safety-harness certificate 1" and found["claims"] != [], "no certificate")
    need(found["model_sha256"] == hashlib.sha256(model).hexdigest(), "it is of another network")
    reader = runpy.run_path(str(Path(__file__).with_name("check_network.py")))
    network = reader["network_of"](model)
    return [check_claim(network, claim) for claim in found["claims"]]


if __name__ == "__main__":
    print(*check(Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]).read_bytes()), sep="\n")  # noqa: T201
