"""Check a certificate of ``prove`` independently, with numpy; ONNX files also need ONNX's reference.

Run: python check.py CERTIFICATE MODEL. The program bounds the answers p to hands h and TCPs t in the proven
and refuted boxes. A network is a list of steps (name, inputs, weight, bias, magnitude of the bias's terms),
or (name, inputs) for a ReLU. A bound is a form (centre, symbols, slack). A ReLU with l < 0 < u becomes s z +
b +- b, with s = u / (u - l) and b = -s l / 2. The error of a sum of n terms is at most (n + 17) u times their
magnitudes. For ONNX files u exceeds 2^-24, else 2^-53. Confirmed bounds keep a MARGIN. The optimum is t + 0.1
d + 0.05 (t - h). Here d is the direction of v = DESIRED - t, or the nearest direction in the cone CONE about
AXIS. The derivative of d is (1 - d d^T) / |v|; the second is at most 2 / (sqrt(3) |v|^2).
"""

import base64
import hashlib
import json
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
DESIRED, NOMINAL, EYE = np.array([0.7, 0.0, 0.35]), np.array([0.84, -0.35, 0.005]), np.eye(3)
RADIUS, CONE, PULL, AXIS = 0.1, np.pi / 3.0, 0.05, (DESIRED - NOMINAL) / np.linalg.norm(DESIRED - NOMINAL)
PROVEN, REFUTED, UNDECIDED, OUTSIDE = NAMES = {6: "proven", 7: "refuted", 8: "undecided", 9: "outside"}
BELOW, ABOVE, FORMAT = ("at most", "optimum", "unsure"), ("at least", "away"), "safety-harness certificate 1"
HAND, TCP, ANSWER = "hand_position_in_base_m", "tcp_position_in_base_m", "position_in_base_m"
MARGIN, FARTHEST, LARGE, MOST, LARGEST, SINGLE, DOUBLE = 1e-9, 100.0, 1e8, 2**28, 2**22, 6e-8, 2e-15
SUMS, AFFINE = ("Add", "Sub", "Concat"), ("Gemm", "MatMul", "Mul", "Div", "Identity", "Flatten", "Cast")
NORM, LEGAL = "BatchNormalization", {"training_mode": (0,), "to": (1, 11)}  # no training; casts to floats


def need(held: bool | np.bool_, message: str) -> None:
    """Raise ValueError with ``message`` if ``held`` is False."""
    if not held:
        raise ValueError(message)


def network_of(data: bytes) -> tuple[list[Any], float, float]:
    """Return the steps, u and the spread's threshold; a perceptron's last steps give mean and deviations."""
    if data[8:9] != b"{":
        return onnx_steps(data), SINGLE, np.nan
    tensors = json.loads(data[8 : (start := 8 + int.from_bytes(data[:8], "little"))])
    card = json.loads(tensors.pop("__metadata__")["safety_harness"])
    need(card["kind"] == "relu perceptron" and (m := card["members"]) >= 1, "the network is no perceptron")
    mean, std, to, dev = (np.array(card[k]) for k in ("input_mean", "input_std", "target_mean", "target_std"))
    for name, raw in tensors.items():
        tensors[name] = np.frombuffer(data[start:][slice(*raw["data_offsets"])], "<f4").reshape(raw["shape"])
    steps, each = list[Any](), [f"{k}" for k in range(m)]
    for k in each:
        w, b = ([tensors[f"{k}/fc{n}.{part}"] for n in ("1", "2", "_out")] for part in ("weight", "bias"))
        w[0], w[2] = w[0] / std, w[2] * dev[:, None]
        b[0], b[2] = b[0] - w[0] @ mean, to + dev * b[2]
        x, y, z = ((w[n].T, b[n], np.abs(b[n])) for n in range(3))
        steps += [("x", [HAND, TCP], *x), ("x", ["x"]), ("y", ["x"], *y), ("y", ["y"]), (k, ["y"], *z)]
    mean = np.tile(EYE, (m, 1)) / m
    steps += [(ANSWER, each, mean, 0.0, 0.0), ("off", each, np.eye(3 * m) - np.tile(mean, m), 0.0, 0.0)]
    return steps, DOUBLE, (card["calibration"] or {}).get("spread_threshold_m", np.nan)


