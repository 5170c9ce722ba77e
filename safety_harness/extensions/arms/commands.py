"""Define ``safety-harness robot``, which shows an arm as read from its URDF or fits capsules to the arm."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import SettingsError
from safety_harness.cli.console import AS_EXPECTED, columns_of, document, result, say
from safety_harness.cli.options import Seed, command

if TYPE_CHECKING:
    from safety_harness.cell.robot.description import ArmModel
    from safety_harness.scenario.robots import AnyRobot

_HELP = "Show the arm of a URDF file, or fit capsules around meshes."
commands = Typer(name="robot", no_args_is_help=True, help=_HELP, short_help=_HELP)
File = Annotated[
    Path,
    Argument(
        help="A URDF file, or a URDF in an installed package, such as pybullet/kuka_iiwa/model.",
        metavar="FILE",
    ),
]
Base = Annotated[
    str | None, Option(help="The fixed link of the arm. Default: the only link without a joint above it.")
]
Tcp = Annotated[
    str | None, Option(help="The last link of the arm. Default: the only link without a joint below it.")
]
Packages = Annotated[
    list[str],
    Option(
        "--package",
        help="The folder with the files of package://NAME/. Default: the command searches the folder "
        "of the URDF file and all folders above it. May be repeated.",
        metavar="NAME=FOLDER",
    ),
]


@command(commands, "show")
def show(
    file: Annotated[
        Path,
        Argument(
            help="A URDF file, a URDF in an installed package (pybullet/kuka_iiwa/model), the file of an "
            "arm (arm.yaml, shipped:panda), or UR10, UR5, UR3.",
            metavar="FILE",
        ),
    ],
    base: Base = None,
    tcp: Tcp = None,
    package: Packages = [],  # noqa: B006
    html: Annotated[
        Path | None,
        Option(help="Also write a page that shows the arm and its capsules in 3-D.", metavar="PAGE"),
    ] = None,
) -> int:
    """Show an arm's joints, limits, reach, links and meshes.

    The HTML page needs an arm with capsules: the file of an arm, or UR10, UR5
    or UR3. The page shows meshes only if the extra "fitting" is installed.

    Exit code 0: the arm is shown.
    Exit code 2: the arm cannot be used; the error states the file and the line.
    """
    import numpy as np

    from safety_harness.claims.properties.tally import table

    robot = _robot(file)
    if robot is None:
        if html is not None:
            raise SettingsError.of_option(
                "--html", "an arm with capsules: an arm's file, or UR10, UR5, UR3", str(file)
            )
        arm = _arm(file, base, tcp, package)
    elif base or tcp or package:
        raise SettingsError.of_option("--base, --tcp, --package", "a URDF with these options", str(file))
    else:
        from safety_harness.cell.robot.robots import arm_model, refuse_unfit

        refuse_unfit(robot)
        arm = arm_model(robot)
    degrees = [np.degrees(arm.position_lower_rad), np.degrees(arm.position_upper_rad)]
    degrees.append(np.degrees(arm.velocity_limit_radps))
    cells = [*(map("{:.1f}".format, column) for column in degrees), map("{:g}".format, arm.effort_limit)]
    rows = zip(arm.joint_names, *cells, strict=True)
    joints = [(name, *("unknown" if cell == "nan" else cell for cell in row)) for name, *row in rows]
    result(
        f"arm         {arm.name}: {len(joints)} joints, {arm.link_names[0]} to {arm.tcp_link}",
        f"reach       at most {1e3 * arm.farthest_reach_m:.0f} mm from the second joint",
        "",
        *table(
            ("joint", "lower deg", "upper deg", "deg/s", "N m"),
            joints,
            columns_of(sys.stdout),
            named_by=1,
            right=range(1, 5),
        ),
        "",
    )
    _show_what_it_lacks(arm)
    names = [[shape.uri or shape.kind for shape in (*link.collision, *link.visual)] for link in arm.links]
    shapes = [
        (link.link, ", ".join(dict.fromkeys(u)) or "none") for link, u in zip(arm.links, names, strict=True)
    ]
    result(*table(("link", "shapes"), shapes, columns_of(sys.stdout), named_by=1))
    document(
        arm=arm.name,
        base=arm.link_names[0],
        tcp=arm.tcp_link,
        farthest_reach_m=arm.farthest_reach_m,
        joints=arm.joint_names,
        position_lower_rad=arm.position_lower_rad,
        position_upper_rad=arm.position_upper_rad,
        velocity_limit_radps=arm.velocity_limit_radps,
        effort_limit_nm=arm.effort_limit,
        shapes=dict(zip(arm.link_names, names, strict=True)),
        left_out=arm.left_out,
        soft_limits_rad=arm.soft_limits_rad,
        lacks=[{"what": lack.what, "for": lack.uses, "supply": lack.supply} for lack in arm.lacks],
        notes=arm.notes,
        page=html,
    )
    if html is not None and robot is not None:
        from safety_harness.base.whole_file import writing
        from safety_harness.extensions.arms.page import write_arm_page

        with writing(html):
            write_arm_page(html, [robot], title=f"{arm.name} and its capsules")
        say(f"page: {html}")
    return AS_EXPECTED


@command(commands, "fit", interrupted="interrupted: no capsules were written")
def fit(
    file: File,
    out: Annotated[Path, Option(help="The file for the capsules.", metavar="FILE.json")],
    base: Base = None,
    tcp: Tcp = None,
    package: Packages = [],  # noqa: B006
    without_geometry: Annotated[
        list[str],
        Option(
            help="A link that is allowed to have no shape, although it lies between links with shapes. May"
            " be repeated.",
            metavar="LINK",
        ),
    ] = [],  # noqa: B006
    seed: Seed = 0,
    jobs: Annotated[
        int, Option(help="Number of links to fit at the same time, each in its own process.")
    ] = 1,
) -> int:
    """Fit capsules around an arm's meshes (takes minutes).

    The capsules enclose every triangle of the collision and visual meshes. For
    each link, the command prints the number of capsules, and how far they
    extend beyond the meshes. The file records the SHA-256 of the URDF and of
    the meshes, and is valid only for these files.

    Exit code 0: the file is written.
    Exit code 2: bad input.
    Exit code 130: interrupted; no file was written.
    """
    import numpy as np

    from safety_harness.base.extras import FITTING
    from safety_harness.base.pool import pool
    from safety_harness.cell.robot.capsules import unenclosed_links
    from safety_harness.claims.properties.tally import table
    from safety_harness.cli.progress import counting
    from safety_harness.extensions.arms.fit_capsules import (
        FINE_M,
        excess,
        fit_arm,
        link_surface,
        write_capsules,
    )

    FITTING.require("robot fit")
    if jobs < 1:
        raise SettingsError.of_option("--jobs", "a number of at least 1", str(jobs))
    arm = _arm(file, base, tcp, package)
    shaped = [link.index for link in arm.links if link.collision or link.visual]
    if shaped and (links := unenclosed_links(arm, shaped, without_geometry)):
        raise SettingsError.of_option(
            "--without-geometry",
            f"shapes of every link of {arm.file} between others that have them, or the links accepted here",
            f"no shape of {', '.join(links)}",
        )
    with counting(len(shaped), "links") as progress, ExitStack() as closing:
        each = map if jobs == 1 else closing.enter_context(pool(jobs)).map
        fitted = fit_arm(arm, seed, progress, each)
    write_capsules(out, arm, fitted)
    rng = np.random.default_rng(0)
    stands_out_m = [excess(capsules, link_surface(link, FINE_M), rng) for link, capsules in fitted]
    rows = [
        (link.link, str(len(capsules)), *(f"{1e3 * metres:.1f}" for metres in out_by))
        for (link, capsules), out_by in zip(fitted, stands_out_m, strict=True)
    ]
    result(
        *table(
            ("link", "capsules", "at most mm over", "mean mm"),
            rows,
            columns_of(sys.stdout),
            named_by=1,
            right=range(1, 4),
        )
    )
    document(
        file=out,
        links=[
            {"link": link.link, "capsules": len(capsules), "largest_excess_m": most, "mean_excess_m": mean}
            for (link, capsules), (most, mean) in zip(fitted, stands_out_m, strict=True)
        ],
        left_out=arm.left_out,
    )
    say(f"capsules: {out}")
    return AS_EXPECTED


@command(commands, "enclose")
def enclose(
    file: Annotated[Path, Argument(help="A mesh file, for example STL, OBJ or DAE.", metavar="FILE")],
    scale: Annotated[
        float, Option(help="Factor from the unit of the mesh to metres, for example 0.001 for millimetres.")
    ] = 1.0,
    seed: Seed = 0,
) -> int:
    """Enclose the mesh of a tool or a part in capsules.

    The command prints the capsules in the form of a scenario file. They contain
    every triangle of the mesh, and are in the frame of the mesh. Another line
    states how far the capsules extend beyond the mesh.

    Exit code 0: the capsules are printed.
    Exit code 2: bad input.
    """
    import numpy as np

    from safety_harness.base.extras import FITTING
    from safety_harness.extensions.arms.fit_capsules import excess, fit_mesh

    FITTING.require("robot enclose")
    if not 0.0 < scale < np.inf:
        raise SettingsError.of_option("--scale", "a factor above 0", f"{scale:g}")
    capsules, surface = fit_mesh(file, scale, seed)
    most_m, mean_m = excess(capsules, surface, np.random.default_rng(0))
    result("capsules:")
    for *ends, radius_m in capsules:
        start, end = ("[" + ", ".join(f"{1e3 * x:.1f} mm" for x in point) + "]" for point in ends)
        result(f"  - {{from: {start}, to: {end}, radius: {1e3 * radius_m:.1f} mm}}")
    document(
        capsules=[{"from_m": a, "to_m": b, "radius_m": r} for a, b, r in capsules],
        largest_excess_m=most_m,
        mean_excess_m=mean_m,
    )
    say(f"at most {1e3 * most_m:.1f} mm over the mesh, {1e3 * mean_m:.1f} mm on average")
    return AS_EXPECTED


def _show_what_it_lacks(arm: ArmModel) -> None:
    """Print the quantities that the URDF lacks, with their uses and keys, then the soft limits and notes."""
    import numpy as np

    from safety_harness.claims.properties.tally import table

    rows = [(lack.what, ", ".join(lack.uses), lack.supply) for lack in arm.lacks]
    if rows:
        result(*table(("it lacks", "needed by", "supplied by"), rows, columns_of(sys.stdout), named_by=1), "")
    for name, (lower, upper) in zip(arm.joint_names, np.degrees(arm.soft_limits_rad), strict=True):
        if not np.isnan(lower):
            result(f"soft limits of {name}: {lower:.1f} to {upper:.1f} deg; `soft limits: yes` takes them")
    result(*arm.notes)


def _robot(file: Path) -> AnyRobot | None:
    """Return the arm that ``file`` specifies, or None if ``file`` is a URDF.

    ``file`` is either the path of an arm's file or the name of an arm that is built into the package.
    """
    from safety_harness.scenario.robots import Robot, is_arm_file, robot_named

    text = str(file)
    return robot_named(text) if is_arm_file(text) or text in [robot.label for robot in Robot] else None


def _arm(file: Path, base: str | None, tcp: str | None, package: list[str]) -> ArmModel:
    from safety_harness.base.exceptions import Place
    from safety_harness.cell.robot.description import read_arm
    from safety_harness.scenario.urdf_packages import urdf_of_package

    if file.suffix != ".urdf" and not file.exists():
        file = urdf_of_package(file.as_posix(), Place(field="FILE"))
    packages = {}
    for text in package:
        name, _, folder = text.partition("=")
        if not (name and folder):
            raise SettingsError.of_option("--package", "NAME=FOLDER", repr(text))
        packages[name.strip("/")] = Path(folder)
    arm = read_arm(file, base=base, tcp=tcp, packages=packages)
    if arm.left_out:
        say(f"not of the arm, since other joints move them: {', '.join(arm.left_out)}")
    return arm
