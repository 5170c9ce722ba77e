"""Read a plan of proofs: a network, claims about it, and regions of inputs (docs/how-to/prove.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from safety_harness.base.settings import Vector3
from safety_harness.base.shipped.contents import located
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import PERCEPTRON, SeenSpace, load_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim, read_claim, threshold_m
from safety_harness.extensions.lab.proof.network import ReluNetwork, network_of
from safety_harness.extensions.lab.proof.onnx_file import OnnxFunction, read_onnx
from safety_harness.scenario.compose import Library
from safety_harness.scenario.fields import LARGEST_COORDINATE_M, Field
from safety_harness.scenario.files import as_path
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.references import MODEL_SUFFIX, ONNX_SUFFIX
from safety_harness.scenario.units import FRACTION, LENGTH
from safety_harness.space.regions import exported_use

KEYS = ("proof", "about", "avoider", "regions", "claims", "distribution")
OF_LOOPS = ("space", "scenario", "run", "runs", "trace", "log", "campaign")
LOOP = (
    "questions that a loop makes follow from earlier answers: their distribution is not known, use a campaign"
)
SEEN = "seen"
MOST_CLAIMS, MOST_REGIONS = 64, 64  # a choice
STEPS = 150  # for each axis, which gives the accuracy 1e-3 of ``counted_share``
MOST_SAMPLES = 10_000_000
ANY_APART_M = 0.0, 4.0 * LARGEST_COORDINATE_M  # from 0 to a distance that no pair reaches
LEAST_INSIDE = 1e-3  # the least probability that a normal coordinate lies within a region

AskedNetwork = LearnedAvoider | OnnxFunction
Floats = NDArray[np.float64]
Normal = tuple[float, float]  # mean and standard deviation [m]


@dataclass(frozen=True, kw_only=True)
class ProofRegion:
    """A region of inputs: pairs of a hand and a TCP in two boxes in the base frame [m].

    The region contains only pairs whose distance between hand and TCP lies between the two lengths of
    ``apart_m``.
    """

    name: str
    hand_low_m: Vector3
    hand_high_m: Vector3
    tcp_low_m: Vector3
    tcp_high_m: Vector3
    apart_m: tuple[float, float] = ANY_APART_M

    @classmethod
    def around(cls, tcp_m: Floats, low_m: Floats, high_m: Floats) -> ProofRegion:
        """Return the region with one TCP ``tcp_m`` and the hands from ``low_m`` to ``high_m``, shape (3,)."""
        tcp, low, high = ((float(x[0]), float(x[1]), float(x[2])) for x in (tcp_m, low_m, high_m))
        return cls(name="a box", hand_low_m=low, hand_high_m=high, tcp_low_m=tcp, tcp_high_m=tcp)

    def corners(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lowest and the highest coordinates of hand and TCP, shape (1, 6) each."""
        low, high = (*self.hand_low_m, *self.tcp_low_m), (*self.hand_high_m, *self.tcp_high_m)
        return np.array([low]), np.array([high])

    @property
    def has_pair(self) -> bool:
        """Whether the region contains at least one pair of hand and TCP.

        The distances of the pairs in two boxes range continuously from the smallest to the largest.  These
        two distances therefore determine the result.
        """
        (low,), (high,) = self.corners()
        least, most = low[:3] - high[3:], high[:3] - low[3:]  # of hand minus TCP
        nearest = np.linalg.norm(np.maximum(np.maximum(least, -most), 0.0))
        farthest = np.linalg.norm(np.maximum(np.abs(least), np.abs(most)))
        return bool(nearest <= self.apart_m[1] and farthest >= self.apart_m[0])

    @property
    def counted_share(self) -> float:
        """The fraction of all pairs in the two boxes that belong to the region, with an accuracy of 1e-3.

        The fraction is a sum over ``STEPS``^3 offsets from TCP to hand.
        """
        offsets, chances = [], []
        for low, high, start, to in zip(
            self.hand_low_m, self.hand_high_m, self.tcp_low_m, self.tcp_high_m, strict=True
        ):
            edges = np.linspace(low - to, high - start, STEPS + 1)
            offset = (edges[1:] + edges[:-1]) / 2.0  # from TCP to hand; the boxes' overlap is its chance
            overlap = np.maximum(0.0, np.minimum(high, to + offset) - np.maximum(low, start + offset))
            offsets.append(offset)
            chances.append(overlap / overlap.sum())
        x, y, z = np.meshgrid(*offsets, indexing="ij")
        apart_m = np.sqrt(x**2 + y**2 + z**2)
        counts = (apart_m >= self.apart_m[0]) & (apart_m <= self.apart_m[1])
        return min(1.0, float(np.einsum("xyz,x,y,z->", counts.astype(float), *chances)))


