"""Read a URDF as a tree with line numbers.

The tree gives access to links, joints, numbers and files, and its errors state the line.
"""

from __future__ import annotations

import difflib
import os.path
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import ArmModelError, InputError, Place
from safety_harness.base.geometry.rotations import rotation_about
from safety_harness.base.geometry.transforms import transform_from

# A choice: far more than a URDF or mesh needs, and a guard against reading a huge file into memory.
MAX_BYTES = 200_000_000
DEEPEST = 100  # nested elements, since Python's writer of XML is recursive
LARGEST = 1e9  # of any number in SI units: products of these stay finite
_COUNTED = {1: "a number", 3: "three numbers"}


class ArmFileError(InputError, ArmModelError):
    """The error that a file of an arm is unusable.

    The file is a URDF, a mesh or a file of capsules. The error states file, line and field.
    """


def expand_by_xacro(file: Path) -> str:
    """Return a hint with the command that expands the xacro ``file`` to a URDF."""
    name = file.name.removesuffix(".xacro").removesuffix(".urdf")
    return f"xacro expands it: xacro {file.name} > {name}-expanded.urdf"


def read_bytes(file: Path) -> bytes:
    """Return the bytes of a file.

    Raise ``ArmFileError`` if the file is unreadable or larger than MAX_BYTES.
    """
    try:
        if not os.path.isfile(file):
            raise ArmFileError.of_file(file, "a file", "no such file")
        if file.stat().st_size > MAX_BYTES:
            raise ArmFileError.of_file(file, f"at most {MAX_BYTES:,} bytes", f"{file.stat().st_size:,}")
        return file.read_bytes()
    except OSError as error:
        raise ArmFileError.of_file(file, "a file that can be read", str(error)) from error