def onnx_steps(data: bytes) -> list[Any]:
    """Return the steps of a file; ONNX's reference computes the affine maps from 0 and unit vectors."""
    import onnx.reference

    evaluator: Any = onnx.reference.ReferenceEvaluator
    model: Any = onnx.load_from_string(data)
    need(model.opset_import[0].version >= 9, "operators of an old version")
    need(not any(arg.external_data for arg in model.graph.initializer), "weights in another file")
    known = {x.name: onnx.numpy_helper.to_array(x).astype(float) for x in model.graph.initializer}
    steps, widths = list[Any](), dict[Any, int]({HAND: 3, TCP: 3})
    for node in model.graph.node:
        op, out, shown = node.op_type, node.output[0], [name in widths for name in node.input]
        own = [name for name in dict.fromkeys(node.input) if name in widths]
        legal = not node.domain and all(arg.i in LEGAL.get(arg.name, (arg.i,)) for arg in node.attribute)
        alone = sum(shown) == 1 and (shown[0] or op == "Mul") and op in (*AFFINE, NORM)
        if op == "Constant":
            known[out] = np.asarray(evaluator(node).run(None, {})[0], float)
        elif op == "Relu" and own:
            widths[out] = widths[own[0]]
            steps.append((out, own))
        elif legal and (alone or (own and op in SUMS)) and {*node.input} <= known.keys() | widths.keys():
            ends = np.cumsum([widths[name] for name in own])
            rows = np.split(np.eye(ends[-1] + 1, ends[-1], k=-1), ends[:-1], axis=1)
            image = np.asarray(evaluator(node).run(None, known | dict(zip(own, rows, strict=True)))[0])
            need(image.ndim == 2 and len(image) == ends[-1] + 1, f"{op} is not of rows")
            widths[out], weight, bias = image.shape[1], image[1:] - image[0], image[0]
            more = 2.0 * np.abs(known[node.input[3]]) @ np.abs(weight) if op == NORM else 0.0  # for the mean
            steps.append((out, own, weight, bias, np.abs(bias) + more))
    return steps


def forms_of(steps: list[Any], u: float, centre: Array, half: Array) -> Any:
    """Return the form of each step in ``centre`` +- ``half`` (n, 6), shapes (n, w), (n, k, w), (n, w)."""
    whole = centre, half[:, :, None] * np.eye(6), u * (u > DOUBLE) * (np.abs(centre) + half)  # as float32
    forms: Any = {name: [x[..., p] for x in whole] for name, p in ((HAND, slice(3)), (TCP, slice(3, 6)))}
    for out, own, *affine in steps:
        z, g, r = (np.concatenate([forms[name][k] for name in own], axis=-1) for k in range(3))
        size = np.abs(z) + (radius := np.abs(g).sum(axis=1) + r)
        need((size < LARGE).all(), "a unit may be out of all bounds")
        if affine:
            weight, bias, most = affine
            r = r @ np.abs(weight) + u * (len(weight) + 17.0) * (size @ np.abs(weight) + most) + 1e-30
            forms[out] = z @ weight + bias, g @ weight, r
        else:
            low, high = np.minimum(z - radius, 0.0), np.maximum(z + radius, 0.0)
            slope = high / np.maximum(high - low, 1e-300)  # 1 or 0 where it is not bent
            add = -slope * low / 2.0
            fresh = (add[:, :, None] * np.eye(add.shape[1]))[:, add.any(axis=0)]
            wide = (0, 0), (0, fresh.shape[1]), (0, 0)
            forms = {name: (z, np.pad(g, wide), r) for name, (z, g, r) in forms.items()}
            r = slope * r + 50.0 * DOUBLE * (slope * size + 2.0 * add)
            forms[out] = slope * z + add, np.concatenate([g * slope[:, None], fresh], axis=1), r
    return forms


def lengths(c: Array, g: Array, r: Array) -> tuple[Array, Array]:
    """Return lower and upper bounds of |c + d|, shape (n,); d is the sum of symbols and slack."""
    norm, wide = np.linalg.norm(c, axis=1), np.linalg.norm(np.abs(g).sum(axis=1) + r, axis=1)
    dot = np.abs(np.einsum("nki,ni->nk", g, c)).sum(axis=1) + (r * np.abs(c)).sum(axis=1)
    return norm - dot / np.maximum(norm, 1e-30), np.sqrt(norm**2 + 2.0 * dot + wide**2)