@dataclass(frozen=True)
class PlannedProof:
    """A claim about the answers to all inputs in a region."""

    claim: DecisionClaim
    region: ProofRegion

    @property
    def sentence(self) -> str:
        """The sentence that states the claim, followed by the name of the region."""
        return f"{self.claim.sentence} ({self.region.name})"


@dataclass(frozen=True, kw_only=True)
class QuestionLaw:
    """The distribution of inputs, and the sampling that bounds the probability of wrong answers.

    ``normals_m`` has the mean and the standard deviation of each of the six coordinates of hand and TCP, or
    None for a uniform coordinate.  For each claim, the program draws ``samples`` inputs.  The bounds of all
    claims are true simultaneously with the probability ``confidence``.
    """

    normals_m: tuple[Normal | None, ...]
    samples: int
    confidence: float
    seed: int


@dataclass(frozen=True, eq=False)
class ProofPlan:
    """A plan of proofs about one network.

    ``network`` contains the layers in ``model_file``, and ``asked`` is the function that computes the
    network's answers.
    """

    title: str
    avoider: str
    model_file: Path
    network: ReluNetwork
    asked: AskedNetwork
    proofs: tuple[PlannedProof, ...]
    questions: QuestionLaw | None = None

    @property
    def doubt_m(self) -> float:
        """The largest spread that the gate accepts, or NaN if the network has no threshold."""
        return threshold_m(self.asked.model)


def read_proof_plan(path: str | Path) -> ProofPlan:
    """Read a plan of proofs from a file.

    Args:
        path: The file.

    Raises:
        ScenarioError: The plan cannot be used; the error states the position in the file.
        ModelError: The network cannot be used.

    """
    path = as_path(path, "read_proof_plan(path)")
    refuse_other_kind(path, FileKind.PROOF)
    given = Field(Library().tree(path), path, path="", line=1).fields(KEYS)
    title = given.required("proof").prose("a title on one line")
    if text := given.optional("about"):
        text.prose("why", lines=True)
    avoider = given.required("avoider")
    name = avoider.sentence("a network")
    if name not in SHIPPED and not name.endswith((MODEL_SUFFIX, ONNX_SUFFIX)):
        raise avoider.error(f"a network: a shipped one, FILE{MODEL_SUFFIX} or FILE{ONNX_SUFFIX}")
    file = shipped_model(name) if name in SHIPPED else located(path.parent / Path(name).expanduser())
    network, function, seen = _network(avoider, name, file)
    regions = {} if seen is None else {SEEN: seen_region(seen)}
    if at := given.optional("regions"):
        for key, item in at.entries("regions by name")[:MOST_REGIONS]:
            if key in regions:
                raise item.error(f"a name other than {', '.join(regions)}", got=key)
            regions[key] = _region(key, item, regions.get(SEEN))
    proofs: list[PlannedProof] = []
    for item in given.required("claims").items("a list of claims", least=1, most=MOST_CLAIMS):
        fields = item.fields(("claim", "in"))
        where = fields.optional("in")
        if where is None and SEEN not in regions:
            raise item.error("a region, since the network's file does not state its seen space")
        region = where.one_of(regions) if where else regions[SEEN]
        proof = PlannedProof(read_claim(fields.required("claim")), region)
        if proof.claim.kind is ClaimKind.UNSURE and not threshold_m(function.model) >= 0.0:
            raise item.error("a network with a spread and its threshold for such a claim", got=name)
        if proof in proofs:
            raise item.error("each claim once in a region", got=proof.sentence)
        proofs.append(proof)
    if idle := regions.keys() - {SEEN, *(proof.region.name for proof in proofs)}:
        raise given.required("regions").error("a claim in each region", got=f"none in {sorted(idle)[0]}")
    at = given.optional("distribution")
    questions = None if at is None else _questions(at, [proof.region for proof in proofs])
    return ProofPlan(title, name, file, network, function, tuple(proofs), questions)


def _network(
    at: Field, name: str, file: Path
) -> tuple[ReluNetwork, LearnedAvoider | OnnxFunction, SeenSpace | None]:
    """Return the layers and the function of a network's file, and the network's seen space.

    The seen space is None if the file does not state it.
    """
    if file.suffix == ONNX_SUFFIX:
        use = exported_use(file)
        return *read_onnx(file), None if use is None else use.seen
    model = load_model(file)
    if model.kind != PERCEPTRON:
        raise at.error(f"a {PERCEPTRON}", got=f"{name}: a {model.kind}, {model.members} member(s)")
    return network_of(model), LearnedAvoider.from_model(model), model.seen


