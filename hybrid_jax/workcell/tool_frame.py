# SPDX-License-Identifier: MIT
"""The frame of a model that is the tool: by the name given, by a usual name, or the arm's end.

Nothing is guessed: where several frames could be meant, the message lists them.
"""

import re

import mujoco

from hybrid_jax.errors import UnknownNameError, WorkcellError

TOOL = "tool"
"""Name of the site that is added where a link is found to be the tool."""
USUAL = ("tool", "tcp", "tool0", "grasp_site", "pinch", "attachment_site")
"""Usual names of tool frames; the first that a model has counts."""
_LIKE = re.compile(
    "tcp|tool_?cent|tool0|pinch|grasp|attachment|end_?eff|eef|ee_?(site|link)$|wrist_?site"
)
"""What the names that vendors give to tool frames contain."""
_FINGER = re.compile(r"finger|jaw|knuckle|thumb|gripper")
"""What the names of links and joints of a gripper contain."""


def _pick(names: list[str], kind: str) -> str | None:
    """The name that is a tool's among some names; None if there is none.

    Raises:
        WorkcellError: there are several.
    """
    for usual in USUAL:
        if usual in names:
            return usual
    candidates = [name for name in names if _LIKE.search(name.lower())]
    if len(candidates) > 1:
        raise WorkcellError(_ambiguous(kind, candidates))
    return candidates[0] if candidates else None


def _ambiguous(kind: str, names: list[str]) -> str:
    return f"several {kind} could be the tool: {', '.join(names)}; name one with --tool NAME"


def usual_site(sites: list[str]) -> str:
    """The site of a model that is its tool, by its name.

    Raises:
        WorkcellError: no name is that of a tool, or several are.
    """
    site = _pick([name for name in sites if name], "sites")
    if site is None:
        raise WorkcellError(
            "the model has no tool frame: add a site named 'tool' to the last link, or name a "
            f"site or body with --tool NAME (sites: {', '.join(filter(None, sites)) or 'none'})"
        )
    return site


def set_tool(spec: mujoco.MjSpec, name: str) -> None:
    """Make sure that a model has a site for its tool: one is added where a link is the tool.

    Args:
        spec: of the model; a site is added where the tool is a body.
        name: of a site or body; "" to find one, as a URDF asks for, which has no sites.

    Raises:
        UnknownNameError: no such site or body.
        WorkcellError: nothing tells which frame is the tool; the message lists candidates.
    """
    sites = [site.name for site in spec.sites if site.name]
    bodies = {body.name: body for body in spec.bodies if body.name and body.name != "world"}
    tool = name or _pick(sites, "sites")
    if tool in sites:
        return
    if name and name not in bodies:
        raise UnknownNameError("site or link for the tool", name, [*sites, *bodies])
    link = name or _pick(list(bodies), "links") or _arm_end(spec)
    # a link that was named keeps its name: the model may have a site named `TOOL` already
    bodies[link].add_site(name=name or TOOL)


def _coupled(spec: mujoco.MjSpec) -> set[str]:
    """Names of joints that follow another one, and of those that they follow: a gripper's."""
    coupled = [e for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_JOINT]
    return {name for e in coupled for name in (e.name1, e.name2) if name}


def _is_finger(body, coupled: set[str]) -> bool:
    """Is a body moved by a gripper?"""
    names = [body.name, *(joint.name for joint in body.joints)]
    return any(_FINGER.search(name.lower()) for name in names) or any(
        joint.name in coupled for joint in body.joints
    )


def _arm_end(spec: mujoco.MjSpec) -> str:
    """The last link of a URDF's arm, its fingers left out.

    Raises:
        WorkcellError: there are several ends.
    """
    coupled = _coupled(spec)
    moving = [b for b in spec.bodies if len(list(b.joints))]
    fingers = [b for b in moving if _is_finger(b, coupled)]
    arm = [b for b in moving if b not in fingers and not _below(b, fingers)]
    last_links = [b for b in arm if not any(_below(link, [b]) for link in arm)]
    if len(last_links) > 1 or not last_links:
        parents = sorted({b.parent.name for b in last_links} - {"world", ""})
        raise WorkcellError(_ambiguous("links", parents + [b.name for b in last_links or moving]))
    if fingers and not all(any(j.name in coupled for j in b.joints) for b in fingers):
        # that these are fingers is told by their names alone, which is not certain enough
        raise WorkcellError(_ambiguous("links", [last_links[0].name, *(b.name for b in fingers)]))
    fixed_links = [
        b
        for b in spec.bodies
        if _below(b, last_links) and not _below(b, fingers) and b not in fingers
    ]
    end_links = [b for b in fixed_links if not any(_below(link, [b]) for link in fixed_links)]
    if len(end_links) > 1:
        raise WorkcellError(_ambiguous("links", [last_links[0].name, *(b.name for b in end_links)]))
    return (end_links or last_links)[0].name


def _below(body, above: list) -> bool:
    """Does a body hang on one of the bodies `above`, directly or through others?"""
    parent = body.parent
    while parent is not None and parent.name != "world":
        if parent in above:
            return True
        parent = parent.parent
    return False


def longest_chain(spec: mujoco.MjSpec) -> str:
    """Name of the body with most joints on the way to it; "" where no named body has any."""
    counts = {}
    for body in spec.bodies:
        ancestor, count = body, 0
        while ancestor is not None and ancestor.name != "world":
            count += len(list(ancestor.joints))
            ancestor = ancestor.parent
        counts[body.name] = count if body.name else 0
    deepest = max(counts, key=lambda name: counts[name], default="")
    return deepest if counts.get(deepest) else ""