def off_optimum(centre: Array, half: Array, q: Array, g: Array, r: Array) -> tuple[Array, Array]:
    """Return bounds of |p - o| in ``centre`` +- ``half``; the form of p - t is (``q``, ``g``, ``r``)."""
    gap, cos, rho = DESIRED - centre[:, 3:], np.cos(CONE), np.linalg.norm(half[:, 3:], axis=1)
    least, most = np.full(len(q), np.inf), np.zeros(len(q))
    rim = -1.0, EYE - np.outer(AXIS, AXIS), RADIUS * np.sin(CONE), RADIUS * cos
    for sign, flat, scale, offset in ((1.0, EYE, RADIUS, 0.0), rim):
        norm = np.linalg.norm(gap @ flat, axis=1)
        part = np.where(norm - rho > 1e-6, rho / norm, np.nan)  # NaN: no direction, and nothing is confirmed
        to = gap @ flat / norm[:, None]
        slope = (flat - to[:, :, None] * to[:, None, :]) * (scale / norm)[:, None, None]
        own = np.concatenate(
            [PULL * half[:, :3, None] * EYE, half[:, 3:, None] * (slope - PULL * EYE)], axis=1
        )
        own = np.concatenate([g[:, :6] + own, g[:, 6:]], axis=1)
        low, high = lengths(q - scale * to - offset * AXIS - PULL * (centre[:, 3:] - centre[:, :3]), own, r)
        rest = scale * 2.0 / np.sqrt(3.0) * (-np.log1p(-part) - part)
        applies = sign * (gap @ AXIS - cos * np.linalg.norm(gap, axis=1)) + (1.0 + cos) * rho >= -MARGIN
        least = np.where(applies, np.minimum(least, low - rest), least)
        most = np.where(applies, np.maximum(most, high + rest), most)
    return least, most


def products(q: Array, w: Array, half: Array, g: Array, r: Array) -> tuple[Array, Array]:
    """Return bounds of (p - t) . (t - h); ``q``, ``g``, ``r`` bound p - t, ``w`` and ``half`` bound t - h."""
    h = np.concatenate([-half[:, :3, None] * EYE, half[:, 3:, None] * EYE], axis=1)
    linear, both = np.einsum("nki,ni->nk", g, w), np.einsum("nki,nmi->nkm", g[:, :6], h)
    linear[:, :6] += np.einsum("nki,ni->nk", h, q)
    square = np.einsum("nkk->nk", both) / 2.0  # times e^2, which is in [0, 1]: as much on either side
    deviation = np.abs(both + both.transpose(0, 2, 1)).sum(axis=(1, 2)) / 2.0 - np.abs(square).sum(axis=1)
    rest = (np.abs(g[:, 6:]).sum(axis=1) + r) * np.abs(h).sum(axis=1) + r * np.abs(w)
    deviation += np.abs(linear).sum(axis=1) + rest.sum(axis=1)
    middle = (q * w).sum(axis=1) + square.sum(axis=1)
    return middle - deviation, middle + deviation


def confirmed(claim: Any, low: Array, high: Array, code: int, steps: Any, u: float, doubt: float) -> Any:
    """Return whether bounds confirm ``code`` in each of n boxes with the corners ``low``, ``high`` (n, 6)."""
    kind, limit, (least_m, far) = claim["kind"], claim["limit_m"], claim["region"]["apart_m"]
    half = np.maximum(high - (centre := (low + high) / 2.0), centre - low) * (1.0 + 1e-12)
    gap, wide = centre[:, 3:] - centre[:, :3], half[:, 3:] + half[:, :3]
    nearest, farthest = np.linalg.norm([np.maximum(np.abs(gap) - wide, 0.0), np.abs(gap) + wide], axis=2)
    if code == OUTSIDE:
        return (farthest < least_m - MARGIN) | (nearest > far + MARGIN)
    forms = forms_of(steps, u, centre, half)
    z, g, r = forms[ANSWER]
    need((np.abs(z) + np.abs(g).sum(axis=1) + r < FARTHEST).all(), "an answer may be out of all bounds")
    g[:, 3:6] -= half[:, 3:, None] * EYE  # of the step p - t
    step = z - centre[:, 3:]
    least, most = products(step, gap, half, g, r) if kind == "away" else lengths(step, g, r)
    if kind in ("optimum", "unsure"):
        least, most = off_optimum(centre, half, step, g, r)
    kept, broken = (limit - most, least - limit) if kind in BELOW else (least - limit, limit - most)
    if kind == "unsure":  # a spread above the threshold will do as well
        deviation = np.abs((z := forms["off"])[1]).sum(axis=1) + z[2]
        square = np.stack([np.maximum(np.abs(z[0]) - deviation, 0.0), np.abs(z[0]) + deviation]) ** 2
        least, most = np.sqrt(square.reshape(2, len(z[0]), -1, 3).mean(axis=2)).max(axis=2)
        kept, broken = np.maximum(kept, least - doubt), np.minimum(broken, doubt - most)
    return kept >= MARGIN if code == PROVEN else (broken >= MARGIN) & (nearest >= least_m) & (farthest <= far)


