# SPDX-License-Identifier: MIT
"""Public robot models that `benchmarks.robots` tries, and how each is adopted."""

import importlib.util
import sysconfig
from dataclasses import dataclass, field
from pathlib import Path

from hybrid_jax.adopt.adoption import AdoptionOptions


@dataclass(frozen=True)
class RobotModel:
    """One model as its vendor publishes it."""

    name: str
    """Of the model."""
    file: str
    """Path of its file in its folder."""
    options: AdoptionOptions = field(default_factory=AdoptionOptions)
    """At most one: what the file does not tell."""


FOLDER = (
    RobotModel("gp8", "motoman_gp8_support/urdf/gp8.xacro"),
    RobotModel("lrmate200id", "fanuc_lrmate200id_support/urdf/lrmate200id.xacro"),
    RobotModel("lrmate200id7l", "fanuc_lrmate200id_support/urdf/lrmate200id7l.xacro"),
    RobotModel("irb2400", "abb_irb2400_support/urdf/irb2400.urdf"),
    RobotModel("m10ia", "moveit_fanuc_description/urdf/fanuc.urdf"),
    RobotModel("panda", "moveit_panda_description/urdf/panda.urdf"),
    RobotModel("iiwa14", "menagerie_kuka_iiwa_14/iiwa14.xml"),
    RobotModel("xarm7", "menagerie_ufactory_xarm7/xarm7.xml"),
    RobotModel("xarm7_nohand", "menagerie_ufactory_xarm7/xarm7_nohand.xml"),
    RobotModel("tidybot", "menagerie_stanford_tidybot/tidybot.xml"),
    RobotModel("jaco", "dm_control_jaco/jaco_arm.xml"),
)
"""Of the folder that is named."""
PACKAGES = {
    "airo_models": (
        RobotModel("ur5e", "arms/ur5e/ur5e.urdf"),
        RobotModel("ur3e", "arms/ur3e/ur3e.urdf"),
    ),
    "example-robot-data": (
        RobotModel("panda_erd", "panda_description/urdf/panda.urdf"),
        RobotModel("kinova_j2s6s200", "kinova_description/robots/kinova.urdf"),
        RobotModel("ur5", "ur_description/urdf/ur5_robot.urdf"),
        RobotModel("ur10", "ur_description/urdf/ur10_robot.urdf"),
        RobotModel("xarm7_erd", "xarm_description/urdf/xarm7.urdf"),
        RobotModel("z1", "z1_description/urdf/z1.urdf", AdoptionOptions(tool="link06")),
        RobotModel("so100", "so_arm_description/urdf/so100.urdf", AdoptionOptions(tool="gripper")),
        RobotModel(
            "talos_arm",
            "talos_data/robots/talos_left_arm.urdf",
            AdoptionOptions(tool="arm_left_7_link"),
        ),
        RobotModel(
            "tiago",
            "tiago_description/robots/tiago_no_hand.urdf",
            AdoptionOptions(tool="arm_7_link"),
        ),
        RobotModel(
            "baxter", "baxter_description/urdf/baxter.urdf", AdoptionOptions(tool="left_wrist")
        ),
    ),
}
"""Of packages, where they are installed (`pip install 'hybrid_jax[robots]'`)."""


def models(folder: Path) -> list[tuple[RobotModel, Path]]:
    """Every model that is here, with its file."""
    found = [(model, folder / model.file) for model in FOLDER]
    for package, listed in PACKAGES.items():
        place = _folder_of(package)
        found += [(model, place / model.file) for model in listed if place]
    return [(model, path) for model, path in found if path.is_file()]


def _folder_of(package: str) -> Path | None:
    """Folder of a package's models; None where it is not installed."""
    if package == "example-robot-data":
        site = Path(sysconfig.get_paths()["purelib"])
        folder = site / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
        return folder if folder.is_dir() else None
    spec = importlib.util.find_spec(package)
    return Path(spec.origin).parent if spec and spec.origin else None
