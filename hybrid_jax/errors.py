# SPDX-License-Identifier: MIT
"""What can go wrong on the host. Messages name the offender and what would be right."""

LONGEST = 300
"""Characters of a value that a message repeats."""


def shortened(text: str) -> str:
    """A value for a message: an endless one is cut."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... ({len(text):,} characters)"


class HybridJaxError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(HybridJaxError, ValueError):
    """An argument that is no configuration or no pose: the message names the offending index."""


class UnknownNameError(HybridJaxError):
    """A name that is not in a list of names."""

    def __init__(self, kind: str, name: object, known):
        listed = ", ".join(sorted(map(str, known))) or "none"
        super().__init__(f"unknown {kind} {shortened(repr(str(name)))}; there are: {listed}")


class WorkcellError(HybridJaxError):
    """A work cell that cannot be planned in: the message names the geom, joint or body."""


class DeviceError(HybridJaxError):
    """JAX has no device of the kind that was asked for."""


class RunFolderError(HybridJaxError):
    """A run folder that is incomplete, damaged or belongs to another cell."""


class DemonstrationError(HybridJaxError, ValueError):
    """A recording that no skill can be made of: the message names the row and what is wrong."""


class SegmentError(HybridJaxError, ValueError):
    """A segment that no motion can bridge: the message names its end and what is wrong there."""


class TaskError(HybridJaxError):
    """A task file or task that the cell cannot understand."""


class TrainingError(HybridJaxError):
    """A training that diverged: the message names the step and the quantity that broke."""


class MapError(HybridJaxError):
    """A feasibility map that cannot be built as asked."""
