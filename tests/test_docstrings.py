# SPDX-License-Identifier: MIT
"""Every public name says what it is, in which shapes and units, and what it raises."""

import ast
import inspect
import re
import textwrap

import pytest

import hybrid_jax

FUNCTIONS = [
    n
    for n in hybrid_jax.__all__
    if inspect.isroutine(getattr(hybrid_jax, n)) or not inspect.isclass(getattr(hybrid_jax, n))
]
CLASSES = [n for n in hybrid_jax.__all__ if n not in FUNCTIONS]
ARRAYS = ("Float[", "ndarray", "Array", "FeasibilityMap", "Task", "IkResult", "SkillLibrary")
"""Annotations of arguments and results whose shape must be said."""
SILENT = {"use_all_cores", "plan_motion", "plan_batch", "plan_joint_motion"}
"""Functions that raise nothing on purpose; their docstrings say so."""


def sections(text: str) -> dict[str, str]:
    """Parts of a docstring by heading; "" is what stands before."""
    parts = re.split(r"^(Args|Returns|Raises|Yields):\n", text, flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries(section: str) -> dict[str, str]:
    """Names of a section of arguments, with what is said about each."""
    found = re.findall(r"^    (\w[\w, ]*): (.*(?:\n {8}.*)*)", section, flags=re.MULTILINE)
    return {name: text for names, text in found for name in names.split(", ")}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented(name):
    function = inspect.unwrap(getattr(hybrid_jax, name))
    parts = sections(inspect.getdoc(function) or "")
    assert parts[""].strip(), "no sentence"
    signature = inspect.signature(function)
    told = entries(parts.get("Args", ""))
    assert set(told) == set(signature.parameters), "arguments that are not there, or not told"
    for argument, parameter in signature.parameters.items():
        kind = str(parameter.annotation)
        if "Float[" in kind or kind.endswith("ndarray'>"):
            assert re.search(r"`\[.*?\]`", told[argument]), f"{argument}: its shape is not said"
    returned = str(signature.return_annotation)
    if signature.return_annotation is not None:
        assert parts.get("Returns", "").strip(), "what it returns is not said"
    if any(kind in returned for kind in ARRAYS):
        assert re.search(r"`\[.*?\]`", parts["Returns"]), "the shape of the result is not said"
    assert "Raises" in parts or name in SILENT, "what it raises is not said"
    if name in SILENT:
        assert re.search(r"raises? |raised|see `plan_motion`", " ".join(parts.values()))


@pytest.mark.parametrize("name", CLASSES)
def test_classes_and_their_fields_are_documented(name):
    kind = getattr(hybrid_jax, name)
    assert (inspect.getdoc(kind) or "").strip()
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body
    for node in body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{name}.{node.name} is not documented"
    if not hasattr(kind, "__dataclass_fields__"):
        return
    for number, node in enumerate(body):
        if isinstance(node, ast.AnnAssign):
            after = body[number + 1] if number + 1 < len(body) else None
            told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            assert told, f"{name}.{node.target.id} is not documented"


def test_every_module_and_public_function_has_a_docstring():
    from pathlib import Path

    package = Path(hybrid_jax.__file__).parent
    bare = []
    for path in package.rglob("*.py"):
        tree = ast.parse(path.read_text())
        if tree.body and not ast.get_docstring(tree):
            bare.append(str(path.relative_to(package)))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                if not ast.get_docstring(node):
                    bare.append(f"{path.relative_to(package)}:{node.name}")
    assert bare == []
