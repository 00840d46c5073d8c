# SPDX-License-Identifier: MIT
"""Read recordings of other programs: CSV, NPZ, ROS 2 bags. Units are stated, never guessed.

**CSV**: a header line of names with units, `time [s], x [mm], y [mm], z [mm], qw, qx, qy, qz`, or
`roll [deg], pitch [deg], yaw [deg]` (about the fixed axes x, y, z: W, P, R of some controllers)
instead of the quaternion, and `gripper` (0 open .. 1 closed) if there is one. Lines
`# robot: NAME`, `# frame: NAME`, `# note: TEXT` before it say the rest.

**NPZ**: `poses [sample, 7]` or, for several demonstrations, `[demo, sample, 7]`; `times` [s] or
`rate` [Hz]; `gripper` if there is one; and, as strings, `length_unit` (m, cm, mm), `quaternion`
(wxyz, xyzw), and `robot`, `frame`, `note` if wanted.

**ROS 2 bag**: messages `geometry_msgs/PoseStamped` or `TransformStamped`; for the gripper
`std_msgs/Bool`, `Float32` or `Float64`.
"""

from pathlib import Path

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.importing.bag import read_bag
from hybrid_jax.demonstrations.importing.common import ImportConfig
from hybrid_jax.demonstrations.importing.csvfile import read_csv
from hybrid_jax.demonstrations.importing.npzfile import read_npz
from hybrid_jax.errors import DemonstrationError

__all__ = ["ImportConfig", "read_bag", "read_csv", "read_npz", "read_recording"]

READERS = {".csv": read_csv, ".npz": read_npz, ".mcap": read_bag, ".db3": read_bag}
"""Readers by the ending of a file; a folder is a ROS 2 bag."""


def read_recording(path: Path, config: ImportConfig = ImportConfig()) -> list[Demonstration]:
    """Read a recording of any known format.

    Args:
        path: of the file, or of a bag's folder.
        config: what the file does not say itself.

    Returns:
        Demonstrations with poses `[sample, 7]`; an NPZ file may hold several.

    Raises:
        DemonstrationError: the format is unknown, or a row is wrong.
    """
    if not path.exists():
        raise DemonstrationError(f"{path} does not exist")
    reader = read_bag if path.is_dir() else READERS.get(path.suffix.lower())
    if reader is None:
        raise DemonstrationError(
            f"{path}: unknown format {path.suffix!r}; "
            f"known: {', '.join(READERS)}, or a bag's folder"
        )
    try:
        return reader(path, config)
    except DemonstrationError:
        raise
    except Exception as error:
        raise DemonstrationError(f"{path} cannot be read: {error}") from None