@np.errstate(all="ignore")
def check_claim(network: Any, claim: dict[str, Any]) -> str:
    """Check the tree of a claim, and return the confirmed result; raise ValueError if the tree is wrong."""
    kind, region, limit = claim["kind"], claim["region"], claim["limit_m"]
    corners = np.array([[[*region[f"hand_{c}_m"], *region[f"tcp_{c}_m"]]] for c in ("low", "high")])
    (low, high), shares, part = corners, dict.fromkeys(NAMES.values(), 0.0), 1.0
    need(corners.shape == (2, 1, 6) and (np.abs(corners) <= FARTHEST).all() and (low <= high).all(), "no box")
    need(kind in (*BELOW, *ABOVE) and 0.0 <= limit <= FARTHEST * (kind != "away"), "no limit")
    codes = np.frombuffer(zlib.decompressobj().decompress(base64.b64decode(claim["tree"]), MOST), np.uint8)
    at_once = 1 + LARGEST // sum(len(step[2]) for step in network[0] if step[2:]) ** 2
    while len(low):
        here, codes = codes[: len(low)], codes[len(low) :]
        need(len(here) == len(low) and here.max() <= OUTSIDE, "no whole tree")
        for code, name in NAMES.items():
            rows = np.flatnonzero(here == code)
            shares[name] += len(rows) * part
            for k in range(0, len(rows) if code != UNDECIDED else 0, at_once):
                boxes = low[rows[k : k + at_once]], high[rows[k : k + at_once]]
                need(confirmed(claim, *boxes, code, *network).all(), f"a box is not {name}")
        axis = np.eye(6, dtype=bool)[here[here < PROVEN]]
        low, high, part = low[here < PROVEN], high[here < PROVEN], part / 2.0
        sides = (low, np.where(axis, m := (low + high) / 2.0, low)), (np.where(axis, m, high), high)
        low, high = (np.stack(side, axis=1).reshape(-1, 6) for side in sides)
    need(not len(codes) and shares == claim["shares"], f"codes of no box, or the shares are {shares}")
    root, whole = (corners[0], corners[1]), shares["refuted"] + shares["undecided"] == 0.0 < shares["proven"]
    verdict = "no pair" if confirmed(claim, *root, OUTSIDE, *network).all() else NAMES[8 - 2 * whole]
    if (question := claim["question"]) is not None:
        verdict, point = "refuted", np.array([[*question["hand_in_base_m"], *question["tcp_in_base_m"]]])
        need(((point >= corners[0]) & (point <= corners[1])).all(), "a question out of the region")
        need(confirmed(claim, point, point, REFUTED, *network).all(), "a question that does not refute")
    need(claim["verdict"] == verdict, f"it is {verdict}")
    out = (f"{n} {(np.ceil, np.floor)[n == 'proven'](1e6 * s) / 1e4:.4f}%" for n, s in shares.items())
    at = f"hand and TCP from {corners[0, 0].tolist()} to {corners[1, 0].tolist()}, {region['apart_m']} apart"
    return f"{verdict}: {kind} {limit:g} m; {at} (m): {', '.join(out)}"


def check(certificate: bytes, model: bytes) -> list[str]:
    """Return a line for each claim; raise ValueError or another exception if a claim is not confirmed."""
    need((doc := json.loads(certificate))["format"] == FORMAT and doc["claims"] != [], "no certificate")
    need(doc["model_sha256"] == hashlib.sha256(model).hexdigest(), "it is of another network")
    return [check_claim(network_of(model), claim) for claim in doc["claims"]]


if __name__ == "__main__":
    print(*check(Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]).read_bytes()), sep="\n")  # noqa: T201
