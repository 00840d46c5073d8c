# SPDX-License-Identifier: MIT
"""SRDF, the semantic description that MoveIt's setup assistant writes: groups, ignored pairs."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from hybrid_jax.errors import UnknownNameError, WorkcellError


@dataclass(frozen=True)
class SemanticDescription:
    """What an SRDF says that a robot's file does not."""

    disabled: tuple[tuple[str, str], ...] = ()
    """Pairs of links that need not be kept apart."""
    tips: tuple[tuple[str, str], ...] = ()
    """Names of the groups that are chains, and the last link of each."""

    def tip(self, group: str) -> str:
        """The last link of a group.

        Raises:
            UnknownNameError: no such chain.
        """
        tips = dict(self.tips)
        if group not in tips:
            raise UnknownNameError("group that is a chain", group, tips)
        return tips[group]


def read_srdf(path: Path) -> SemanticDescription:
    """Read an SRDF.

    Raises:
        WorkcellError: the file is no XML.
    """
    try:
        robot = ElementTree.fromstring(path.read_bytes())
    except (OSError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise WorkcellError(f"{path.name} is no SRDF: {error}") from None
    disabled = [(e.get("link1", ""), e.get("link2", "")) for e in robot.iter("disable_collisions")]
    chains = [
        (group.get("name", ""), chain.get("tip_link", ""))
        for group in robot.findall("group")
        for chain in group.findall("chain")
    ]
    return SemanticDescription(tuple(disabled), tuple(chains))
