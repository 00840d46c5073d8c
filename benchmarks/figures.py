# SPDX-License-Identifier: MIT
"""Render the documents' figures from the results of the benchmarks.

    python -m benchmarks.figures

In a document stands a template in a comment, and below it what it is rendered to:

    <!-- figures
    | solved | {planning.solved:.3f} |
    -->
    | solved | 0.990 |
    <!-- end -->

A name in braces is the key of a figure in one of `docs/figures/*.json`; with `!n` it is the note
that stands beside it. `{NAME@command}`, `@commit`, `@machine`, `@python`, `@jax` say where the
figures of NAME.json are from; `{NAME@table}` is a table of all of them.
"""

import json
import re
import string
from pathlib import Path

import tyro

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "figures"
BLOCK = re.compile(r"(<!-- figures\n(.*?)-->\n)(.*?)(<!-- end -->)", re.DOTALL)
"""A template, and what it was rendered to."""


def read_results(folder: Path = FOLDER) -> dict[str, dict]:
    """Contents of every result file, by its name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


class _Figures(string.Formatter):
    """Fills templates; a key that no file has is an error."""

    def __init__(self, results: dict[str, dict]):
        self._about = results
        self._metrics: dict[str, dict] = {}
        for name, values in results.items():
            for row in values["metrics"]:
                if row["key"] in self._metrics:
                    raise KeyError(f"{row['key']} stands in {name}.json and in another file")
                self._metrics[row["key"]] = row

    def get_field(self, field_name, args, kwargs):
        del args, kwargs
        if "@" in field_name:
            name, what = field_name.split("@")
            return self._of_file(self._about[name], what), field_name
        return self._metrics[field_name], field_name

    @staticmethod
    def _of_file(values: dict, what: str) -> str:
        if what == "table":
            return table(values["metrics"])
        return values["versions"][what] if what in values["versions"] else values[what]

    def convert_field(self, value, conversion):
        return value["note"] if conversion == "n" else value

    def format_field(self, value, format_spec):
        return super().format_field(
            value["value"] if isinstance(value, dict) else value, format_spec
        )


def shown(value: float) -> str:
    """A figure in four digits, or as a whole number where it has more."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def table(metrics: list[dict]) -> str:
    """Figures with their keys, units and notes."""
    rows = [
        f"| `{m['key']}` | {shown(m['value'])} | {m['unit'] if m['unit'] != '1' else ''} | "
        f"{m['note']} |"
        for m in metrics
    ]
    return "\n".join(["| key | figure | unit | what |", "|---|---|---|---|", *rows])


def rendered(text: str, results: dict[str, dict]) -> str:
    """A document with its figures as the results say.

    Raises:
        KeyError: a template names a figure that no result has.
    """
    figures = _Figures(results)

    def fill(block: re.Match) -> str:
        return block[1] + figures.vformat(block[2], (), {}) + block[4]

    return BLOCK.sub(fill, text)


def pages() -> list[Path]:
    """Documents that figures may stand in."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def main() -> None:
    """Render all documents; print those that have changed."""
    results = read_results()
    for page in pages():
        before = page.read_text()
        after = rendered(before, results)
        if after != before:
            page.write_text(after)
            print(f"{page.relative_to(ROOT)} rendered anew")


if __name__ == "__main__":
    tyro.cli(main)
