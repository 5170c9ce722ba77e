"""Write URDFs without meshes for arms of the package pybullet.  Run: python benchmarks/meshless_urdfs.py.

A URDF in robots/ has the joints, limits, masses and inertias of the package's, and the arm's capsules as its
collision shapes: each is a cylinder with a sphere at both ends.  So the arm loads where pybullet is missing.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from safety_harness.base.exceptions import Place
from safety_harness.scenario.urdf_packages import urdf_of_package

ROBOTS = Path(__file__).parents[1] / "robots"
ARMS = {  # the URDF in the package, and the licence of its text
    "iiwa14": ("pybullet/kuka_iiwa/model", ""),  # the text has its licence
    "panda": ("pybullet/franka_panda/panda", "Apache License 2.0, Franka Emika"),
    "xarm6": ("pybullet/xarm/xarm6_robot", "BSD licence, UFACTORY"),
}
UNUSED = ("gazebo", "transmission", "material")
OTHERS = ("visual", "collision")


def meshless(name: str) -> str:
    """Return the URDF of an arm with capsules in place of its meshes."""
    package, licence = ARMS[name]
    text = urdf_of_package(package, Place()).read_text()
    notes = [f"From {package}.urdf of Bullet; with capsules as shapes, without parts for other programs."]
    notes += [line.strip().removeprefix("<!--").removesuffix("-->").rstrip() for line in _head(text)]
    notes += [f"Licence: {licence}."] if licence else []
    root = ElementTree.fromstring(text)
    for element in [child for child in root if child.tag in UNUSED]:
        root.remove(element)
    capsules = json.loads((ROBOTS / f"{name}.capsules.json").read_text())["capsules"]
    for link in root.iter("link"):
        for shape in [child for child in link if child.tag in OTHERS]:
            link.remove(shape)
        for capsule in capsules:
            if capsule["link"] == link.get("name"):
                _add(link, capsule)
    ElementTree.indent(root)
    comment = "\n     ".join(notes)
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _head(text: str) -> list[str]:
    """Return the comment lines before the robot, which may be a licence."""
    head = text[: text.index("<robot")].splitlines()
    return [line for line in head if line.strip().startswith("<!--") and line.strip("<!-=> |")]


def _add(link: ElementTree.Element, capsule: dict[str, list[float]]) -> None:
    """Add a capsule to a link as a cylinder with a sphere at both ends."""
    start_m, end_m = (np.array(capsule[f"{side}_in_link_m"]) for side in ("start", "end"))
    axis_m, radius = end_m - start_m, f"{capsule['radius_m']:g}"
    length_m = float(np.linalg.norm(axis_m))
    for place_m in (start_m, end_m):
        _shape(link, place_m, np.zeros(3), "sphere", radius=radius)
    if length_m > 0.0:
        turn, _ = Rotation.align_vectors([axis_m / length_m], [[0.0, 0.0, 1.0]])
        rpy_rad = turn.as_euler("xyz")
        _shape(link, (start_m + end_m) / 2.0, rpy_rad, "cylinder", radius=radius, length=f"{length_m:.5f}")


def _shape(
    link: ElementTree.Element,
    place_m: NDArray[np.float64],
    rpy_rad: NDArray[np.float64],
    kind: str,
    **size: str,
) -> None:
    """Add a collision shape to a link, in the link's frame."""
    collision = ElementTree.SubElement(link, "collision")
    xyz, rpy = (" ".join(f"{number + 0.0:.5f}" for number in values) for values in (place_m, rpy_rad))
    ElementTree.SubElement(collision, "origin", xyz=xyz, rpy=rpy)
    ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), kind, size)


if __name__ == "__main__":
    for name in ARMS:
        text, capsules = meshless(name), ROBOTS / f"{name}.capsules.json"
        (ROBOTS / f"{name}.urdf").write_text(text)
        stored = json.loads(capsules.read_text())
        stored["meshless_urdf_sha256"] = sha256(text.encode()).hexdigest()
        capsules.write_text(json.dumps(stored, indent=1) + "\n")
        print(f"robots/{name}.urdf")
