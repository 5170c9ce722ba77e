"""500 URDFs with spoilt elements, numbers or text: each is an arm that can be, or an error with its line."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

import numpy as np
from test_urdf import NASTY

from safety_harness.cell.robot.description import ArmModel, read_arm, resolved_urdf
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.urdf import ArmFileError
from tests.cell.robot.urdfs import SMALL, small_arm_in

ENDS = [("foot", "hand"), ("world", "hand"), (None, "hand"), (None, None), ("hand", "foot"), ("no", "hand")]
TAGS = ["link", "joint", "origin", "axis", "limit", "parent", "child", "mesh", "box", "transmission", "mimic"]
KEYS = [
    "name",
    "type",
    "link",
    "xyz",
    "rpy",
    "lower",
    "upper",
    "velocity",
    "effort",
    "filename",
    "scale",
    "mass",
]
ENCODINGS = ["utf-16", "latin-1", "klingon", "euc-jp", "hex", "idna", "undefined", "ascii"]

Lot = np.random.Generator
T = TypeVar("T")


def one_of(lot: Lot, of: list[T]) -> T:
    return of[int(lot.integers(len(of)))]


def inner(root: Element) -> list[tuple[Element, Element]]:
    """Every element with that which it is in."""
    return [(outer, element) for outer in root.iter() for element in outer]


def joints(root: Element) -> list[Element]:
    return root.findall("joint")


def attribute(lot: Lot, root: Element) -> tuple[Element, str]:
    """Any attribute but those of the root."""
    return one_of(lot, [(element, key) for _, element in inner(root) for key in element.keys()])  # noqa: SIM118


def delete(lot: Lot, root: Element) -> None:
    outer, element = one_of(lot, inner(root))
    outer.remove(element)


def duplicate(lot: Lot, root: Element) -> None:
    outer, element = one_of(lot, inner(root))
    outer.insert(int(lot.integers(len(outer) + 1)), element)


def rename(lot: Lot, root: Element) -> None:
    one_of(lot, list(root.iter())).tag = one_of(lot, TAGS)


def move(lot: Lot, root: Element) -> None:
    outer, element = one_of(lot, inner(root))
    outer.remove(element)
    one_of(lot, list(root.iter())).append(element)


def forget(lot: Lot, root: Element) -> None:
    element, key = attribute(lot, root)
    del element.attrib[key]


def change(lot: Lot, root: Element) -> None:
    element, key = attribute(lot, root)
    element.set(
        key, one_of(lot, [*NASTY, *KEYS, "Infinity", "-NaN", "1e9", "1e-320", "١", "0x1p3", "1e10 0 0"])
    )


def exchange(lot: Lot, root: Element) -> None:
    (one, first), (other, second) = attribute(lot, root), attribute(lot, root)
    text = one.attrib[first]
    one.set(first, other.attrib[second])
    other.set(second, text)


def garble_a_number(lot: Lot, root: Element) -> None:
    element, key = one_of(
        lot, [(e, k) for _, e in inner(root) for k, v in e.items() if any(c.isdigit() for c in v)]
    )
    text, at = element.attrib[key], int(lot.integers(len(element.attrib[key])))
    element.set(
        key, text[:at] + one_of(lot, list("0123456789.-+e, xnif")) + text[at + int(lot.integers(2)) :]
    )


def overflow(lot: Lot, root: Element) -> None:
    """All numbers of an attribute times 10 to the 5, 12 or 400."""
    element, key = one_of(
        lot,
        [(e, k) for _, e in inner(root) for k in e.keys() if k not in ("name", "link", "type", "filename")],  # noqa: SIM118
    )
    power = one_of(lot, ["e5", "e12", "e400"])
    element.set(key, " ".join(number + power for number in element.attrib[key].split()))


def mimic(lot: Lot, root: Element) -> None:
    leader = one_of(lot, joints(root)).get("name", "")
    one_of(lot, joints(root)).append(Element("mimic", {"joint": leader, "multiplier": "-1"}))


def close_a_loop(lot: Lot, root: Element) -> None:
    one, other = one_of(lot, joints(root)), one_of(lot, joints(root))
    end = one_of(lot, ["parent", "child"])
    for upper, lower in zip(one.iter(end), other.iter("child"), strict=True):
        upper.set("link", lower.get("link", ""))


def change_the_type(lot: Lot, root: Element) -> None:
    kinds = [
        "revolute",
        "continuous",
        "fixed",
        "prismatic",
        "planar",
        "floating",
        "",
        "Revolute",
        "spherical",
    ]
    one_of(lot, joints(root)).set("type", one_of(lot, kinds))


def truncate(lot: Lot, text: bytes) -> bytes:
    return text[: int(lot.integers(len(text)))]


def spoil_bytes(lot: Lot, text: bytes) -> bytes:
    at = int(lot.integers(len(text)))
    return text[:at] + lot.bytes(int(lot.integers(1, 4))) + text[at + int(lot.integers(3)) :]


def drop_a_line(lot: Lot, text: bytes) -> bytes:
    lines = text.splitlines(keepends=True)
    del lines[int(lot.integers(len(lines)))]
    return b"".join(lines)


def say_another_encoding(lot: Lot, text: bytes) -> bytes:
    head = f'<?xml version="1.0" encoding="{one_of(lot, ENCODINGS)}"?>'
    body = text.decode().partition("?>")[2]
    return head.encode() + body.encode(one_of(lot, ["utf-8", "utf-16", "latin-1"]))


def put_in(lot: Lot, text: bytes) -> bytes:
    """A processing instruction, a comment, CDATA, an entity or a DOCTYPE at the end of a line."""
    lines, words = (
        text.splitlines(),
        ["<?a b?>", "<!-- -->", "<![CDATA[<link/>]]>", "&a;", "&#0;", "<!DOCTYPE a>"],
    )
    lines.insert(int(lot.integers(len(lines))), one_of(lot, words).encode())
    return b"\n".join(lines)


def bury(lot: Lot, text: bytes) -> bytes:
    """An element in itself, up to 5,000 deep."""
    lines, tag, depth = text.splitlines(), one_of(lot, TAGS), int(lot.integers(1, 5_000))
    lines.insert(int(lot.integers(2, len(lines))), (f"<{tag}>" * depth + f"</{tag}>" * depth).encode())
    return b"\n".join(lines)


OF_ELEMENTS = [
    delete, duplicate, rename, move, forget, change, exchange, garble_a_number, overflow, mimic, close_a_loop,
    change_the_type,
]  # fmt: skip
OF_TEXT = [truncate, spoil_bytes, drop_a_line, say_another_encoding, put_in, bury]
EACH, OF_TWO = 25, 50  # of every kind; with two kinds


def mutations() -> list[tuple[str, bytes]]:
    """500 spoilt texts of the small arm, each with the name of what was done to it."""
    lot, made = np.random.default_rng(7), []
    for kind in OF_TEXT:
        made += [(kind.__name__, kind(lot, SMALL.encode())) for _ in range(EACH)]
    for kinds in [[kind] for kind in OF_ELEMENTS for _ in range(EACH)] + [[]] * OF_TWO:
        root = ElementTree.fromstring(SMALL)
        for kind in kinds or [one_of(lot, OF_ELEMENTS), one_of(lot, OF_ELEMENTS)]:
            kind(lot, root)
        made.append((kinds[0].__name__ if kinds else "two", ElementTree.tostring(root)))
    return made


def assert_can_be(arm: ArmModel) -> None:
    """Numbers that are some, and frames that are rigid, whatever its joints."""
    n = len(arm.joint_names)
    assert 3 <= n <= 8
    assert arm.joint_axes.shape == (n, 3)
    for frame in links_in_base(arm, np.linspace(-1.0, 1.0, n)):
        np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.isfinite(frame).all()
    assert (arm.position_lower_rad < arm.position_upper_rad).all()
    assert not (np.minimum(arm.velocity_limit_radps, arm.effort_limit) <= 0.0).any()  # unknown ones are NaN
    assert not np.isinf([arm.velocity_limit_radps, arm.effort_limit]).any()
    for link in arm.links:
        assert all(np.isfinite(shape.transform_shape_to_link).all() for shape in link.collision + link.visual)


def test_500_spoilt_urdfs_are_arms_that_can_be_or_errors_that_say_where(tmp_path: Path) -> None:
    file, lot = small_arm_in(tmp_path), np.random.default_rng(8)
    read, refused, errors = Counter[str](), Counter[str](), list[tuple[ArmFileError, int]]()
    made = mutations()
    assert len(made) == 500
    for kind, text in made:
        file.write_bytes(text)
        base, tcp = ENDS[0] if lot.random() < 0.9 else one_of(lot, ENDS)
        try:
            arm = read_arm(file, base=base, tcp=tcp)
        except ArmFileError as error:
            errors.append((error, text.count(b"\n") + 2))
            refused[kind] += 1
            continue
        assert_can_be(arm)
        read[kind] += 1
    for raised, lines in errors:
        line = raised.place.line
        assert raised.place.file == file
        assert line is not None
        assert 1 <= line <= lines
        assert f"{file}:{line}" in str(raised)
    assert read.total() > 100
    assert refused.total() > 100
    assert all(read[kind.__name__] + refused[kind.__name__] == EACH for kind in (*OF_ELEMENTS, *OF_TEXT))
    assert min(refused[kind.__name__] for kind in (*OF_ELEMENTS, *OF_TEXT)) > 0


def test_what_is_written_of_a_spoilt_urdf_that_can_be_read_is_the_same_arm(tmp_path: Path) -> None:
    """``resolved_urdf``, which PyBullet reads, leaves the chain as it was."""
    file, same = small_arm_in(tmp_path), 0
    for _, text in mutations():
        file.write_bytes(text)
        try:
            arm = read_arm(file, base="foot", tcp="hand")
        except ArmFileError:
            continue
        again = read_arm(file, base="foot", tcp="hand", text=resolved_urdf(arm, visuals=True).encode())
        assert again.chain.tobytes() == arm.chain.tobytes()
        assert again.joint_names == arm.joint_names
        assert again.position_lower_rad.tobytes() == arm.position_lower_rad.tobytes()
        same += 1
    assert same > 100
