# SPDX-License-Identifier: MIT
"""Tables of a TOML file as frozen records: each field of the type and range that it is annotated
with, or named."""

import math
from typing import Annotated, NamedTuple, get_args, get_origin, get_type_hints

from hybrid_jax.errors import WorkcellError, shortened

LARGEST = 1e300
"""A number beyond which nothing can be computed."""


class Within(NamedTuple):
    """A field's numbers, all of them where there are several, lie within a range."""

    low: float
    high: float


def _fixed(value):
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def record(kind, values: dict, where: str):
    """A frozen record of a TOML table; lists become tuples.

    Args:
        kind: frozen dataclass; `Annotated[..., Within(low, high)]` fields keep a range.
        values: the table.
        where: what messages call it.

    Raises:
        WorkcellError: it is no table, or a field is missing, unknown, of another type or out of
            its range.
    """
    if not isinstance(values, dict):
        raise WorkcellError(f"{where} must be a table, got {values!r}")
    fixed = {k: _fixed(v) for k, v in values.items()}
    try:
        found = kind(**fixed)
    except TypeError as error:
        fields = ", ".join(kind.__dataclass_fields__)
        raise WorkcellError(f"{where}: {error}; the fields are: {fields}") from None
    hints = get_type_hints(kind, include_extras=True).items()
    ranges = {name: hint.__metadata__[0] for name, hint in hints if get_origin(hint) is Annotated}
    for name, wanted in get_type_hints(kind).items():
        value, limits = getattr(found, name), ranges.get(name)
        said = f"{where}: {name} is {shortened(repr(value))}; it must be {_in_words(wanted)}"
        if not _fits(value, wanted):
            raise WorkcellError(said)
        if limits and not all(limits.low <= number <= limits.high for number in _numbers(value)):
            raise WorkcellError(f"{said} from {limits.low:g} to {limits.high:g}")
    return found


def _numbers(value) -> list[float]:
    """All numbers in a value or in the lists of a value."""
    return [n for v in value for n in _numbers(v)] if isinstance(value, tuple) else [value]


def _fits(value, wanted) -> bool:
    """Is a value of a TOML file what a field is annotated with?"""
    inner = get_args(wanted)
    if get_origin(wanted) is tuple:
        if not isinstance(value, tuple):
            return False
        if inner[-1] is Ellipsis:
            return all(_fits(v, inner[0]) for v in value)
        return len(value) == len(inner) and all(map(_fits, value, inner))
    if inner:  # a union
        return any(_fits(value, one) for one in inner)
    if wanted is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        # an integer may be too large for any float
        return number and abs(value) <= LARGEST and math.isfinite(value)
    return isinstance(value, wanted) and not (wanted is int and isinstance(value, bool))


def _in_words(wanted) -> str:
    words = {float: "a finite number", str: "text", int: "a whole number"}
    if get_origin(wanted) is not tuple:
        return words.get(wanted, str(wanted))
    inner = get_args(wanted)
    if inner[-1] is Ellipsis:
        return f"a list, each item {_in_words(inner[0])}"
    return f"a list of {len(inner)}, each item {_in_words(inner[0])}"


def records(kind, tables: list[dict], where: str) -> tuple:
    """One record of each table of a list.

    Args:
        kind: frozen dataclass.
        tables: as TOML gives them.
        where: what messages call the list.

    Raises:
        WorkcellError: it is no list, or a table is no such record.
    """
    if not isinstance(tables, list):
        raise WorkcellError(f"{where} must be a list of tables, got {tables!r}")
    return tuple(record(kind, table, where) for table in tables)
