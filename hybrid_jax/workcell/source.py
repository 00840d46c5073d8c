# SPDX-License-Identifier: MIT
"""The host side of a cell."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import mujoco

T = TypeVar("T")


class WorkcellSource:
    """Host-side half of a cell; two loads of one file are equal and so share compiled code."""

    def __init__(
        self,
        *,
        name,
        digest,
        model,
        layout,
        task,
        owners,
        fixture_bodies,
        path=None,
        tool="",
        spec=None,
    ):
        self.name: str = name
        self.path: Path | None = path
        """File that the model was read from; None where it came from elsewhere."""
        self.tool: str = tool
        """Site or link that whoever loaded the cell named as the tool; mostly empty."""
        self.digest: str = digest
        """Hash of everything the model was compiled from: it identifies the cell in files."""
        self.model: mujoco.MjModel = model
        self.layout = layout
        """`workcell.layout.Layout`: where joints, geoms and objects stand in the model."""
        self.task = task
        """`workcell.description.TaskData` or None: what is done in the cell."""
        self.owners: tuple[int, ...] = owners
        """Object of each primitive of `Workcell.objects`; -1 of empty slots."""
        self.fixture_bodies: tuple[str, ...] = fixture_bodies
        """Body of each primitive of `Workcell.fixtures`; empty strings for empty slots."""
        self.spec: mujoco.MjSpec | None = spec
        """What the model was compiled from; None for a model that came compiled."""
        self._made: dict[Callable, Any] = {}
        self.arrays: Any = None
        """The `Workcell` as it was compiled, its arrays on the host: objects in their bodies'
        frames, nothing held."""

    def once(self, make: Callable[["WorkcellSource"], T]) -> T:
        """What a function makes of this cell, made once and kept as long as the cell."""
        if make not in self._made:
            self._made[make] = make(self)
        return self._made[make]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in the order of `q`."""
        return self.layout.joint_names

    # a static field of a pytree: equality and hash decide whether JAX traces anew
    def __eq__(self, other):
        return isinstance(other, WorkcellSource) and self.digest == other.digest

    def __hash__(self):
        return hash(self.digest)

    def __repr__(self):
        return f"WorkcellSource({self.name!r}, {self.digest[:12]})"
