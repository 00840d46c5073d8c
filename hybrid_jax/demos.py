# SPDX-License-Identifier: MIT
"""Keep demonstrations: `python -m hybrid_jax.demos list | import | split | draw`."""

from pathlib import Path
from typing import Literal

import tyro

from hybrid_jax.demonstrations.demonstration import (
    load_demonstration,
    load_demonstrations,
    save_demonstration,
)
from hybrid_jax.demonstrations.importing import ImportConfig, read_recording
from hybrid_jax.runtime.terminal import answer, run_subcommands
from hybrid_jax.workcell.assets import demonstrations_folder


def list_library(library: Path | None = None, json: bool = False) -> int:
    """List the demonstrations of a library.

    Args:
        library: folder of demonstrations; the shipped ones if not given.
        json: print the list as JSON.
    """
    rows = [
        {
            "name": demo.name,
            "seconds": round(float(demo.times[-1]), 2),
            "robot": demo.robot,
            "gripper": "closed" if demo.closed else "open",
            "note": demo.note,
        }
        for demo in load_demonstrations(library or demonstrations_folder())
    ]
    width = max(len(row["name"]) for row in rows)
    lines = [
        f"{r['name']:{width}s} {r['seconds']:5.1f} s  {r['gripper']:6s}  {r['robot']}  {r['note']}"
        for r in rows
    ]
    answer("\n".join(lines), rows, json)
    return 0


def import_file(
    recording: tyro.conf.Positional[Path],
    library: Path = Path("skills"),
    config: tyro.conf.OmitArgPrefixes[ImportConfig] = ImportConfig(),
) -> int:
    """Read a recording (.csv, .npz, .mcap, .db3 or a bag's folder) into a library.

    Args:
        recording: the file.
        library: folder that it is saved to.
        config: what the file does not say itself.
    """
    for demo in read_recording(recording, config):
        path = save_demonstration(library, demo)
        seconds = demo.times[-1] - demo.times[0]
        print(f"{demo.name}: {len(demo.times)} samples, {seconds:.1f} s, {path}")
    return 0


def split_file(
    file: tyro.conf.Positional[Path], at: Literal["gripper", "screw"] = "gripper"
) -> int:
    """Split a demonstration into parts NAME.1, NAME.2, ... beside it.

    Libraries split at gripper events by themselves when they are loaded.

    Args:
        file: a demonstration of a library.
        at: where the gripper acts, or where one constant screw ends.
    """
    from hybrid_jax.demonstrations.splitting import at_gripper_events, at_screws

    split = at_gripper_events if at == "gripper" else at_screws
    parts = split(load_demonstration(file))
    if len(parts) < 2:
        print(f"{file.stem} is one piece: nothing to split")
        return 0
    for part in parts:
        print(save_demonstration(file.parent, part))
    return 0


def draw_library(out: Path, library: Path | None = None) -> int:
    """Draw each demonstration of a library, one picture each.

    Args:
        out: folder of the pictures.
        library: folder of demonstrations; the shipped ones if not given.
    """
    from hybrid_jax.reports.skill_pictures import draw_demonstration

    for demo in load_demonstrations(library or demonstrations_folder()):
        print(draw_demonstration(out, demo))
    return 0


COMMANDS = {
    "list": list_library,
    "import": import_file,
    "split": split_file,
    "draw": draw_library,
}

if __name__ == "__main__":
    run_subcommands(COMMANDS)
