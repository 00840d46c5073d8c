# SPDX-License-Identifier: MIT
"""Journal of a study on disk, so that a study that was killed can be continued."""

import fcntl
import json
from collections.abc import Sequence
from pathlib import Path

from hybrid_jax.errors import RunFolderError


class Journal:
    """Lines of JSON beside the study's file; only one process at a time can open it."""

    def __init__(self, path: Path, about: dict):
        """Open a journal, or begin one.

        Args:
            path: of the file.
            about: JSON values that identify the study; only the same study is continued.

        Raises:
            RunFolderError: another process has it open, or it is of another study.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self._file = path, path.open("a+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise RunFolderError(
                f"another study is being written beside {path}: wait for it, or choose another "
                "--out"
            ) from None
        self._file.seek(0)
        text = self._file.read()
        if text and not text.endswith("\n"):  # a kill tore the last line
            self._file.truncate(len(text[: text.rfind("\n") + 1].encode()))
        lines = [line for line in map(_line, text.splitlines(keepends=True)) if line]
        if lines and lines[0] != {"about": about}:
            self._file.close()
            raise RunFolderError(
                f"{path} belongs to a study of {lines[0].get('about')}, this one is of {about}: "
                "choose another --out, or remove it"
            )
        self._entries = lines[1:]
        if not lines:
            self._write({"about": about})

    def missing(self, method: str, numbers: Sequence[int]) -> list[int]:
        """Those of the given runs of a method that are not in the journal yet."""
        recorded = {n for e in self._entries if e["method"] == method for n in e["numbers"]}
        return [number for number in numbers if number not in recorded]

    def add(self, method: str, numbers: Sequence[int], rows: list[dict], seconds: float) -> None:
        """Add the results of some runs of a method, and their time [s]."""
        entry = {"method": method, "numbers": list(numbers), "rows": rows, "seconds": seconds}
        self._entries.append(entry)
        self._write(entry)

    @property
    def rows(self) -> list[dict]:
        """Results of all runs, in the order in which they were added."""
        return [row for entry in self._entries for row in entry["rows"]]

    @property
    def seconds(self) -> dict[str, float]:
        """Total time of each method's runs [s]."""
        totals: dict[str, float] = {}
        for entry in self._entries:
            totals[entry["method"]] = totals.get(entry["method"], 0.0) + entry["seconds"]
        return totals

    def _write(self, entry: dict) -> None:
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()

    def close(self, finished: bool) -> None:
        """Release the journal for other processes; that of a finished study is deleted."""
        if finished:
            self.path.unlink(missing_ok=True)
        self._file.close()


def _line(text: str) -> dict | None:
    """One entry; None for a line that is incomplete because the process was killed."""
    try:
        entry = json.loads(text) if text.endswith("\n") else None
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None
