# SPDX-License-Identifier: MIT
"""Broken inputs for every reader: `mutate` a sound file, read it, and see what is raised."""

import io
import json
import random
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from recordings import recording, write_bag

from hybrid_jax.agents import joint, networks
from hybrid_jax.demonstrations.demonstration import load_demonstration
from hybrid_jax.demonstrations.importing import read_recording
from hybrid_jax.errors import HybridJaxError
from hybrid_jax.export.fanuc_tp_reader import read_tp_program
from hybrid_jax.feasibility.building import build_feasibility_map
from hybrid_jax.feasibility.grid import MapConfig
from hybrid_jax.feasibility.map_files import load_map, save_map
from hybrid_jax.runs.load_planner import load_policy
from hybrid_jax.runs.presets import PRESETS, SMOKE, Preset
from hybrid_jax.runs.run_folder import FORMAT, Run, read_config
from hybrid_jax.runs.settings import as_values, from_values
from hybrid_jax.runtime import artifacts
from hybrid_jax.tasks.registry import random_task, read_task, task_values
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.assets import demonstrations_folder, robots_folder
from hybrid_jax.workcell.description import read_task_data
from hybrid_jax.workcell.load import load_workcell

WEIRD = (
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e999",
    b"-0.0",
    b"9" * 40,
    b"null",
    b"[]",
    b"{}",
    b'""',
    b"true",
    b"\x00",
    b"\xff\xfe",
    b"..",
    b"/dev/null",
    b"'",
    b'"',
    b"\n",
    b"[" * 2000,
    b"<!--",
    b"0x10",
)
"""What numbers and words are replaced by."""
ARM = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body name="post" pos=".5 0 .2"><geom type="box" size=".05 .05 .2"/></body>
<body name="arm" pos="0 0 .3"><joint name="a" axis="0 0 1" range="-3 3" user="2 5"/>
<geom name="link" type="capsule" size=".03" fromto="0 0 0 .2 0 0"/>
<body pos=".2 0 0"><joint name="b" axis="0 1 0" range="-1 1"/>
<geom type="sphere" size=".03"/><site name="tool" pos=".1 0 0"/></body></body>
<body name="thing" pos="-.3 0 .1"><freejoint/><geom type="box" size=".02 .02 .02"/></body>
</worldbody></mujoco>"""
URDF = """<robot name="r"><link name="base"/><link name="one"><inertial><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<geometry><sphere radius=".05"/></geometry></collision></link><joint name="j" type="revolute">
<parent link="base"/><child link="one"/><origin xyz="0 0 .2" rpy="0 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
CSV = "# robot: arm\ntime [s], x [mm], y [mm], z [mm], roll [deg], pitch [deg], yaw [deg], gripper"
CSV += "\n"
CSV += "\n".join(f"{i / 20}, {400 + i}, {i}, 255.4, 180.0, 0.0, 12.5, 0" for i in range(20))
TP = (
    "/PROG  P\n/ATTR\nLINE_COUNT = 2;\n/MN\n   1:J P[1] 5% FINE    ;\n"
    "   2:  WAIT    .80(sec)    ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\n"
    "\tJ1= 1.000 deg,\n\tJ2= 2.000 deg\n};\n/END\n"
)


@dataclass(frozen=True)
class Target:
    """A reader and a sound file of its format."""

    name: str
    suffix: str
    sound: bytes
    read: Callable[[Path], object]
    arrays: bool = False
    """Is the file an `.npz`, whose arrays are changed as well as its bytes?"""


def _npz(**arrays) -> bytes:
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _config() -> bytes:
    values = {"format": FORMAT, "workcell": "gen3_handling", "digest": "0" * 64, "seed": 0}
    values |= {"preset": "smoke", "skills": None, "tool": "", "package_paths": []}
    return json.dumps(values | {"configuration": as_values(SMOKE)}).encode()


def _read_config_file(path: Path) -> Preset:
    values = read_config(path.rename(path.with_name("config.json")).parent)
    return from_values(Preset, values["configuration"], "configuration")


def _run_of(path: Path, cell: Workcell) -> Run:
    return Run(path.parent, cell, "smoke", 0)


def _recording() -> bytes:
    poses = np.zeros((20, 7))
    poses[:, 0], poses[:, 3] = np.linspace(0, 0.2, 20), 1.0
    units = {"length_unit": np.array("m"), "quaternion": np.array("wxyz")}
    return _npz(poses=poses, times=np.arange(20) / 20, **units)


def _bag(folder: Path) -> bytes:
    write_bag(folder, recording())
    return next(folder.glob("*.mcap")).read_bytes()


def _policy(path: Path, cell: Workcell) -> bytes:
    config = PRESETS["smoke"].joint
    policy = networks.blank_policy(
        joint.make_net(cell, config), joint.observation_length(cell, config)
    )
    artifacts.save(path, "joint agent", cell.source.digest, policy)
    return path.read_bytes()


def _map(path: Path, cell: Workcell) -> bytes:
    config = MapConfig(
        lower=(0.3, -0.1, 0.3), upper=(0.5, 0.1, 0.5), spacing=0.2, batch=32, samples=1
    )
    save_map(path, cell, build_feasibility_map(cell, config))
    return path.read_bytes()


