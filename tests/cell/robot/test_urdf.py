"""What a URDF says, and what is refused of it, each with file and line."""

from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import ArmModelError, InputError
from safety_harness.cell.robot.description import ArmModel, read_arm
from safety_harness.cell.robot.urdf import ArmFileError
from tests.cell.robot.urdfs import OTHERS, SMALL, WEDGE, small_arm_in

MUTATIONS = 500
NASTY = ["nan", "inf", "-inf", "1e400", "", "0", "-1", "1_0", "abc", "0 0 0", "1 2", "world", "hand", "fixed"]
NASTY += [
    "prismatic",
    "floating",
    "package://a/b",
    "http://a/b",
    "file:///",
    "\ufffd",
    "9" * 400,
    "1e308 1e308 1e308",
]


def line_of(words: str, text: str) -> int:
    (line,) = [number for number, row in enumerate(text.splitlines(), 1) if words in row]
    return line


@pytest.fixture
def small(tmp_path: Path) -> ArmModel:
    return read_arm(small_arm_in(tmp_path), tcp="hand")


def test_fixed_joints_are_merged_and_a_joint_without_an_end_has_infinite_limits(small: ArmModel) -> None:
    assert small.joint_names == ("first", "second", "third")
    assert small.link_names == ("world", "upper", "lower", "hand")
    assert small.position_lower_rad.tolist() == [-np.inf, -1.5, -3.0]
    assert small.position_upper_rad.tolist() == [np.inf, 2.0, 3.0]
    assert small.velocity_limit_radps.tolist() == [2.0, 1.0, 3.0]
    assert small.effort_limit.tolist() == [50.0, 20.0, 5.0]
    assert small.joint_axes.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0]]
    np.testing.assert_allclose(small.joint_origins[0, :3, 3], [0.0, 0.0, 1.3])
    np.testing.assert_allclose(small.joint_origins[1, :3, 3], [0.1, 0.1, 0.3])
    assert small.flange.tolist() == np.eye(4).tolist()
    assert small.joint_origins.shape == (3, 4, 4)


def test_shapes_of_links_that_are_fixed_belong_to_the_link_that_carries_them(small: ArmModel) -> None:
    foot, upper, lower, hand = small.links
    assert [(one.kind, one.size.tolist()) for one in foot.collision] == [("box", [0.2, 0.3, 0.2])]
    np.testing.assert_allclose(foot.collision[0].transform_shape_to_link[:3, 3], [0.0, 0.0, 1.1])
    assert [one.kind for one in upper.collision] == ["cylinder"]
    assert [one.kind for one in upper.visual] == ["mesh", "sphere"]
    assert upper.visual[0].size.tolist() == [0.2, -0.1, 0.1]
    np.testing.assert_allclose(upper.visual[1].transform_shape_to_link[:3, 3], [0.0, 0.1, 0.3])
    assert upper.visual[0].file is not None
    assert upper.visual[0].file.samefile(small.file.parent / "small" / "wedge.stl")
    assert lower.visual[0].file is not None
    assert lower.visual[0].file.samefile(upper.visual[0].file)
    assert not hand.collision + hand.visual
    assert small.left_out == ("finger",)


def test_the_reach_is_never_less_than_the_way_to_the_tcp(small: ArmModel) -> None:
    assert small.farthest_reach_m == pytest.approx(0.3)


def test_a_package_is_found_where_it_is_said_to_be_and_nowhere_else(tmp_path: Path) -> None:
    file = small_arm_in(tmp_path)
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "wedge.stl").write_text(WEDGE)
    arm = read_arm(file, tcp="hand", packages={"small": tmp_path / "deep"})
    assert arm.links[1].visual[0].file == tmp_path / "deep" / "wedge.stl"
    with pytest.raises(ArmFileError, match=r"wedge\.stl.*which does not exist"):
        read_arm(file, tcp="hand", packages={"small": tmp_path / "nowhere"})


