"""Which source joint moves which target joint, by the bones of both, and by names where a mapping gives them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from verbs.errors import RequestError, UnknownName
from verbs.mapping.mapping import Mapping
from verbs.mapping.names import Roles
from verbs.mapping.rig import Rig

__all__ = ["Row", "explicit_joints", "plan", "with_given_bones"]


@dataclass(frozen=True, slots=True)
class Row:
    """How one target joint moves.

    Parameters
    ----------
    target : int
        Joint of the target.
    first, second : int
        Joints of the source between which it lies.
    share : float
        0 at the first, 1 at the second.
    bone : str
        VRM bone of both; ``spine`` and ``neck`` for joints of the trunk; empty for joints paired by name.
    given : bool
        Whether the mapping names the pair.
    """

    target: int
    first: int
    second: int
    share: float
    bone: str
    given: bool = False

    @property
    def source(self) -> int:
        """The nearer source joint."""
        return self.second if self.share > 0.5 else self.first


def with_given_bones(source: Rig, mapping: Mapping) -> Mapping:
    """The mapping with bones of the target by its pairs: a joint that a bone of the source moves is that bone.

    Names that do not exist are left to :func:`plan`.
    """
    others = {name: joint for joint, name in enumerate(mapping.rig.skeleton.names)}
    names = source.skeleton.names
    moved = {bone: mapping.joints.get(names[joint], "") for bone, joint in source.roles.bones.items()}
    given = {bone: others[name] for bone, name in moved.items() if name in others}
    if not given:
        return mapping
    return replace(mapping, rig=replace(mapping.rig, given={**mapping.rig.given, **given}))


def plan(source: Rig, mapping: Mapping) -> list[Row]:
    """Rows of the target joints that move, in their order.

    Bones that both have are paired; fingers that the source lacks move as its middle finger. Joints of the spine and of
    the neck are spread over those of the other: one that lies at a third of the way takes the rotation of the source at
    a third. Without bones, equal names are paired.

    Raises
    ------
    UnknownName
        The mapping names a joint that does not exist.
    RequestError
        It names a target twice, or nothing can be paired.
    """
    target = mapping.rig
    rows: dict[int, Row] = {}
    if source.roles and target.roles:
        for bone, joint in source.roles.bones.items():
            if bone in target.roles.bones:
                other = target.roles.bones[bone]
                rows[other] = Row(other, joint, joint, 0.0, bone)
        rows |= _fingers(source.roles, target.roles)
        rows |= _trunk(source.roles, target.roles)
    else:
        known = {name.lower(): k for k, name in enumerate(target.skeleton.names)}
        for joint, name in enumerate(source.skeleton.names):
            if name.lower() in known:
                rows[known[name.lower()]] = Row(known[name.lower()], joint, joint, 0.0, "")
    _apply_given(source, mapping, rows)
    if not rows:
        raise RequestError(
            f"no joint of '{source.name}' can be mapped to '{target.name}': neither bones of a humanoid nor equal "
            f"names are found; state pairs in [joints] of a mapping.toml"
        )
    return [rows[joint] for joint in sorted(rows)]


def explicit_joints(source: Rig, target: Rig, rows: list[Row]) -> dict[str, str]:
    """Target names by source names, for a ``mapping.toml``: the pairs, without what is spread over the trunk."""
    return {
        source.skeleton.names[row.first]: target.skeleton.names[row.target]
        for row in rows
        if row.given or (row.bone not in ("spine", "neck") and not _copied(source, row))
    }


def _copied(source: Rig, row: Row) -> bool:
    """Whether a row moves a bone that the source does not have."""
    return row.bone != "" and row.bone not in source.roles.bones


def _fingers(source: Roles, target: Roles) -> dict[int, Row]:
    """Rows of fingers that the source does not have: they move as its middle finger."""
    rows: dict[int, Row] = {}
    for side in ("left", "right"):
        for finger in ("Index", "Ring", "Little"):
            if f"{side}{finger}Proximal" in source.bones:
                continue
            for part in ("Proximal", "Intermediate", "Distal"):
                joint, other = source.bones.get(f"{side}Middle{part}"), target.bones.get(f"{side}{finger}{part}")
                if joint is not None and other is not None:
                    rows[other] = Row(other, joint, joint, 0.0, f"{side}{finger}{part}")
    return rows


def _trunk(source: Roles, target: Roles) -> dict[int, Row]:
    """Rows of the spine and the neck."""
    rows: dict[int, Row] = {}
    hips, chest = source.bones["hips"], source.spine[-1] if source.spine else source.bones["hips"]
    count = len(target.spine)
    for k, joint in enumerate(target.spine, start=1):
        rows[joint] = _along(joint, (hips, *source.spine), k / count * len(source.spine), "spine")
    if "head" in source.bones:
        chain = (chest, *source.neck, source.bones["head"])
        size = len(target.neck) + 1
        for k, joint in enumerate(target.neck, start=1):
            rows[joint] = _along(joint, chain, k / size * (len(source.neck) + 1), "neck")
    return rows


def _along(joint: int, chain: tuple[int, ...], at: float, bone: str) -> Row:
    """The row of a joint at a place along a chain of the source, counted in its links."""
    k = min(int(at + 1e-9), len(chain) - 1)
    share = at - k
    if share < 1e-9 or k == len(chain) - 1:
        return Row(joint, chain[k], chain[k], 0.0, bone)
    return Row(joint, chain[k], chain[k + 1], share, bone)


def _apply_given(source: Rig, mapping: Mapping, rows: dict[int, Row]) -> None:
    """Replace rows by the pairs that a mapping names."""
    names, others = source.skeleton.names, mapping.rig.skeleton.names
    bones = {joint: bone for bone, joint in source.roles.bones.items()}
    pairs: dict[int, int] = {}
    for name, other in mapping.joints.items():
        if name not in names:
            raise UnknownName("joint", name, names)
        if other and other not in others:
            raise UnknownName("joint of the target", other, others)
        pairs[names.index(name)] = others.index(other) if other else -1
    for target, row in list(rows.items()):
        own = row.bone in ("", bones.get(row.first))  # neither spread over the trunk nor a finger as another one
        if (row.source in pairs and own) or pairs.get(row.source) == -1:
            del rows[target]
    taken: dict[int, str] = {}
    for joint, target in pairs.items():
        if target < 0:
            continue
        if target in taken:
            raise RequestError(
                f"'{others[target]}' is the target of two joints, '{taken[target]}' and '{names[joint]}'; name it once"
            )
        taken[target] = names[joint]
        bone = bones.get(joint) or _trunk_bone(source.roles, joint, mapping.rig.roles, target)
        rows[target] = Row(target, joint, joint, 0.0, bone, given=True)


def _trunk_bone(source: Roles, joint: int, target: Roles, other: int) -> str:
    """``spine`` or ``neck`` where both joints of a pair are of it; else an empty text."""
    if joint in source.spine and other in target.spine:
        return "spine"
    return "neck" if joint in source.neck and other in target.neck else ""
