# SPDX-License-Identifier: MIT
"""Figures of the package's source: sizes, comments, names, and shapes in docstrings.

    python -m benchmarks.readability --json FILE

Nothing is imported or run: the source is parsed.
"""

import ast
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import tyro

from benchmarks.report import metric, write

PACKAGE = Path(__file__).resolve().parent.parent / "hybrid_jax"
VAGUE = frozenset(
    """ahead alike all any apart away back beyond big both few found given here how it kept known
    largest last left less little long many more most much near new next none now old on one ones
    only other others out over own part parts plain ready rest right same seen short single small
    some such taken that then there thing things this told under wanted what where which whole
    why""".split()
)
"""Words that name no quantity when they stand alone."""
ARRAYS = re.compile(r"\b(Array|ndarray|Float\[|Int\[|Bool\[|Shaped\[)")
"""Annotations of arrays."""
SHAPE = re.compile(r"`\[[^`]*\]`")
"""A shape in a docstring: `[point, 7]`, or `[]` for a number."""
ROOT_MODULES = {"__init__.py"}
"""Files of the package's root that are no modules of their own."""


def bound_names(tree: ast.AST) -> Iterator[str]:
    """Every name that is bound: arguments, assignments, loops, comprehensions, `with ... as`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def comment_count(path: Path) -> int:
    """Comments of a file, without its licence and without marks for tools."""
    with path.open("rb") as file:
        texts = [t.string for t in tokenize.tokenize(file.readline) if t.type == tokenize.COMMENT]
    marks = ("# SPDX", "# noqa", "# type:", "#!")
    return sum(not text.startswith(marks) for text in texts)


def code_lines(path: Path) -> int:
    """Lines that are neither empty nor part of a docstring or comment."""
    kinds = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    lines: set[int] = set()
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in kinds | {tokenize.ENCODING, tokenize.ENDMARKER}:
                lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def functions(tree: ast.Module) -> list[ast.FunctionDef]:
    """Functions and methods of a module, nested ones too."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def public_functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Public functions of a module, and public methods of its public classes."""
    for node in tree.body:
        inner = node.body if isinstance(node, ast.ClassDef) and node.name[0] != "_" else [node]
        for item in inner:
            if isinstance(item, ast.FunctionDef) and not item.name.startswith("_"):
                yield item


def has_arrays(function: ast.FunctionDef) -> bool:
    """Is an argument or the result annotated as an array?"""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    # a random key has no shape to state
    annotations = [a.annotation for a in arguments if a.arg != "key"] + [function.returns]
    return any(ARRAYS.search(ast.unparse(a)) for a in annotations if a)


def main(json: Path | None = None, tiny: bool = False, list_names: bool = False) -> None:
    """Measure.

    Args:
        json: file to write the figures to.
        tiny: accepted like in all benchmarks; this one takes seconds.
        list_names: print the vague names, and the functions that state no shape, with their files.
    """
    del tiny
    paths = [p for p in sorted(PACKAGE.rglob("*.py")) if "_robots" not in p.parts]
    trees = {path: ast.parse(path.read_text()) for path in paths}
    names = [(name, path) for path, tree in trees.items() for name in bound_names(tree)]
    vague = [(name, path) for name, path in names if name.strip("_") in VAGUE]
    arrayed = [(f, p) for p, t in trees.items() for f in public_functions(t) if has_arrays(f)]
    silent = [(f, p) for f, p in arrayed if not SHAPE.search(ast.get_docstring(f) or "")]
    if list_names:
        for name, count in Counter((n, p.relative_to(PACKAGE)) for n, p in vague).most_common():
            print(f"{count:4d}  {name[0]:10s} {name[1]}")
        for function, path in silent:
            print(f"no shape: {path.relative_to(PACKAGE)}:{function.lineno} {function.name}")
    sizes = {path: len(path.read_text().splitlines()) for path in paths}
    longest = max(
        ((f.end_lineno or 0) - f.lineno + 1, f"{path.relative_to(PACKAGE)}: {f.name}")
        for path, tree in trees.items()
        for f in functions(tree)
    )
    largest = max(sizes, key=sizes.__getitem__)
    comments, lines = sum(map(comment_count, paths)), sum(map(code_lines, paths))
    roots = {path.name for path in PACKAGE.glob("*.py")} - ROOT_MODULES
    rows = [
        metric("readability.root_modules", len(roots), "", "lower", ", ".join(sorted(roots))),
        metric("readability.longest_function", longest[0], "", "lower", f"lines; {longest[1]}"),
        metric(
            "readability.longest_module",
            sizes[largest],
            "",
            "lower",
            f"lines; {largest.relative_to(PACKAGE)}, of {len(paths)} files",
        ),
        metric(
            "readability.comments",
            100 * comments / lines,
            "",
            "higher",
            f"in 100 lines of code; {comments} comments in {lines} lines, docstrings not counted",
        ),
        metric(
            "readability.vague_names",
            len(vague) / len(names),
            "1",
            "lower",
            f"{len(vague)} of {len(names)} bound names are of {len(VAGUE)} words like 'found'",
        ),
        metric(
            "readability.silent_shapes",
            len(silent),
            "",
            "lower",
            f"public functions with arrays whose docstring states no shape, of {len(arrayed)}",
        ),
    ]
    write(rows, json, {})


if __name__ == "__main__":
    tyro.cli(main)
