# SPDX-License-Identifier: MIT
"""Finds the study that belongs to a cell."""

from types import ModuleType

from hybrid_jax.studies import handling, inspection
from hybrid_jax.tasks.scene_sampling import require_task_data
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import Handling, Inspection

STUDIES = {Handling: handling, Inspection: inspection}
"""Module of the study for each kind of task data."""


def study_of(cell: Workcell) -> ModuleType:
    """Module of the study for the tasks that the cell's data describe.

    Raises:
        WorkcellError: the cell has no task data.
    """
    return STUDIES[type(require_task_data(cell))]
