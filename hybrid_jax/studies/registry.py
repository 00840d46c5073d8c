# SPDX-License-Identifier: MIT
"""Finds the study that belongs to a cell, and says what a study is."""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hybrid_jax.runs.run_folder import Run
from hybrid_jax.studies.methods import Method
from hybrid_jax.tasks.registry import kind_of
from hybrid_jax.types import Workcell


class Study(Protocol):
    """A comparison of methods on tasks of one kind: a module with these names.

    A report is what `run_method` says of one run; only the study itself looks into it.
    """

    SEEDS: range
    """Seeds of the study's runs, which nothing was tuned on."""
    METHODS: tuple[str, ...]
    """Methods that are compared by default."""

    def run_method(
        self, cell: Workcell, method: Method, numbers: Sequence[int], quiet: bool = False
    ) -> tuple[list[Any], float]:
        """Carry out the runs of one method; returns reports and the time of all [s]."""
        ...

    def drawn(self, cell: Workcell, first: int, runs: int) -> range:
        """Seeds that `runs` runs from `first` on draw scenes from."""
        ...

    def row_of(self, method: str, report: Any) -> dict:
        """A report as plain values that JSON can hold."""
        ...

    def summarize(self, rows: list[dict], seconds: dict[str, float]) -> list[dict]:
        """Metrics of all methods, from their rows and the time of each method's runs [s]."""
        ...

    def learning(self, run: Run) -> list[dict]:
        """Metrics of the run's trainings."""
        ...

    def succeeded(self, report: Any) -> bool:
        """Was a run a success?"""
        ...

    def frames_of(self, report: Any) -> tuple[str, np.ndarray]:
        """Name of a run, and MuJoCo's `qpos` `[frame, nq]` after each tick."""
        ...

    def draw(self, path: Path, rows: list[dict], run: Run) -> None:
        """Draw the study's chart into a file."""
        ...

    def title(self, report: Any) -> str:
        """Outcome of a run in few words."""
        ...

    def lines(self, report: Any) -> list[str]:
        """Outcome of a run, line by line."""
        ...


def study_of(cell: Workcell) -> Any:
    """Module of the study for tasks of the cell's kind, a `Study`.

    Raises:
        WorkcellError: the cell has no task data.
    """
    return importlib.import_module(kind_of(cell).STUDY)