def seen_region(seen: SeenSpace) -> ProofRegion:
    """Return the region of the hands and TCPs in a network's training data, according to its file."""
    return ProofRegion(
        name=SEEN,
        hand_low_m=seen.hand_low_m,
        hand_high_m=seen.hand_high_m,
        tcp_low_m=seen.tcp_low_m,
        tcp_high_m=seen.tcp_high_m,
    )


def _region(name: str, at: Field, seen: ProofRegion | None) -> ProofRegion:
    """Return the region that a plan describes.

    If the plan omits a box, the function uses the corresponding box of ``seen``.
    """
    given = at.fields(("hand", "tcp", "apart"))
    hand, tcp, distances = (given.optional(key) for key in ("hand", "tcp", "apart"))
    hands, tcps = _box(hand) if hand else None, _box(tcp) if tcp else None
    if seen is not None:
        hands = hands or (seen.hand_low_m, seen.hand_high_m)
        tcps = tcps or (seen.tcp_low_m, seen.tcp_high_m)
    if hands is None or tcps is None:
        raise at.error("boxes of hands and of TCPs, since the network's file does not state its seen space")
    apart_m = ANY_APART_M
    if distances:
        nearest_m, far = distances.items("two lengths such as [100 mm, 400 mm]", count=2)
        near_m = nearest_m.quantity(LENGTH, least=0.0)
        apart_m = near_m, far.quantity(LENGTH, above=near_m, most=ANY_APART_M[1])
    return ProofRegion(
        name=name,
        hand_low_m=hands[0],
        hand_high_m=hands[1],
        tcp_low_m=tcps[0],
        tcp_high_m=tcps[1],
        apart_m=apart_m,
    )


def _questions(at: Field, regions: list[ProofRegion]) -> QuestionLaw:
    """Return the distribution of inputs in a plan.

    Raise ScenarioError if a closed control loop produces the inputs, or if hardly any inputs lie in a region.
    """
    given = at.fields(("hand", "tcp", "samples", "confidence", "seed"), hints=dict.fromkeys(OF_LOOPS, LOOP))
    normals: list[Normal | None] = []
    for key in ("hand", "tcp"):
        law = given.optional(key)
        normals += [None] * 3 if law is None or law.got() == "uniform" else _normals(law)
    for region in regions:
        for axis, (low, high) in enumerate(zip(*(side[0] for side in region.corners()), strict=True)):
            normal = normals[axis]
            if normal is None:
                continue
            start, end = ((side - normal[0]) / normal[1] for side in (low, high))
            if not scipy.special.ndtr(end) - scipy.special.ndtr(start) >= LEAST_INSIDE:
                expected = f"at least {LEAST_INSIDE:g} of each axis within the region {region.name}"
                raise at.error(expected, got=f"mean {normal[0]:g} m, std {normal[1]:g} m, axis {axis % 3}")
    samples, confidence, seed = (given.optional(key) for key in ("samples", "confidence", "seed"))
    return QuestionLaw(
        normals_m=tuple(normals),
        samples=20_000 if samples is None else samples.integer(least=1, most=MOST_SAMPLES),
        confidence=0.99 if confidence is None else confidence.quantity(FRACTION, least=0.5, most=0.999999),
        seed=0 if seed is None else seed.integer(least=0, most=2**63 - 1),
    )


def _normals(at: Field) -> list[Normal | None]:
    """Return the mean and the standard deviation of the coordinate on each of three axes."""
    given = at.fields(("mean", "std"))
    mean = _corner(given.required("mean"))
    stds = given.required("std").items("three lengths", count=3)
    return [(m, std.quantity(LENGTH, above=0.0)) for m, std in zip(mean, stds, strict=True)]


def _box(at: Field) -> tuple[Vector3, Vector3]:
    """Return the lowest and the highest corner of a box."""
    given = at.fields(("from", "to"))
    low, high = (_corner(given.required(key)) for key in ("from", "to"))
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise at.error("a box: from below to in every axis", got=f"from {list(low)} to {list(high)} (m)")
    return low, high


def _corner(at: Field) -> Vector3:
    """Return a position."""
    x, y, z = (
        length.quantity(LENGTH, least=-LARGEST_COORDINATE_M, most=LARGEST_COORDINATE_M)
        for length in at.items("a position: three lengths", count=3)
    )
    return x, y, z