def test_a_mesh_by_file_and_a_package_in_a_folder_above(tmp_path: Path) -> None:
    small_arm_in(tmp_path)
    (tmp_path / "urdf").mkdir()
    by_file = SMALL.replace('"small/wedge.stl"', f'"file://{tmp_path}/small/wedge.stl"')
    (tmp_path / "urdf" / "a.urdf").write_text(by_file)
    arm = read_arm(tmp_path / "urdf" / "a.urdf", tcp="hand")
    for shape in (arm.links[1].visual[0], arm.links[2].visual[0]):
        assert shape.file is not None
        assert shape.file.samefile(tmp_path / "small" / "wedge.stl")


AXIS, LIMIT = '<axis xyz="0 1 0"/>', '<limit lower="-1.5" upper="2" velocity="1" effort="20"/>'
MESH = 'filename="package://small/wedge.stl"'
LOOP = '<joint name="back" type="fixed"><parent link="hand"/><child link="world"/></joint>'
TWICE = '<joint name="twice" type="fixed"><parent link="foot"/><child link="lower"/></joint>'


@pytest.mark.parametrize(
    ("old", "new", "at", "complaint"),
    [
        (AXIS, f'{AXIS}<mimic joint="first"/>', AXIS, "mimics another"),
        ('name="second" type="revolute"', 'name="second" type="prismatic"', 'name="second"', "'prismatic'"),
        ('name="second" type="revolute"', 'name="second" type="floating"', 'name="second"', "'floating'"),
        ('name="second" type="revolute"', 'name="second" type="planar"', 'name="second"', "'planar'"),
        ('name="second" type="revolute"', 'name="second"', 'name="second"', "None"),
        ("</robot>", f"{LOOP}\n</robot>", 'name="stand"|name="back"|name="first"', "a closed loop"),
        ("</robot>", f"{TWICE}\n</robot>", 'name="twice"', "one joint above the link 'lower'"),
        ("</robot>", '<link name="foot"/>\n</robot>', '<link name="foot"/>', "one link of a name"),
        ('name="third"', 'name="second"', '"third"', "one joint of a name"),
        (MESH, 'filename="package://small/edge.stl"', "small/edge.stl", "which does not exist"),
        (MESH, 'filename="model://small/wedge.stl"', "model:", "a path, file:// or package://"),
        (MESH, "", 'scale="0.2 -0.1 0.1"', "attribute 'filename'"),
        (MESH + ' scale="0.2 -0.1 0.1"', MESH + ' scale="1 0 1"', 'scale="1 0 1"', "leaves something"),
        (MESH + ' scale="0.2 -0.1 0.1"', MESH + ' scale="1"', 'scale="1"', "three numbers for 'scale'"),
        ('<sphere radius="0.07"/>', '<capsule radius="1"/>', "<capsule", "one shape, a mesh, box"),
        ('<sphere radius="0.07"/>', "", 'name="bracket"', "one shape, a mesh, box"),
        (LIMIT, "", 'name="second"', "one <limit> in it; got 0"),
        (LIMIT, LIMIT.replace("-1.5", "2.5"), 'effort="20"', "below the upper one; got 2.5 and 2"),
        (LIMIT, LIMIT.replace("-1.5", "nan"), 'effort="20"', "a number for 'lower'; got 'nan'"),
        (LIMIT, LIMIT.replace('effort="20"', 'effort="-5"'), 'effort="-5"', "unknown, or above; got -5"),
        (LIMIT, LIMIT.replace('effort="20"', 'effort="1e400"'), "1e400", "a number for 'effort'"),
        (AXIS, '<axis xyz="0 0 0"/>', 'xyz="0 0 0"/>', "a direction"),
        (AXIS, '<axis xyz="0 nan 0"/>', "0 nan 0", "three numbers for 'xyz'"),
        ('xyz="0.1 0 0" rpy', 'xyz="0.1 0" rpy', 'xyz="0.1 0"', "three numbers for 'xyz'"),
        ('<child link="lower"/>', '<child link="lowr"/>', 'link="lowr"', r"'lowr' \(there is lower"),
        ('<child link="lower"/>', "", 'name="second"', "one <child> in it"),
        ("</robot>", "", "", "a URDF, which is XML"),
        ('<link name="world"/>', '<xacro:macro/><link name="world"/>', "macro", "xacro has expanded"),
        (
            '<robot name="small"',
            '<!DOCTYPE robot [<!ENTITY a "b">]>\n<robot name="small"',
            "ENTITY",
            "no DOCTYPE",
        ),
        ('<robot name="small"', '<sdf name="small"', "", "mismatched tag"),
    ],
)
def test_what_cannot_be_used_is_refused_with_file_and_line(
    old: str, new: str, at: str, complaint: str, tmp_path: Path
) -> None:
    assert SMALL.count(old) == 1
    text = SMALL.replace(old, new)
    file = small_arm_in(tmp_path, text)
    with pytest.raises(ArmFileError, match=complaint) as error:
        read_arm(file, base="world", tcp="hand")
    place = error.value.place
    assert place.file == file
    assert str(error.value).startswith(f"{file}:{place.line}")
    if at:
        lines = {line_of(words, text if words in text else SMALL) for words in at.split("|")}
        assert place.line in lines
    assert isinstance(error.value, InputError)
    assert isinstance(error.value, ArmModelError)


