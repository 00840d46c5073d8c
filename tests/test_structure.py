# SPDX-License-Identifier: MIT
"""The public names resolve, and imports go one way."""

import ast
import re
from itertools import pairwise
from pathlib import Path

import pytest

import hybrid_jax
from hybrid_jax.workcell.assets import robots_folder, workcell_names

PACKAGE = Path(hybrid_jax.__file__).parent
LAYERS = (
    {"errors"},
    {"runtime"},
    {"types"},
    {"kernels"},
    {"ik"},
    {"workcell"},
    {"mjx"},
    {"tasks"},
    {"demonstrations"},
    {"skills"},
    {"feasibility"},
    {"contracts"},
    {"envs"},
    {"agents", "planner", "execution"},
    {"reports"},
    {"runs"},
    {"baselines"},
    {"studies", "export", "web"},
    {"teach", "view", "serve", "adopt"},
    {"train", "plan", "evaluate", "check", "demos", "warm"},
)
"""Folders and modules of the package from the lowest up; one imports what stands below it only."""
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
SOURCES = [path for path in PACKAGE.rglob("*.py") if "_robots" not in path.parts]


def imports_of(path: Path) -> list[str]:
    """Modules that a file imports anywhere in it, with their full names."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    froms = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    names = [f"{node.module}.{alias.name}" for node in froms for alias in node.names]
    return names + [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]


def part_of(path: Path) -> str:
    """Folder or module of the package's root that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("name", hybrid_jax.__all__)
def test_public_names_resolve(name):
    assert getattr(hybrid_jax, name) is not None


def test_every_part_has_its_layer():
    assert {part_of(path) for path in SOURCES} - {"__init__"} == set(LEVEL)


def test_the_root_holds_little():
    assert len(list(PACKAGE.glob("*.py"))) <= 10 + 1  # and __init__


@pytest.mark.parametrize("part", sorted(LEVEL))
def test_imports_go_one_way(part):
    for path in SOURCES:
        if part_of(path) != part:
            continue
        for name in imports_of(path):
            first, *rest = name.split(".")
            if first != "hybrid_jax" or not rest or rest[0] == part or rest[0] not in LEVEL:
                continue
            assert LEVEL[rest[0]] < LEVEL[part], f"{path.relative_to(PACKAGE)} imports {name}"


def test_modules_do_not_import_one_another_in_a_circle():
    modules = {".".join(p.relative_to(PACKAGE.parent).with_suffix("").parts): p for p in SOURCES}
    needs = {
        name: {m for i in imports_of(path) for m in (i, i.rpartition(".")[0]) if m in modules}
        for name, path in modules.items()
    }
    while leaves := [name for name, wanted in needs.items() if not wanted & set(needs) - {name}]:
        for name in leaves:
            del needs[name]
    assert not needs, f"a circle among {sorted(needs)}"


@pytest.mark.parametrize("folder", ["kernels", "contracts.py"])
def test_what_must_not_know_mujoco_does_not(folder):
    place = PACKAGE / folder
    for path in [place] if place.suffix else place.rglob("*.py"):
        assert not any(name.split(".")[0] == "mujoco" for name in imports_of(path))


def test_layers_are_named_once():
    assert all(not a & b for a, b in pairwise(LAYERS)) and len(LEVEL) == sum(map(len, LAYERS))


def test_package_names_neither_cell_nor_robot():
    """Nothing in the package is made for one of them: what differs stands in `robots`."""
    folders = {path.name for path in robots_folder().iterdir() if path.is_dir()}
    words = set(workcell_names()) | {"gen3", "2f85", "robotiq", "kinova", "fanuc", "lrmate", "fpi"}
    words |= folders - {"workcells", "demonstrations", "inspection_brush"}
    pattern = re.compile("|".join(map(re.escape, words)), re.IGNORECASE)
    package = Path(hybrid_jax.__file__).parent
    found = [
        f"{path.name}:{number}: {line.strip()}"
        for path in package.rglob("*.py")
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if pattern.search(line.replace("fanuc_tp", ""))  # a format has its vendor's name
    ]
    assert found == []


def defined(body: list[ast.stmt]) -> dict[str, list[ast.stmt]]:
    """Names that statements define, each with the body of the class that it is."""
    names = {}
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names[node.name] = node.body if isinstance(node, ast.ClassDef) else []
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = getattr(node, "targets", None) or [node.target]
            found = [n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
            names |= {n.id: [] for n in found}
    return names


def resolves(name: str) -> bool:
    """Is there a folder, module, function, class or field of this dotted name in the package?"""
    place, parts = PACKAGE, name.split(".")
    while parts and (place / parts[0]).is_dir():
        place /= parts.pop(0)
    file = place / f"{parts[0]}.py" if parts else place
    if not parts or not file.is_file():
        return not parts
    body = ast.parse(file.read_text()).body
    for part in parts[1:]:
        names = defined(body)
        if part not in names:
            return False
        body = names[part]
    return True


@pytest.mark.parametrize("page", sorted(PACKAGE.parent.glob("docs/*.md")), ids=lambda p: p.stem)
def test_names_in_the_documents_exist(page):
    names = re.findall(r"`(?:hybrid_jax\.)?([a-z_]+(?:\.[A-Za-z_0-9]+)+)(?=[`(])", page.read_text())
    files = {"py", "md", "json", "jsonl", "npz", "toml", "xml", "csv", "mp4", "png", "gif", "txt"}
    ours = {n for n in names if n.split(".")[0] in LEVEL and n.split(".")[-1] not in files}
    results = "".join(path.read_text() for path in PACKAGE.parent.glob("docs/figures/*.json"))
    figures = {name for name in ours if f'"{name}"' in results}
    assert not {name for name in ours - figures if not resolves(name)}
