# SPDX-License-Identifier: MIT
"""Which frame of a model is the tool: the one that is named, a usual name, or the arm's end.

Nothing is guessed: where several could be meant the message lists them.
"""

import re

import mujoco

from hybrid_jax.errors import UnknownNameError, WorkcellError

TOOL = "tool"
"""Name of the site that is added where a link is found to be the tool."""
USUAL = ("tool", "tcp", "tool0", "grasp_site", "pinch", "attachment_site")
"""Names of tool frames, the first of them that there is."""
_LIKE = re.compile(
    "tcp|tool_?cent|tool0|pinch|grasp|attachment|end_?eff|eef|ee_?(site|link)$|wrist_?site"
)
"""Parts of names that vendors give to tool frames."""
_FINGER = re.compile(r"finger|jaw|knuckle|thumb|gripper")
"""Parts of names of what a gripper moves."""


def _pick(names: list[str], what: str) -> str | None:
    """The tool among some names; None if no name says so.

    Raises:
        WorkcellError: several do.
    """
    for usual in USUAL:
        if usual in names:
            return usual
    like = [name for name in names if _LIKE.search(name.lower())]
    if len(like) > 1:
        raise WorkcellError(_ambiguous(what, like))
    return like[0] if like else None


def _ambiguous(what: str, names: list[str]) -> str:
    return f"several {what} could be the tool: {', '.join(names)}; name one with --tool NAME"


def usual_site(sites: list[str]) -> str:
    """The site of a model that is its tool, by its name.

    Raises:
        WorkcellError: none has a usual name, or several have.
    """
    found = _pick([name for name in sites if name], "sites")
    if found is None:
        raise WorkcellError(
            "the model has no tool frame: add a site named 'tool' to the last link, or name a "
            f"site or body with --tool NAME (sites: {', '.join(filter(None, sites)) or 'none'})"
        )
    return found


def set_tool(spec: mujoco.MjSpec, name: str) -> None:
    """Make sure that a model has a site for its tool, where a link is the tool.

    Args:
        spec: of the model; a site is added where the tool is a body.
        name: of a site or body; "" to find one, as a URDF asks for, which has no sites.

    Raises:
        UnknownNameError: no such site or body.
        WorkcellError: nothing tells which frame is the tool; the message lists candidates.
    """
    sites = [site.name for site in spec.sites if site.name]
    bodies = {body.name: body for body in spec.bodies if body.name and body.name != "world"}
    found = name or _pick(sites, "sites")
    if found in sites:
        return
    if name and name not in bodies:
        raise UnknownNameError("site or link for the tool", name, [*sites, *bodies])
    link = name or _pick(list(bodies), "links") or _arm_end(spec)
    bodies[link].add_site(name=name or TOOL)  # one that was named keeps its name: TOOL may be taken


def _coupled(spec: mujoco.MjSpec) -> set[str]:
    """Joints that follow another one, and those that they follow: a gripper's."""
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
    last = [b for b in arm if not any(_below(other, [b]) for other in arm)]
    if len(last) > 1 or not last:
        above = sorted({b.parent.name for b in last} - {"world", ""})
        raise WorkcellError(_ambiguous("links", above + [b.name for b in last or moving]))
    if fingers and not all(any(j.name in coupled for j in b.joints) for b in fingers):
        # only their names say that these are a gripper's
        raise WorkcellError(_ambiguous("links", [last[0].name, *(b.name for b in fingers)]))
    fixed = [b for b in spec.bodies if _below(b, last) and not _below(b, fingers)
             and b not in fingers]  # fmt: skip
    ends = [b for b in fixed if not any(_below(other, [b]) for other in fixed)]
    if len(ends) > 1:
        raise WorkcellError(_ambiguous("links", [last[0].name, *(b.name for b in ends)]))
    return (ends or last)[0].name


def _below(body, above: list) -> bool:
    """Does a body hang on one of some others?"""
    parent = body.parent
    while parent is not None and parent.name != "world":
        if parent in above:
            return True
        parent = parent.parent
    return False


def longest_chain(spec: mujoco.MjSpec) -> str:
    """The body with most joints above it; "" where no named body has any."""
    counts = {}
    for body in spec.bodies:
        at, count = body, 0
        while at is not None and at.name != "world":
            count += len(list(at.joints))
            at = at.parent
        counts[body.name] = count if body.name else 0
    best = max(counts, key=lambda name: counts[name], default="")
    return best if counts.get(best) else ""