def make_targets(folder: Path, cell: Workcell) -> dict[str, Target]:
    """All readers by name.

    Args:
        folder: for files that are made to be changed.
        cell: the handling cell.
    """
    config = PRESETS["smoke"].joint
    net, seen = joint.make_net(cell, config), joint.observation_length(cell, config)
    task = json.dumps(task_values(random_task(cell, 4))).encode()
    cells = robots_folder() / "workcells"
    handling, inspecting = ((cells / f"{n}.toml").read_bytes() for n in ("gen3_handling", "fpi"))
    fmap = _map(folder / "map.npz", cell)
    metrics = b"\n".join(json.dumps({"step": i, "reward": i / 7}).encode() for i in range(9))
    demo = next(demonstrations_folder().glob("*.npz")).read_bytes()

    def policy(path):
        return load_policy(_run_of(path, cell), path.name, "joint agent", net, seen)

    def program(path):
        return read_tp_program(path.read_text(errors="replace"))

    targets = [
        Target("mjcf", ".xml", ARM.encode(), load_workcell),
        Target("urdf", ".urdf", URDF.encode(), load_workcell),
        Target("handling data", ".toml", handling, read_task_data),
        Target("inspection data", ".toml", inspecting, read_task_data),
        Target("task", ".json", task, lambda path: read_task(cell, path)),
        Target("csv recording", ".csv", CSV.encode(), read_recording),
        Target("npz recording", ".npz", _recording(), read_recording, arrays=True),
        Target("ros bag", ".mcap", _bag(folder / "bag"), read_recording),
        Target("ros bag of sqlite", ".db3", b"SQLite format 3\x00" + bytes(200), read_recording),
        Target("demonstration", ".npz", demo, load_demonstration, arrays=True),
        Target("map", ".npz", fmap, lambda path: load_map(path, cell), arrays=True),
        Target("policy", ".npz", _policy(folder / "policy.npz", cell), policy, arrays=True),
        Target("run's settings", ".json", _config(), _read_config_file),
        Target("metrics", ".jsonl", metrics, lambda path: _run_of(path, cell).metrics(path.stem)),
        Target("tp program", ".ls", TP.encode(), program),
    ]
    return {target.name: target for target in targets}


def mutate(rng: random.Random, target: Target) -> bytes:
    """A broken file: one to four changes of a sound one."""
    if target.arrays and rng.random() < 0.6:
        return _changed_arrays(rng, target.sound)
    data = target.sound
    for _ in range(rng.randint(1, 4)):
        data = rng.choice(_CHANGES)(rng, data)
    return data


def _flip(rng, data):
    at = rng.randrange(max(1, len(data)))
    return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]


def _cut(rng, data):
    return data[: rng.randrange(max(1, len(data)))]


def _drop(rng, data):
    at = rng.randrange(max(1, len(data)))
    return data[:at] + data[at + rng.randint(1, 60) :]


def _repeat(rng, data):
    at = rng.randrange(max(1, len(data)))
    part = data[at : at + rng.randint(1, 200)]
    return data[:at] + part * rng.randint(2, 4) + data[at + len(part) :]


def _swap_token(rng, data):
    """Replace a number or a word."""
    found = list(re.finditer(rb"[-\w.]+", data))
    if not found:
        return data
    token = rng.choice(found)
    return data[: token.start()] + rng.choice(WEIRD) + data[token.end() :]


def _drop_line(rng, data):
    lines = data.splitlines(keepends=True)
    if lines:
        lines.pop(rng.randrange(len(lines)))
    return b"".join(lines)


_CHANGES = (_flip, _cut, _drop, _repeat, _swap_token, _swap_token, _swap_token, _drop_line)


def _changed_arrays(rng: random.Random, sound: bytes) -> bytes:
    """The file with one to three of its arrays missing, of another shape, kind or value."""
    with np.load(io.BytesIO(sound)) as file:
        arrays = {name: file[name] for name in file.files}
    for _ in range(rng.randint(1, 3)):
        name = rng.choice(list(arrays))
        a = arrays[name]
        if rng.random() < 0.15:
            del arrays[name]
            if not arrays:
                break
            continue
        arrays[name] = rng.choice(_ARRAY_CHANGES)(rng, a)
    out = io.BytesIO()
    np.savez(out, allow_pickle=True, **arrays)
    return out.getvalue()


def _spoil(rng, a):
    if a.dtype.kind not in "fiu" or not a.size:
        return a
    a = a.astype(float)
    a.flat[rng.randrange(a.size)] = rng.choice([np.nan, np.inf, -1e30, 0.0])
    return a


_ARRAY_CHANGES = (
    _spoil,
    lambda rng, a: a[..., : rng.randint(0, 3)] if a.ndim else a,
    lambda rng, a: a[None],
    lambda rng, a: a.ravel()[: rng.randint(0, max(1, a.size))],
    lambda rng, a: np.zeros(0),
    lambda rng, a: np.array("text"),
    lambda rng, a: np.array({"an": "object"}, object),
    lambda rng, a: a.astype(complex) if a.dtype.kind in "fiu" else a,
    lambda rng, a: np.array(rng.choice(['{"kind": 3}', "[]", "null", '{"format": 1}', "{"])),
)


def attempt(target: Target, data: bytes, folder: Path) -> tuple[str, str]:
    """Read a file and clean up.

    Returns:
        `read`, `refused` or `crashed`, and what was raised.
    """
    path = folder / f"broken{target.suffix}"
    path.write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.read(path)
    except HybridJaxError as error:
        return "refused", f"{type(error).__name__}: {error}"
    except Exception as error:
        return "crashed", f"{type(error).__name__}: {error}"
    finally:
        for left in folder.iterdir():
            left.unlink()
    return "read", ""
