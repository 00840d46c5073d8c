# SPDX-License-Identifier: MIT
"""Frozen records from the tables of a TOML file.

Each field must have the type and the range of its annotation; a message names the one that has not.
"""

from dataclasses import fields
from typing import Annotated, NamedTuple, get_args, get_origin, get_type_hints

from hybrid_jax.errors import UnknownNameError, WorkcellError, shortened
from hybrid_jax.runtime.typed_values import as_tuples, fits, in_words


class Within(NamedTuple):
    """Range in which the number of a field lies, or each of its numbers."""

    low: float
    """Smallest number that is allowed."""
    high: float
    """Largest number that is allowed."""


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
    arguments = {k: as_tuples(v) for k, v in values.items()}
    try:
        instance = kind(**arguments)
    except TypeError as error:
        names = ", ".join(field.name for field in fields(kind))
        raise WorkcellError(f"{label}: {error}; the fields are: {names}") from None
    hints = get_type_hints(kind, include_extras=True)
    for name in (field.name for field in fields(kind)):
        value, annotation, limits = getattr(instance, name), hints[name], None
        if get_origin(annotation) is Annotated:
            annotation, limits = get_args(annotation)
        message = f"{label}: {name} is {shortened(repr(value))}; it must be {in_words(annotation)}"
        if not fits(value, annotation):
            raise WorkcellError(message)
        if limits and not all(limits.low <= number <= limits.high for number in _numbers(value)):
            raise WorkcellError(f"{message} from {limits.low:g} to {limits.high:g}")
    return instance


def _numbers(value) -> list[float]:
    """All numbers of a value, which may be a tuple of tuples."""
    return [n for v in value for n in _numbers(v)] if isinstance(value, tuple) else [value]


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
