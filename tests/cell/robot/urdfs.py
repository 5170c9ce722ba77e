"""A small arm as a URDF, whose lines tests spoil; and the arms that PyBullet's data bring."""

from pathlib import Path

import pybullet_data

DATA = Path(pybullet_data.getDataPath())
OTHERS = {  # name: file, base, tcp
    "panda": (DATA / "franka_panda" / "panda.urdf", "panda_link0", "panda_hand"),
    "iiwa": (DATA / "kuka_iiwa" / "model.urdf", None, None),
    "xarm6": (DATA / "xarm" / "xarm6_robot.urdf", None, "link6"),
}
SMALL = """\
<?xml version="1.0"?>
<robot name="small" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="world"/>
  <link name="foot">
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.2 0.3 0.2"/></geometry></collision>
  </link>
  <link name="upper">
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/>
    </inertial>
    <collision><geometry><cylinder radius="0.06" length="0.4"/></geometry></collision>
    <visual>
      <origin rpy="0 0.3 0"/>
      <geometry><mesh filename="package://small/wedge.stl" scale="0.2 -0.1 0.1"/></geometry>
    </visual>
  </link>
  <link name="bracket"><visual><geometry><sphere radius="0.07"/></geometry></visual></link>
  <link name="lower">
    <visual><geometry><mesh filename="small/wedge.stl" scale="0.1 0.1 0.1"/></geometry></visual>
  </link>
  <link name="hand"/>
  <link name="finger"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
  <joint name="stand" type="fixed"><parent link="world"/><child link="foot"/><origin xyz="0 0 1"/></joint>
  <joint name="first" type="continuous">
    <parent link="foot"/>
    <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 0 2"/>
    <limit velocity="2" effort="50"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="upper"/><child link="bracket"/><origin xyz="0 0.1 0.3"/>
  </joint>
  <joint name="second" type="revolute">
    <parent link="bracket"/>
    <child link="lower"/>
    <origin xyz="0.1 0 0" rpy="-0.5 0 1"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="2" velocity="1" effort="20"/>
  </joint>
  <joint name="third" type="revolute">
    <parent link="lower"/>
    <child link="hand"/>
    <origin xyz="0.3 0 0"/>
    <axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" velocity="3" effort="5"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="hand"/>
    <child link="finger"/>
    <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" velocity="1" effort="1"/>
  </joint>
</robot>
"""
WEDGE = """\
solid wedge
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 0 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 0 0
vertex 0 0 1
vertex 0 1 0
endloop
endfacet
facet normal 1 1 1
outer loop
vertex 1 0 0
vertex 0 1 0
vertex 0 0 1
endloop
endfacet
endsolid wedge
"""


def small_arm_in(folder: Path, text: str = SMALL) -> Path:
    """The URDF of the small arm, with its mesh in the folder ``small`` beside it."""
    (folder / "small").mkdir(exist_ok=True)
    (folder / "small" / "wedge.stl").write_text(WEDGE)
    (folder / "small.urdf").write_text(text)
    return folder / "small.urdf"
