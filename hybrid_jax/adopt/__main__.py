# SPDX-License-Identifier: MIT
"""Make a robot's file into a cell folder: `python -m hybrid_jax.adopt ROBOT --out FOLDER`."""

from pathlib import Path

import tyro

from hybrid_jax.errors import InputError
from hybrid_jax.runtime.progress import working
from hybrid_jax.runtime.terminal import answer, run_main


def main(
    robot: tyro.conf.Positional[str],
    out: Path,
    tool: str = "",
    group: str = "",
    gripper: str = "",
    srdf: Path | None = None,
    package_path: tuple[Path, ...] = (),
    xacro_arg: tuple[str, ...] = (),
    fixtures: tuple[Path, ...] = (),
    picture: bool = True,
    quiet: bool = False,
    json: bool = False,
) -> int:
    """Write a cell that every command takes; ends with exit code 1 if something stays wrong.

    Args:
        robot: URDF, xacro or MJCF file, as the vendor publishes it.
        out: folder to write to; its name is the cell's.
        tool: site or link that is the tool, where the file does not tell.
        group: group of the SRDF that is the arm; all other joints are held.
        gripper: name of a shipped gripper, or a model, to mount on the tool's frame.
        srdf: file that names the links which may touch.
        package_path: folders that hold ROS packages.
        xacro_arg: arguments of a xacro file, each as NAME=VALUE.
        fixtures: TOML files of what stands around the robot.
        picture: draw the cell at home.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    from hybrid_jax.adopt.adoption import REPORT, AdoptionOptions, adopt, report

    pairs = [argument.partition("=") for argument in xacro_arg]
    for (name, equals, _), argument in zip(pairs, xacro_arg, strict=True):
        if not name or not equals:
            raise InputError(f"--xacro-arg {argument!r} must be NAME=VALUE")
    options = AdoptionOptions(
        tool=tool,
        group=group,
        gripper=gripper,
        srdf=srdf,
        package_paths=package_path,
        xacro_arguments={name: value for name, _, value in pairs},
        fixtures=fixtures,
    )
    with working("adopt", "completing the model", quiet):
        adopted = adopt(robot, out, options)
        if adopted.path is not None:
            (out / REPORT).write_text(report(adopted, Path(robot)))
            if picture:
                _draw(adopted.path)
    rows = [("added", note) for note in adopted.notes]
    rows += [(finding.level, finding.text) for finding in adopted.findings]
    last = f"{adopted.path} was written" if adopted.path else "nothing was written"
    text = "\n".join([*(f"{level:9s} {line}" for level, line in rows), last])
    answer(
        text,
        {
            "fit": adopted.fit,
            "cell": str(adopted.path or ""),
            "added": list(adopted.notes),
            "findings": [{"level": f.level, "text": f.text} for f in adopted.findings],
        },
        json,
    )
    return 0 if adopted.fit else 1


def _draw(path: Path) -> None:
    """Draw a cell at home, beside its file, where off-screen rendering works."""
    import mujoco
    from PIL import Image

    from hybrid_jax.reports.film import render
    from hybrid_jax.workcell.layout import home_qpos

    model = mujoco.MjModel.from_xml_path(str(path))
    for picture in render(model, home_qpos(model)[None]):
        Image.fromarray(picture).save(path.with_suffix(".png"))


if __name__ == "__main__":
    run_main(main)
