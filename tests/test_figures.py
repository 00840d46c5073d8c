# SPDX-License-Identifier: MIT
"""Figures in documents are those of the committed results, and benchmarks run to their end."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from hybrid_jax.runtime import provenance

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
figures = pytest.importorskip("benchmarks.figures")
RESULTS = sorted((ROOT / "docs" / "figures").glob("*.json"))


@pytest.mark.parametrize("page", figures.pages(), ids=lambda page: page.name)
def test_documents_are_rendered_from_the_results(page):
    """`make figures` would change nothing."""
    text = page.read_text()
    assert figures.rendered(text, figures.read_results()) == text


GIVEN = re.compile(r"<!-- given -->\n.*?(?=\n\n|\Z)", re.DOTALL)
"""A table or paragraph of what is defined or quoted, not measured."""
RATE = r"\d ?(?:[a-z]+ )?(?:plans|poses|steps|configurations|rounds|clearances|million|k|1)/s\b"
RATIO = r"\d times (?:as|PyBullet|C MuJoCo|OMPL|MJX|faster)"
SHARE = (
    r"\d of (?:the )?\d\d|\d ?% (?:of (?:the )?(?:runs|trials|tasks|points|poses|way)"
    r"|fewer|more|less|faster|shorter)"
)
PROSE = (
    r"(?<![\w.])0\.\d+ of|instead of \d|(?:took|takes) (?:about |some )?\d"
    r"|\d times (?:short|long|few|more|less)|\d min\b"
)
MEASURED = re.compile(rf"throw-away|\b[A-Z]+_[A-Z]*SHO\w+|{RATE}|{RATIO}|{SHARE}|{PROSE}")
NUMBER = re.compile(r"[~<>+-]? ?\d[\d.,]*( ?(%|k|ms|s|mm|deg|us|1/s|min|rad|cm))?( each| \(.*\))?")


def unbacked(text: str) -> list[str]:
    """Lines of a document with measured figures that are not rendered from a result."""
    text = re.sub(r"```.*?```", "", GIVEN.sub("", figures.BLOCK.sub("", text)), flags=re.DOTALL)
    found = []
    for line in text.splitlines():
        cells = [c.strip() for c in line.strip("|").split("|")] if line.startswith("|") else []
        if MEASURED.search(line) or any(NUMBER.fullmatch(cell) for cell in cells[1:]):
            found.append(line)
    return found


@pytest.mark.parametrize("page", figures.pages(), ids=lambda page: page.name)
def test_every_figure_of_a_document_is_backed_by_a_result(page):
    assert not unbacked(page.read_text())


def test_figures_that_no_result_backs_are_found():
    assert unbacked("it makes 56 plans/s")
    assert unbacked("| key | what | 0.99 (of 200) |")
    assert unbacked("99 of 100 runs, with a throw-away script")
    assert unbacked("one task takes 47 ms") and unbacked("the study took 37 min")
    assert unbacked("it solves 0.99 of the tasks") and unbacked("1.6 times shorter")
    assert unbacked("16.5 s instead of 10.8 s") and unbacked("| what | 0.47 ms each |")
    assert not unbacked("<!-- given -->\n| tolerance | 0.30 |\n| x | 5 |\n\nword")
    assert not unbacked("<!-- figures\n{a}\n-->\n| a | 0.5 |\n<!-- end -->\nthe supervisor: 50 ms")


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_result_says_where_it_is_from(path):
    values = json.loads(path.read_text())
    module = re.match(r"python -m (benchmarks\.\w+|hybrid_jax\.\w+)", values["command"])[1]
    assert importlib.util.find_spec(module), f"{module} is gone: {path.name} cannot be made anew"
    assert values["commit"] not in ("", "unknown") and not values["commit"].endswith("-dirty")
    assert {"python", "jax", "mujoco"} <= set(values["versions"]) and values["machine"]
    for row in values["metrics"]:
        assert {"key", "value", "unit", "better", "device", "note"} == set(row)


def test_templates_are_filled_and_unknown_figures_refused():
    results = {
        "a": {
            "commit": "1234567",
            "versions": {"jax": "1.2"},
            "metrics": [{"key": "a.share", "value": 0.98765, "unit": "1", "note": "of 10"}],
        }
    }
    text = "x\n<!-- figures\n{a.share:.2f} {a.share!n} {a@commit} {a@jax}\n-->\nold\n<!-- end -->\n"
    assert "-->\n0.99 of 10 1234567 1.2\n<!-- end -->" in figures.rendered(text, results)
    whole = figures.rendered("<!-- figures\n{a@table}\n-->\n<!-- end -->\n", results)
    assert "|\n| `a.share` | 0.9877 |  | of 10 |\n<!-- end -->" in whole
    with pytest.raises(KeyError):
        figures.rendered(text.replace("a.share", "a.other"), results)
    twice = results | {"b": results["a"]}
    with pytest.raises(KeyError, match="another file"):
        figures.rendered(text, twice)


def test_no_path_of_a_machine_stands_in_a_command(tmp_path, monkeypatch):
    arguments = ["x", "--run=/home/x/runs/a", "/home/x/b.json", "--json", "docs/figures/c.json"]
    monkeypatch.setattr(sys, "argv", arguments)
    provenance.write_figures(tmp_path / "a.json", [], {"range": range(3, 5)})
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["command"].endswith(" --run=a b.json --json docs/figures/c.json")
    assert written["seeds"] == {"range": [3, 5]} and written["commit"]


def test_a_package_that_no_repository_has_as_its_own_has_no_commit(tmp_path, monkeypatch):
    """Installed inside somebody's repository."""
    installed = tmp_path / "venv" / "provenance.py"
    installed.parent.mkdir()
    installed.write_text("")
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    monkeypatch.setattr(provenance, "ROOT", installed.parent)
    monkeypatch.setattr(provenance, "__file__", str(installed))
    assert provenance.commit() == "unknown"


