# SPDX-License-Identifier: MIT
"""Commands and snippets of README and docs are run, on small runs; names and links hold.

What a line is run as, `variant` says: trainings use preset `smoke`. Of benchmarks, studies and
servers the options are looked up in their `--help`; test_study.py, test_command_line.py,
test_view.py, test_teach.py, test_serve.py and test_warm.py run them. Python snippets are run as
they are printed.
"""

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import tyro
from arms import bare_arm

from hybrid_jax import check, demos, plan, train
from hybrid_jax.adopt import __main__ as adopt_command
from hybrid_jax.export import __main__ as export_command

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMANDS = {
    "train": train.main,
    "plan": plan.main,
    "adopt": adopt_command.main,
    "check": check.main,
    "export": export_command.main,
    "demos": demos.COMMANDS,
}
CELL = """<mujoco><size nuser_jnt="2"/><worldbody><body name="arm" pos="0 0 .2">
<joint name="a" axis="0 0 1" range="-170 170" user="2 5"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/><site name="tool" pos=".3 0 0"/>
</body></worldbody></mujoco>"""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of the fenced blocks of a page."""
    fence = r"^```(\w*)\n(.*?)^```$"
    return re.findall(fence, page.read_text(), flags=re.MULTILINE | re.DOTALL)


def lines_of(language: str) -> list[tuple[str, str]]:
    """Page and line of all blocks in a language, each line once."""
    found = [
        (page.name, line.split("  #")[0].strip())
        for page in PAGES
        for kind, text in blocks(page)
        if kind == language
        for line in text.splitlines()
        if line.strip() and not line.startswith("#")
    ]
    return list({line: (page, line) for page, line in found}.values())


@pytest.fixture(scope="module")
def workspace(smoke_run, tmp_path_factory):
    """A folder as a reader has it: runs, a recording, a cell of one's own."""
    folder = tmp_path_factory.mktemp("reader")
    shutil.copytree(smoke_run, folder / "runs" / "gen3_handling-001")
    page = ROOT / "docs" / "own_demonstration.md"
    recording = next(text for kind, text in blocks(page) if kind == "csv")
    (folder / "recording.csv").write_text(recording)
    poses = np.zeros((60, 7))
    poses[:, 0], poses[:, 3] = np.linspace(0, 20, 60), 1.0
    np.savez(folder / "log.npz", poses=poses)
    (folder / "my_cell.xml").write_text(CELL)
    bare_arm(folder / "my_arm.xml")
    page = ROOT / "docs" / "own_arm.md"
    around = next(text for kind, text in blocks(page) if kind == "toml")
    (folder / "around.toml").write_text(around)
    before = Path.cwd()
    os.chdir(folder)
    yield folder
    os.chdir(before)


def run_module(arguments: list[str]) -> int:
    """Run one of our commands in this process; its exit code."""
    name, *rest = arguments
    if name == "train":  # its options are not all known before the preset is
        return train.command(rest)
    command = COMMANDS[name]
    if isinstance(command, dict):
        return tyro.extras.subcommand_cli_from_dict(command, args=rest)
    return tyro.cli(command, args=rest)


def variant(arguments: list[str]) -> list[str]:
    """The same command on less work."""
    name, *rest = arguments
    if name == "train" and "--resume" not in rest:
        options = {word.partition(".")[0] for word in rest}
        short = {"--workcell", "--skills", "--tensorboard", "--map", "--config"}
        stages = ["map"] if short & options else []
        out = f"other-{abs(hash(tuple(rest)))}"  # --resume takes the newest run of `runs`
        return [name, *stages, *rest, "--out", out, "--preset", "smoke", "--quiet"]
    if name == "check" and "--tasks" in rest:
        return [name, rest[0]]  # the cell of this test has no tasks
    if name == "demos" and "bag_folder" in rest:
        return []  # no bag is at hand; tests/test_demonstrations.py reads one
    return arguments


def lacks_run(arguments: list[str]) -> bool:
    """Does a command need the run of another cell, which this test does not train?"""
    return bool({f"runs/{name}-001" for name in ("fpi", "my_cell", "picking")} & set(arguments))


SHELL = lines_of("sh")


@pytest.mark.parametrize("page, line", SHELL, ids=[line[:70] for _, line in SHELL])
def test_commands(workspace, page, line):
    words = shlex.split(line)
    words = words[1:] if words[0] == "python" else words
    if words[0] == "make":
        targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
        assert words[1] in targets
        return
    if words[0] == "pip":
        extras = re.findall(r"\[([\w,]+)\]", line)[0].split(",")
        known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        assert set(extras) <= set(known["optional-dependencies"])
        return
    if words[0] == "echo":
        assert subprocess.run(line, shell=True, cwd=workspace).returncode == 0
        return
    if words[0].endswith("python"):
        words = words[1:]
    assert words[0] == "-m", f"{page}: a command that this test does not know"
    module, rest = words[1], words[2:]
    package, _, name = module.partition(".")
    looked_up = name in ("view", "teach", "evaluate", "serve", "warm") or "--server" in rest
    if package == "benchmarks" or looked_up or lacks_run(rest):
        done = subprocess.run(
            [sys.executable, "-m", module, "--help"], cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        options = {word for word in rest if word.startswith("--")}
        assert all(option in done.stdout for option in options), f"{page}: {line}"
        return
    arguments = variant([name, *rest])
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        code = run_module(arguments) if arguments else 0
    assert code == 0 or (name, code) == ("plan", 1), f"{page}: {line}"
    if "--json" in rest and name in ("check", "train") or line.endswith("list --json"):
        assert json.loads(out.getvalue())


SNIPPETS = [(page.name, text) for page in PAGES for kind, text in blocks(page) if kind == "python"]


@pytest.mark.parametrize(
    "page, text", SNIPPETS, ids=[f"{page}-{i}" for i, (page, _) in enumerate(SNIPPETS)]
)
def test_python(workspace, page, text):
    """As it is printed; where it builds a large map, a small one."""
    if "stablehlo" in text:
        run_module(["export", "--run", "runs/gen3_handling-001", "--out", "policy.stablehlo"])
    if "orientations=512" in text:
        text = text.replace("orientations=512", "orientations=2").replace("0.05,", "0.3,")
    with redirect_stdout(io.StringIO()):
        exec(compile(text, page, "exec"), {"__name__": "__main__"})


def test_the_example_has_eight_lines():
    first = next(text for page, text in SNIPPETS if page == "README.md")
    assert len(first.strip().splitlines()) == 8


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_data_and_links(page):
    for kind, text in blocks(page):
        if kind == "json":
            json.loads(text)
        if kind == "toml":
            tomllib.loads(text)
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} points to {target}"


def test_every_public_name_stands_in_the_reference():
    import hybrid_jax

    text = (ROOT / "docs" / "api.md").read_text()
    listed = re.findall(r"^::: hybrid_jax\.([\w.]+)\.(\w+)$", text, flags=re.MULTILINE)
    assert {name: module for module, name in listed} == hybrid_jax._EXPORTS


def test_every_page_is_in_the_site():
    text = (ROOT / "mkdocs.yml").read_text()
    assert {page.name for page in PAGES[1:]} == set(re.findall(r"(\w+\.md)$", text, re.MULTILINE))