def test_what_is_not_between_base_and_tcp_may_be_anything(tmp_path: Path) -> None:
    text = SMALL.replace('name="grip" type="prismatic"', 'name="grip" type="floating"')
    assert read_arm(small_arm_in(tmp_path, text), base="world", tcp="hand").left_out == ("finger",)


@pytest.mark.parametrize("kind", ["floating", "planar", "prismatic"])
def test_a_joint_that_carries_the_base_is_left_out_with_a_note(kind: str, tmp_path: Path) -> None:
    below = f'<link name="rail"/><joint name="carriage" type="{kind}"><parent link="rail"/>'
    below += '<child link="world"/></joint>'
    file = small_arm_in(tmp_path, SMALL.replace("</robot>", f"{below}</robot>"))
    note = f"the {kind} joint carriage below world is left out: the base stands still"
    assert note in read_arm(file, base="world", tcp="hand").notes
    plain = read_arm(small_arm_in(tmp_path), base="world", tcp="hand")
    assert not any("is left out" in one for one in plain.notes)


@pytest.mark.parametrize(
    ("base", "tcp", "complaint"),
    [
        ("wold", "hand", r"'wold' \(there is world"),
        ("world", "hnd", r"'hnd' \(there is hand"),
        ("hand", "world", "lead up to 'hand'; got they end at 'world'"),
        ("foot", "lower", "3 to 8 turning joints from 'foot' to 'lower'; got 2"),
        ("world", "finger", "'prismatic'"),
        ("hand", "hand", "got 0"),
    ],
)
def test_a_base_and_a_tcp_that_make_no_arm_are_refused(
    base: str, tcp: str, complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(ArmFileError, match=complaint):
        read_arm(small_arm_in(tmp_path), base=base, tcp=tcp)


def test_of_several_links_that_could_end_the_arm_one_must_be_named() -> None:
    with pytest.raises(ArmFileError, match=r"name of the tcp.*panda_leftfinger.*panda_grasptarget"):
        read_arm(OTHERS["panda"][0])


def test_more_than_eight_joints_are_refused(tmp_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(10))
    joint = (
        '<joint name="j{0}" type="continuous"><parent link="l{0}"/><child link="l{1}"/><axis xyz="0 0 1"/>'
    )
    joint += '<limit velocity="1" effort="1"/></joint>'
    for count, fits in ((8, True), (9, False)):
        joints = "".join(joint.format(i, i + 1) for i in range(count))
        (tmp_path / "long.urdf").write_text(f"<robot>{links}{joints}</robot>")
        if fits:
            assert len(read_arm(tmp_path / "long.urdf", base="l0", tcp="l8").joint_names) == 8
        else:
            with pytest.raises(ArmFileError, match="3 to 8 turning joints"):
                read_arm(tmp_path / "long.urdf", base="l0", tcp="l9")


@pytest.mark.parametrize("data", [b"", b"\x00\xff", b"\x89PNG", "<robot>ü".encode("latin-1"), b"<robot/>"])
def test_what_is_no_urdf_is_refused(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.urdf").write_bytes(data)
    with pytest.raises(ArmFileError, match=r"a\.urdf:1"):
        read_arm(tmp_path / "a.urdf")


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArmFileError, match=r"no\.urdf: expected a file"):
        read_arm(tmp_path / "no.urdf")


def test_a_billion_laughs_are_refused_before_the_second(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(30))
    text = f'<!DOCTYPE robot [<!ENTITY e0 "ha">{entities}]><robot name="&e30;"/>'
    (tmp_path / "a.urdf").write_text(text)
    with pytest.raises(ArmFileError, match="no DOCTYPE"):
        read_arm(tmp_path / "a.urdf")


def mutated(text: str, rng: np.random.Generator) -> str:
    """One to three spoilt places: an attribute, a line, a character or the end."""
    for _ in range(rng.integers(1, 4)):
        lines = text.splitlines()
        i, j = (int(k) for k in rng.integers(len(lines), size=2))
        parts = lines[i].split('"')
        match int(rng.integers(6)):
            case 0 | 1 if len(parts) > 2:
                parts[2 * int(rng.integers(len(parts) // 2)) + 1] = NASTY[int(rng.integers(len(NASTY)))]
                lines[i] = '"'.join(parts)
            case 2:
                del lines[i]
            case 3:
                lines.insert(j, lines[i])
            case 4:
                lines[i], lines[j] = lines[j], lines[i]
            case _ if rng.random() < 0.3:
                at = int(rng.integers(len(lines[i]) + 1))
                lines[i] = lines[i][:at] + chr(int(rng.integers(32, 300))) + lines[i][at + 1 :]
        text = "\n".join(lines)
    return text


@pytest.mark.parametrize(("seed", "name"), list(enumerate(["small", *OTHERS])))
def test_a_mutated_urdf_is_an_arm_that_can_be_or_a_clear_error(seed: int, name: str, tmp_path: Path) -> None:
    source, base, tcp = OTHERS.get(name, (small_arm_in(tmp_path), "world", "hand"))
    text, rng = source.read_text(), np.random.default_rng(seed)
    packages = {one: source.parent / one for one in ("meshes", "xarm_description", "small")}
    refused, file = [], tmp_path / "mutated.urdf"
    for _ in range(MUTATIONS // 4):
        file.write_text(mutated(text, rng).replace('="meshes/', '="package://meshes/'), encoding="utf-8")
        try:
            arm = read_arm(file, base=base, tcp=tcp, packages=packages)
        except ArmFileError as error:
            refused.append(error.place)
            continue
        assert 3 <= len(arm.joint_names) <= 8
        assert np.isfinite(arm.joint_origins).all()
        assert np.isfinite(arm.flange).all()
        np.testing.assert_allclose(np.linalg.norm(arm.joint_axes, axis=1), 1.0)
        assert (arm.position_lower_rad < arm.position_upper_rad).all()
        assert not (np.minimum(arm.velocity_limit_radps, arm.effort_limit) <= 0.0).any()
        assert all(shape.file is None or shape.file.is_file() for link in arm.links for shape in link.visual)
    assert all(place.file == file and place.line for place in refused)
    assert MUTATIONS // 4 * 0.1 < len(refused) < MUTATIONS // 4
