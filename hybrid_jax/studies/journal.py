# SPDX-License-Identifier: MIT
"""What a study has done so far, kept on disk: one that was killed goes on with what it lacks."""

import fcntl
import json
from collections.abc import Sequence
from pathlib import Path

from hybrid_jax.errors import RunFolderError


class Journal:
    """Lines of JSON beside the study's file; one process at a time has it."""

    def __init__(self, path: Path, about: dict):
        """Open, or begin.

        Args:
            path: of the file.
            about: what the study is of; one about something else is not gone on with.

        Raises:
            RunFolderError: another process has it, or it is of another study.
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
        """Runs of a method that are not there yet."""
        done = {n for e in self._entries if e["method"] == method for n in e["numbers"]}
        return [number for number in numbers if number not in done]

    def add(self, method: str, numbers: Sequence[int], rows: list[dict], seconds: float) -> None:
        """Keep what some runs of a method came to, and the time that they took [s]."""
        entry = {"method": method, "numbers": list(numbers), "rows": rows, "seconds": seconds}
        self._entries.append(entry)
        self._write(entry)

    @property
    def rows(self) -> list[dict]:
        """All runs, in the order in which they were made."""
        return [row for entry in self._entries for row in entry["rows"]]

    @property
    def seconds(self) -> dict[str, float]:
        """Time of each method's runs [s]."""
        found: dict[str, float] = {}
        for entry in self._entries:
            found[entry["method"]] = found.get(entry["method"], 0.0) + entry["seconds"]
        return found

    def _write(self, entry: dict) -> None:
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()

    def close(self, finished: bool) -> None:
        """Let others have it; a study that is finished leaves none."""
        if finished:
            self.path.unlink(missing_ok=True)
        self._file.close()


def _line(text: str) -> dict | None:
    """One entry; None for a line that a kill tore."""
    try:
        found = json.loads(text) if text.endswith("\n") else None
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