@dataclass(frozen=True, eq=False)
class Urdf:
    """A URDF whose joints form one or more trees.

    ``above`` maps the name of a link to the joint above it.
    """

    file: Path
    root: Element
    lines: dict[Element, int]
    links: dict[str, Element]
    above: dict[str, Element]

    @classmethod
    def read(cls, file: Path, text: bytes | None = None) -> Urdf:
        """Read a URDF from ``text``, or from ``file`` if ``text`` is None.

        Raise ``ArmFileError`` unless it is XML with a tree of links.
        """
        root, lines = _parse(file, read_bytes(file) if text is None else text)
        urdf = cls(file, root, lines, {}, {})
        if root.tag != "robot":
            raise urdf.error(root, "a <robot>", f"<{root.tag}>")
        for link in root.findall("link"):
            if urdf.links.setdefault(urdf.text(link, "name"), link) is not link:
                raise urdf.error(link, "one link of a name", "a second one")
        joints: dict[str, Element] = {}
        for joint in root.findall("joint"):
            if joints.setdefault(urdf.text(joint, "name"), joint) is not joint:
                raise urdf.error(joint, "one joint of a name", "a second one")
            urdf.parent(joint)
            child = urdf._end(joint, "child")
            if urdf.above.setdefault(child, joint) is not joint:
                first = urdf.above[child].get("name")
                raise urdf.error(joint, f"one joint above the link {child!r}", f"a second, after {first!r}")
        urdf._refuse_loops()
        return urdf

    def _refuse_loops(self) -> None:
        """Raise ``ArmFileError`` if the joints form a closed loop."""
        settled: set[str] = set()
        for link in self.above:
            visited: set[str] = set()
            while link in self.above and link not in settled:
                if link in visited:
                    raise self.error(self.above[link], "joints that form a tree", "a closed loop")
                visited.add(link)
                link = self.parent(self.above[link])
            settled |= visited

    def error(self, element: Element, expected: str, got: str, hint: str = "") -> ArmFileError:
        """Return an error about an element.

        The error states the line of the element.

        Args:
            element: The element.
            expected: The expected content, in words.
            got: The actual content of the file, in words.
            hint: Advice for the user, or an empty text.

        """
        name = element.get("name")
        field = f"<{element.tag}>" if name is None else f"{element.tag} {name!r}"
        place = Place(self.file, self.lines.get(element), field)
        return ArmFileError(place=place, expected=expected, got=got, hint=hint)

    def child(self, element: Element, tag: str) -> Element:
        """Return the only child of an element with the tag ``tag``.

        Raise ``ArmFileError`` unless there is exactly one such child.
        """
        children = element.findall(tag)
        if len(children) != 1:
            raise self.error(element, f"one <{tag}> in it", f"{len(children)}")
        return children[0]

    def text(self, element: Element, key: str) -> str:
        """Return the attribute ``key`` of an element.

        Raise ``ArmFileError`` if the attribute is absent or empty.
        """
        text = element.get(key, "")
        if not text.strip():
            raise self.error(element, f"an attribute {key!r}", "none")
        return text

    def numbers(
        self, element: Element, key: str, count: int, default: str | None = None, largest: float = LARGEST
    ) -> NDArray[np.float64]:
        """Return the numbers in an attribute, shape (count,).

        Raise ``ArmFileError`` if the attribute does not contain ``count`` numbers.

        Args:
            element: The element.
            key: The attribute's name.
            count: The expected number of numbers, 1 or 3.
            default: The text that replaces an absent attribute. None means that the attribute must be
                present.
            largest: The largest allowed absolute value of a number.

        """
        text = element.get(key, default)
        try:
            numbers = [float(number_text) for number_text in (text or "").split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(abs(number) <= largest for number in numbers) or "_" in str(text):
            hint = expand_by_xacro(self.file) if "$" in (text or "") else ""
            got = "none" if text is None else repr(text)
            raise self.error(element, f"{_COUNTED[count]} for {key!r}", got, hint)
        return np.array(numbers)

    def number(self, element: Element, key: str, default: str | None = None) -> float:
        """Return the finite number in an attribute.

        The function has the same arguments as ``numbers``.
        """
        return float(self.numbers(element, key, 1, default)[0])

    def origin(self, element: Element) -> NDArray[np.float64]:
        """Return the transform (4, 4) of an element's <origin>.

        The rotation is R = Rz Ry Rx, with roll, pitch and yaw about fixed axes. Return the identity if the
        element has no <origin>.
        """
        if element.find("origin") is None:
            return np.eye(4)
        origin = self.child(element, "origin")
        rotation = np.eye(3)
        turn = np.empty((3, 3))
        for axis, angle in zip(np.eye(3), self.numbers(origin, "rpy", 3, "0 0 0"), strict=True):
            rotation_about(axis, angle, turn)
            rotation = product(turn, rotation)
        return transform_from(rotation, self.numbers(origin, "xyz", 3, "0 0 0"))

    def parent(self, joint: Element) -> str:
        """Return the link above a joint."""
        return self._end(joint, "parent")

    def _end(self, joint: Element, tag: str) -> str:
        """Return the link of a joint's <parent> or <child>."""
        end = self.child(joint, tag)
        return self.known(self.text(end, "link"), end)

    def known(self, link: str, element: Element) -> str:
        """Return ``link`` if the file contains it.

        Otherwise raise ``ArmFileError`` with the most similar names. The error states the line of
        ``element``.
        """
        if link not in self.links:
            similar = difflib.get_close_matches(link, self.links, n=3, cutoff=0.4) or list(self.links)[:20]
            raise self.error(element, "a link of the file", repr(link), f"there is {', '.join(similar)}")
        return link

    def only(self, role: str, links: Iterable[str]) -> str:
        """Return the only member of ``links``.

        Raise ``ArmFileError`` unless there is exactly one member. ``role`` is the role of the link, for the
        text of the error.
        """
        candidates = list(links)
        if len(candidates) != 1:
            raise self.error(
                self.root,
                f"the name of the {role}, or one link that can be it",
                ", ".join(candidates[:20]) or "none",
            )
        return candidates[0]

    def chain(self, base: str | None, tcp: str | None) -> tuple[str, str, list[Element]]:
        """Return the base, the tcp and the joints from base to tcp.

        If an argument is None, the file must have only one root or leaf, which the method then uses.
        """
        if base is None:
            base = self.only("base", (link for link in self.links if link not in self.above))
        if tcp is None:
            inner = {self.parent(joint) for joint in self.above.values()}
            tcp = self.only("tcp", (link for link in self.links if link not in inner))
        link, joints = self.known(tcp, self.root), list[Element]()
        self.known(base, self.root)
        while link != base:
            if link not in self.above:
                raise self.error(self.links[tcp], f"joints that lead up to {base!r}", f"they end at {link!r}")
            joints.append(self.above[link])
            link = self.parent(joints[-1])
        return base, tcp, joints[::-1]

    def carrier(self, link: str, among: Collection[str]) -> tuple[str | None, list[NDArray[np.float64]]]:
        """Return the link in ``among`` to which ``link`` is fixed, and the frames (4, 4) between the two.

        If ``link`` itself is in ``among``, the method returns ``link``. The frames belong to the fixed joints
        between the two links. Return (None, []) if there is no such link.
        """
        frames: list[NDArray[np.float64]] = []
        while link not in among:
            joint = self.above.get(link)
            if joint is None or joint.get("type") != "fixed":
                return None, []
            link, frames = self.parent(joint), [self.origin(joint), *frames]
        return link, frames

    def mesh_file(self, mesh: Element, packages: Mapping[str, Path]) -> Path:
        """Return the file of a <mesh>.

        The name of the file is a path relative to the URDF, or begins with file:// or package://
        (``read_arm``).
        """
        uri = self.text(mesh, "filename")
        scheme, _, rest = uri.rpartition("://")
        name, _, inner = rest.partition("/")
        given = [
            folder / rest.removeprefix(package + "/")
            for package, folder in packages.items()
            if rest.startswith(package + "/")
        ]
        above = self.file.resolve().parents
        places = {
            "": [self.file.parent / uri],
            "file": [Path(unquote(rest))],
            "package": given or [*(folder / name / inner for folder in above), *(f / inner for f in above)],
        }
        if scheme not in places:
            raise self.error(mesh, "a path, file:// or package://", repr(uri))
        for place in places[scheme]:
            if os.path.isfile(place):
                return place
        hint = "--package NAME=FOLDER says where it is" if scheme == "package" else ""
        raise self.error(mesh, "the name of a mesh file", f"{uri!r}, which does not exist", hint)


def _parse(file: Path, text: bytes) -> tuple[Element, dict[Element, int]]:
    """Return the root element of ``text``, and the line at which each element begins.

    Raise ``ArmFileError`` if the text is not XML, or if it has a DOCTYPE or elements of xacro.
    """
    builder, lines = ElementTree.TreeBuilder(), dict[Element, int]()
    parser, open_tags = expat.ParserCreate(), list[str]()

    def refused(expected: str, got: str, hint: str = "") -> ArmFileError:
        place = Place(file, parser.CurrentLineNumber)
        return ArmFileError(place=place, expected=expected, got=got, hint=hint)

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag.startswith("xacro:"):
            raise refused("a URDF that xacro has expanded", f"<{tag}>", expand_by_xacro(file))
        open_tags.append(tag)
        if len(open_tags) > DEEPEST:
            raise refused(f"at most {DEEPEST} nested elements", f"<{tag}> in {DEEPEST}")
        own = {key: value for key, value in attributes.items() if not key.startswith("xmlns")}
        lines[builder.start(tag, own)] = parser.CurrentLineNumber

    def end(tag: str) -> None:
        open_tags.pop()
        builder.end(tag)

    def refuse(*_: object) -> None:  # refuses entities, whose size has no limit
        raise refused("a URDF, which has no DOCTYPE", "one")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise refused("a URDF, which is XML", str(error)) from error
    return builder.close(), lines
