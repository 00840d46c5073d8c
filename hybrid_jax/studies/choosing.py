# SPDX-License-Identifier: MIT
"""Which study belongs to a cell."""

from types import ModuleType

from hybrid_jax.skills.scenes import require_task_data
from hybrid_jax.studies import handling, inspection
from hybrid_jax.types import Workcell
from hybrid_jax.workcell.description import Handling, Inspection

STUDIES = {Handling: handling, Inspection: inspection}


def study_of(cell: Workcell) -> ModuleType:
    """The study of the tasks that the cell's data describe; WorkcellError where there are none."""
    return STUDIES[type(require_task_data(cell))]