def test_collected_problems_are_taken_from_their_file(cell, tmp_path, monkeypatch):
    """A file that is there is read, and nothing is collected."""
    from benchmarks import drl_problems
    from hybrid_jax.contracts import Segments
    from hybrid_jax.errors import RunFolderError

    scenes = jax.tree.map(lambda a: np.stack([a, a]), cell.scene)
    ends = np.tile(np.asarray(cell.home), (2, 1))
    one = Segments(scenes, ends, ends + np.float32(0.1))
    path = tmp_path / "problems.npz"
    monkeypatch.setattr(drl_problems, "draw", lambda *_: drl_problems.Problems(one, one, one))
    drl_problems.problems(cell, path)
    monkeypatch.setattr(drl_problems, "draw", None)
    found = drl_problems.problems(cell, path)
    np.testing.assert_array_equal(found.held_out.goal, ends + np.float32(0.1))
    with pytest.raises(RunFolderError, match="'training': 100.*not of"):
        drl_problems.problems(cell, path, drl_problems.TINY)


TINY = [
    path.stem
    for path in sorted((ROOT / "benchmarks").glob("*.py"))
    if re.search(r"def main\([^)]*tiny: bool = False", path.read_text())
]
"""Benchmarks by themselves; their parts take `tiny` too."""


def test_what_writes_figures_can_be_tried():
    writing = {
        path.stem
        for path in (ROOT / "benchmarks").glob("*.py")
        if re.search(r"def main\([^)]*json: Path", path.read_text())
    }
    assert writing == set(TINY)


@pytest.mark.tiny
@pytest.mark.parametrize("name", TINY)
def test_each_benchmark_runs_to_its_end(name, tmp_path):
    if name == "newcomer" and not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("it presses buttons in Chromium, which is absent")
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", "--tiny", "--json", str(tmp_path / "a.json")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    if "nothing to run" in done.stdout:
        pytest.skip(done.stdout)
    assert json.loads((tmp_path / "a.json").read_text())["metrics"]
