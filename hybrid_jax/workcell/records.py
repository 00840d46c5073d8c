# SPDX-License-Identifier: MIT
"""Frozen records from the tables of a TOML file.

Each field must have the type and the range of its annotation; a message names the one that has not.
"""

import math
from typing import Annotated, NamedTuple, get_args, get_origin, get_type_hints

from hybrid_jax.errors import UnknownNameError, WorkcellError, shortened

LARGEST = 1e300
"""Largest number that is accepted: beyond it nothing can be computed."""


class Within(NamedTuple):
    """Range in which the number of a field lies, or each of its numbers."""

    low: float
    """Smallest number that is allowed."""
    high: float
    """Largest number that is allowed."""


def _fixed(value):
    """A value of a TOML file with its lists, at any depth, as tuples."""
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def record(kind, values: dict, label: str):
    """A frozen record of a TOML table; lists become tuples.

    Args:
        kind: frozen dataclass; `Annotated[..., Within(low, high)]` fields keep a range.
        values: the table.
        label: what messages call the table.

    Raises:
        WorkcellError: `values` is no table, or a field is missing, unknown, of another type or
            out of its range.
    """
    if not isinstance(values, dict):
        raise WorkcellError(f"{label} must be a table, got {values!r}")
    arguments = {k: _fixed(v) for k, v in values.items()}
    try:
        instance = kind(**arguments)
    except TypeError as error:
        fields = ", ".join(kind.__dataclass_fields__)
        raise WorkcellError(f"{label}: {error}; the fields are: {fields}") from None
    hints = get_type_hints(kind, include_extras=True).items()
    ranges = {name: hint.__metadata__[0] for name, hint in hints if get_origin(hint) is Annotated}
    for name, annotation in get_type_hints(kind).items():
        value, limits = getattr(instance, name), ranges.get(name)
        message = f"{label}: {name} is {shortened(repr(value))}; it must be {_in_words(annotation)}"
        if not _fits(value, annotation):
            raise WorkcellError(message)
        if limits and not all(limits.low <= number <= limits.high for number in _numbers(value)):
            raise WorkcellError(f"{message} from {limits.low:g} to {limits.high:g}")
    return instance


def _numbers(value) -> list[float]:
    """All numbers of a value, which may be a tuple of tuples."""
    return [n for v in value for n in _numbers(v)] if isinstance(value, tuple) else [value]


def _fits(value, annotation) -> bool:
    """Is a value of a TOML file what a field is annotated with?"""
    inner = get_args(annotation)
    if get_origin(annotation) is tuple:
        if not isinstance(value, tuple):
            return False
        if inner[-1] is Ellipsis:
            return all(_fits(v, inner[0]) for v in value)
        return len(value) == len(inner) and all(map(_fits, value, inner))
    if inner:  # a union
        return any(_fits(value, member) for member in inner)
    if annotation is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        # an integer may be too large for any float
        return number and abs(value) <= LARGEST and math.isfinite(value)
    # `bool` is a subclass of `int`, yet true is no number
    return isinstance(value, annotation) and not (annotation is int and isinstance(value, bool))


def _in_words(annotation) -> str:
    """What a field must be, for a message."""
    words = {float: "a finite number", str: "text", int: "a whole number"}
    if get_origin(annotation) is not tuple:
        return words.get(annotation, str(annotation))
    inner = get_args(annotation)
    if inner[-1] is Ellipsis:
        return f"a list, each item {_in_words(inner[0])}"
    return f"a list of {len(inner)}, each item {_in_words(inner[0])}"


def records(kind, tables: list[dict], label: str) -> tuple:
    """Frozen records of a list of TOML tables, one of each.

    Args:
        kind: frozen dataclass.
        tables: as TOML gives them.
        label: what messages call the list.

    Raises:
        WorkcellError: `tables` is no list, or a table is no such record.
    """
    if not isinstance(tables, list):
        raise WorkcellError(f"{label} must be a list of tables, got {tables!r}")
    return tuple(record(kind, table, label) for table in tables)


def by_name(what: str, name: str, specs):
    """The record of that name.

    Args:
        what: what the records are, for the message.
        name: the one that is asked for.
        specs: records with a `name`.

    Raises:
        UnknownNameError: there is none of that name.
    """
    for spec in specs:
        if spec.name == name:
            return spec
    raise UnknownNameError(what, name, [spec.name for spec in specs])
