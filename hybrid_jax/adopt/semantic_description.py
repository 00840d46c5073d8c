# SPDX-License-Identifier: MIT
"""SRDF, the semantic description that MoveIt's setup assistant writes: groups, ignored pairs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from hybrid_jax.errors import UnknownNameError, WorkcellError


@dataclass(frozen=True)
class Group:
    """A planning group: what it consists of, each by its name."""

    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()
    chains: tuple[tuple[str, str], ...] = ()
    """First and last link of each chain; the joints after the first one count."""
    groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class SemanticDescription:
    """What an SRDF says that a robot's file does not."""

    disabled: tuple[tuple[str, str], ...] = ()
    """Pairs of links that need not be kept apart."""
    groups: Mapping[str, Group] = field(default_factory=dict)
    """Groups by their names."""

    def group(self, name: str) -> Group:
        """A group with all that the groups in it consist of.

        Raises:
            UnknownNameError: no such group.
        """
        pending, seen = [name], []
        while pending:
            asked = pending.pop()
            if asked not in self.groups:
                raise UnknownNameError("group of the SRDF", asked, self.groups)
            if asked not in seen:
                seen.append(asked)
                pending += self.groups[asked].groups
        parts = [self.groups[each] for each in seen]
        return Group(
            joints=tuple(j for part in parts for j in part.joints),
            links=tuple(link for part in parts for link in part.links),
            chains=tuple(c for part in parts for c in part.chains),
        )


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
    groups = {element.get("name", ""): _group(element) for element in robot.findall("group")}
    return SemanticDescription(tuple(disabled), groups)


def _group(element: ElementTree.Element) -> Group:
    names = lambda kind: tuple(e.get("name", "") for e in element.findall(kind))  # noqa: E731
    ends = [(e.get("base_link", ""), e.get("tip_link", "")) for e in element.findall("chain")]
    return Group(names("joint"), names("link"), tuple(ends), names("group"))
