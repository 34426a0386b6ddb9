"""Bodies and joints of a user's URDF. Meshes, visuals and transmissions are not read."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from robots.description import Body, Joint
from robots.errors import DescriptionError
from robots.messages import Array

KINDS = ("revolute", "fixed")


def load_urdf_bodies(path: Path) -> tuple[Body, ...]:
    """Bodies of a URDF, depth first; links without inertia must hang on fixed joints and are left out.

    Args:
        path: the URDF file.

    Returns:
        The bodies; joint damping and friction as in ``<dynamics>``, armature and gains 0.

    Raises:
        DescriptionError: the file cannot be read, or holds a joint that is neither revolute nor fixed, a moving link
            without inertia, no single root, a name used twice, or a link that the base does not reach.
    """
    root = _parse(path)
    links = {link.get("name", ""): link for link in root.findall("link")}
    joints = root.findall("joint")
    _require_once(path, "link name", [link.get("name", "") for link in root.findall("link")])
    for joint in joints:
        _check_joint(path, joint, links)
    children = [_link_of(j, "child") for j in joints]
    # with one joint above each link, whatever the base reaches is a tree, and the walk below ends
    _require_once(path, "child link of joints", children)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise DescriptionError(path, "links that are nobody's child", roots, "exactly one, the base")
    return tuple(_walk(path, roots[0], links, joints))


def _require_once(path: Path, entry: str, names: list[str]) -> None:
    if repeated := sorted({n for n in names if names.count(n) > 1}):
        raise DescriptionError(path, entry, repeated, "given once only")


def _parse(path: Path) -> ET.Element:
    try:
        return ET.fromstring(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DescriptionError(path, "file", str(path), f"readable ({error.strerror})") from error
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise DescriptionError(path, "file", str(path), f"valid XML ({error})") from error


def _link_of(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _check_joint(path: Path, joint: ET.Element, links: dict[str, ET.Element]) -> None:
    entry = f"joint '{joint.get('name')}'"
    if joint.get("type") not in KINDS:
        raise DescriptionError(path, f"{entry}: type", joint.get("type"), "one of " + ", ".join(KINDS))
    for end in ("parent", "child"):
        if _link_of(joint, end) not in links:
            raise DescriptionError(path, f"{entry}: {end}", _link_of(joint, end), "a link of this file")


def _walk(path: Path, base: str, links: dict[str, ET.Element], joints: list[ET.Element]) -> list[Body]:
    """Depth first: both simulators index a branch by one range, so it must not be interleaved with another."""
    bodies = [_body(path, links[base], None, None)]
    unreached = set(links) - {base}
    stack = _joints_below(base, joints)
    while stack:
        joint = stack.pop()
        link = links[_link_of(joint, "child")]
        unreached.remove(link.get("name", ""))
        if link.find("inertial") is None and joint.get("type") == "fixed":
            _require_leaf(path, link, joints)
            continue
        bodies.append(_body(path, link, _link_of(joint, "parent"), _joint(path, joint)))
        stack += _joints_below(link.get("name", ""), joints)
    if unreached:
        raise DescriptionError(path, "links", sorted(unreached), f"reached from the base '{base}' (is there a cycle?)")
    return bodies


def _joints_below(link: str, joints: list[ET.Element]) -> list[ET.Element]:
    """The joints whose parent is ``link``, last first: ready to be popped in the order of the file."""
    return [j for j in reversed(joints) if _link_of(j, "parent") == link]


def _require_leaf(path: Path, link: ET.Element, joints: list[ET.Element]) -> None:
    if any(_link_of(j, "parent") == link.get("name") for j in joints):
        raise DescriptionError(path, f"link '{link.get('name')}': inertial", None, "given for a link that has children")


def _numbers(path: Path, element: ET.Element | None, key: str, default: str, entry: str) -> Array:
    text = default if element is None else element.get(key, default)
    try:
        values = np.array([float(x) for x in text.split()])
    except ValueError as error:
        raise DescriptionError(path, f"{entry}: {key}", text, "numbers") from error
    if values.size != len(default.split()):
        raise DescriptionError(path, f"{entry}: {key}", text, f"{len(default.split())} numbers")
    return values


def _body(path: Path, link: ET.Element, parent: str | None, joint: Joint | None) -> Body:
    name = link.get("name", "")
    entry = f"link '{name}'"
    inertial = link.find("inertial")
    if inertial is None:
        raise DescriptionError(path, f"{entry}: inertial", None, "given for the base and for links on moving joints")
    origin, tensor = inertial.find("origin"), inertial.find("inertia")
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ixx, iyy, izz, ixy, ixz, iyz = (float(_numbers(path, tensor, k, "0", entry)[0]) for k in keys)
    rotation = pin.rpy.rpyToMatrix(_numbers(path, origin, "rpy", "0 0 0", entry))
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    mass = float(_numbers(path, inertial.find("mass"), "value", "0", entry)[0])
    com = _numbers(path, origin, "xyz", "0 0 0", entry)
    return Body(name, mass, com, rotation @ inertia @ rotation.T, parent, joint)


def _joint(path: Path, element: ET.Element) -> Joint:
    name = element.get("name", "")
    entry = f"joint '{name}'"
    origin = element.find("origin")
    xyz, rpy = (_numbers(path, origin, k, "0 0 0", entry) for k in ("xyz", "rpy"))
    if element.get("type") == "fixed":
        return Joint(name, xyz, rpy, np.zeros(3))
    axis = _numbers(path, element.find("axis"), "xyz", "1 0 0", entry)
    if not (length := float(np.linalg.norm(axis))):
        raise DescriptionError(path, f"{entry}: axis", axis.tolist(), "not zero")
    limit, dynamics = element.find("limit"), element.find("dynamics")
    lower, upper, velocity, effort = (
        float(_numbers(path, limit, k, "0", entry)[0]) for k in ("lower", "upper", "velocity", "effort")
    )
    damping, friction = (float(_numbers(path, dynamics, k, "0", entry)[0]) for k in ("damping", "friction"))
    return Joint(
        name,
        xyz,
        rpy,
        axis / length,
        (lower, upper),
        velocity,
        effort,
        damping=damping,
        friction_loss=friction,
    )
