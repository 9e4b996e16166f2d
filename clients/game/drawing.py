"""Drawing: a camera, and a figure of rounded limbs with soft shading and a shadow. Units are metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pygame
from adverb_client import Skeleton, quat

F64 = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

SKY_TOP, SKY_LOW, GROUND, GRID = (38, 44, 60), (86, 98, 122), (52, 58, 70), (84, 92, 108)
SHIRT, SKIN, HAIR = (66, 132, 190), (228, 178, 146), (78, 56, 46)
TROUSERS, SHOES, OTHER = (70, 78, 112), (40, 42, 52), (150, 170, 190)
LIGHT = np.array([-0.45, -1.0, -0.35])
"""Direction of the light; shadows are cast on y = 0."""

# part of a joint's name, and of the bone from its parent to it: radius at the parent, at the joint, colour, body part
STYLES: tuple[tuple[str, float, float, Colour, str], ...] = (
    ("Shoulder", 0.090, 0.082, SHIRT, "trunk"),
    ("ForeArm", 0.064, 0.047, SHIRT, "arm"),
    ("Arm", 0.084, 0.068, SHIRT, "trunk"),
    ("Hand", 0.044, 0.031, SKIN, "arm"),
    ("UpLeg", 0.094, 0.099, TROUSERS, "leg"),
    ("Foot", 0.068, 0.046, TROUSERS, "leg"),
    ("Toe", 0.052, 0.046, SHOES, "leg"),
    ("Leg", 0.099, 0.068, TROUSERS, "leg"),
    ("Neck", 0.128, 0.062, SHIRT, "trunk"),
    ("Head", 0.052, 0.050, SKIN, "trunk"),
    ("Spine2", 0.112, 0.128, SHIRT, "trunk"),
    ("Spine1", 0.108, 0.112, SHIRT, "trunk"),
    ("Spine", 0.116, 0.108, SHIRT, "trunk"),
)
TIP_STYLES = {"Hand": (0.036, 0.022, SKIN), "Toe": (0.045, 0.036, SHOES)}
FACE = (
    ("hair", (0.0, 0.105, -0.005), (0.0, 0.075, -0.022), 0.108, 0.092, HAIR),
    ("face", (0.0, 0.090, 0.028), (0.0, 0.040, 0.040), 0.098, 0.070, SKIN),
    ("face", (0.0, 0.080, 0.116), (0.0, 0.062, 0.128), 0.016, 0.019, SKIN),
)
"""Parts of the head in the frame of its joint: from, to, radii."""
UNDER_TO_OVER = (HAIR, SKIN, SHOES, TROUSERS, SHIRT, OTHER)
TO_LIGHT = np.array([-0.30, -0.34])
SHADOW = (126, 128, 138)
LAYERS = 11


class Camera:
    """A camera that looks at a point.

    Parameters
    ----------
    eye, target : (3,)
        Position and target, metres.
    focal : float
        Pixels per metre at a distance of 1 m.
    size : (int, int)
        Pixels of the picture.
    """

    def __init__(self, eye: F64, target: F64, focal: float, size: tuple[int, int]) -> None:
        self.eye, self.focal, self.size = eye, focal, size
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(right, forward), forward])

    def project(self, points: F64) -> F64:
        """Points (..., 3) → x, y in pixels and pixels per metre there (..., 3)."""
        seen = (points - self.eye) @ self.axes.T
        scale = self.focal / np.maximum(seen[..., 2], 0.05)
        x = 0.5 * self.size[0] + seen[..., 0] * scale
        y = 0.5 * self.size[1] - seen[..., 1] * scale
        return np.stack([x, y, scale], axis=-1)

    def on_plane(self, pixel: tuple[float, float], z: float) -> F64:
        """The point (3,) of the upright plane at z that is seen at a pixel."""
        seen = np.array([pixel[0] - 0.5 * self.size[0], 0.5 * self.size[1] - pixel[1], self.focal])
        ray = seen @ self.axes
        along = (z - self.eye[2]) / ray[2] if abs(ray[2]) > 1e-6 else 0.0
        point: F64 = self.eye + max(along, 0.0) * ray
        return point


@dataclass(frozen=True, slots=True)
class Limb:
    """A tapered, rounded piece of the body: two ends (3,), two radii, a colour."""

    start: F64
    end: F64
    radii: tuple[float, float]
    colour: Colour


def limbs_of(skeleton: Skeleton, root: F64, rotations: F64) -> list[list[Limb]]:
    """The body in parts that are each drawn as one, so that no seam is seen at elbows and knees."""
    turns = skeleton.global_rotations(rotations)
    places = skeleton.positions(root, turns, "global")
    children = np.bincount(skeleton.parents[1:], minlength=len(skeleton))
    size = float(np.linalg.norm(skeleton.offsets[1:], axis=1).sum()) / 4.6 if "Head" in skeleton.names else 1.0
    parts: dict[str, list[Limb]] = {}
    for joint in range(1, len(skeleton)):
        name, parent = skeleton.names[joint], int(skeleton.parents[joint])
        start, end, colour, part = next((row[1:] for row in STYLES if row[0] in name), (0.05, 0.04, OTHER, "trunk"))
        side = ("Left" if "Left" in name else "Right") if part != "trunk" else ""
        chain = parts.setdefault(part + side, [])
        chain.append(Limb(places[parent], places[joint], (start * size, end * size), colour))
        if name == "Head":
            for label, *limb in _head(places[joint], turns[joint], size):
                parts.setdefault(label, []).extend(limb)
        elif children[joint] == 0 and any(end in name for end in TIP_STYLES):
            chain.append(_tip(skeleton, joint, places[joint], turns[joint], size))
    return list(parts.values())


def _head(place: F64, turn: F64, size: float) -> list[tuple[str, Limb]]:
    def there(point: tuple[float, float, float]) -> F64:
        return place + quat.rotate(turn, np.array(point) * size)

    return [(row[0], Limb(there(row[1]), there(row[2]), (row[3] * size, row[4] * size), row[5])) for row in FACE]


def _tip(skeleton: Skeleton, joint: int, place: F64, turn: F64, size: float) -> Limb:
    """The end of a limb that has no joint behind it: fingers, toes."""
    name, along = skeleton.names[joint], np.array(skeleton.offsets[joint])
    if "Toe" in name:
        along[1] = 0.0
    start, end, colour = next(style for part, style in TIP_STYLES.items() if part in name)
    return Limb(place, place + quat.rotate(turn, along * 0.5), (start * size, end * size), colour)


def draw_ground(picture: pygame.Surface, camera: Camera) -> None:
    """Sky, ground and a grid of half metres that fades away; slow, so keep the picture while the camera stands."""
    width, height = picture.get_size()
    horizon = int(camera.project(camera.eye + np.array([0.0, -camera.eye[1], -60.0]) * [1, 1, 1])[1])
    for y in range(height):
        share = min(y / max(horizon, 1), 1.0)
        picture.fill(_mix(SKY_TOP, SKY_LOW, share**2), (0, y, width, 1))
    for y in range(max(horizon, 0), height):
        share = min((y - horizon) / (0.5 * height), 1.0)
        picture.fill(_mix(SKY_LOW, GROUND, share**0.5), (0, y, width, 1))
    for k in np.arange(-4.0, 4.01, 0.5):
        for axis in (0, 2):
            ends = np.zeros((33, 3))
            ends[:, axis], ends[:, 2 - axis] = k, np.linspace(-4.0, 4.0, 33)
            _fading_line(picture, camera.project(ends), np.linalg.norm(ends, axis=1), 2 if k == 0 else 1)


def _fading_line(picture: pygame.Surface, points: F64, away: F64, width: int) -> None:
    for k in range(len(points) - 1):
        share = max(0.0, 1.0 - away[k] / 4.0)
        y = int(points[k, 1])
        if share > 0.0 and 0 <= y < picture.get_height() and 0 <= points[k, 0] < picture.get_width():
            colour = _mix(picture.get_at((int(points[k, 0]), y))[:3], GRID, 0.8 * share)
            pygame.draw.aaline(picture, colour, points[k, :2].tolist(), points[k + 1, :2].tolist(), width)


def draw_shadow(picture: pygame.Surface, camera: Camera, parts: list[list[Limb]]) -> None:
    """What the light does not reach: the limbs along the light onto the ground, made soft by a small picture."""
    limbs = [limb for part in parts for limb in part]
    flat = np.stack([limb.start for limb in limbs] + [limb.end for limb in limbs])
    seen = camera.project(flat - LIGHT * (flat[:, 1:2] / LIGHT[1])).reshape(2, len(limbs), 3)
    place = _around(seen, 0.25).clip(picture.get_rect())
    if place.width < 8 or place.height < 8:
        return
    small = pygame.Surface((place.width // 6 + 1, place.height // 6 + 1))
    small.fill((255, 255, 255))
    ends = (seen[..., :2] - place.topleft) / 6.0
    for k, limb in enumerate(limbs):
        wide, narrow = (seen[:, k, 2] / 6.0 * limb.radii).tolist()
        _capsule(small, ends[0, k].tolist(), ends[1, k].tolist(), wide, narrow, SHADOW)
    soft = pygame.transform.smoothscale(pygame.transform.box_blur(small, 2), place.size)
    picture.blit(soft, place, special_flags=pygame.BLEND_MULT)


def draw_figure(picture: pygame.Surface, camera: Camera, parts: list[list[Limb]]) -> None:
    """Parts from far to near, twice as fine as the picture: made smaller, their edges are smooth."""
    seen = [camera.project(np.array([(limb.start, limb.end) for limb in part])) for part in parts]
    place = _around(np.concatenate(seen), 0.16).clip(picture.get_rect())
    if place.width < 1 or place.height < 1:
        return
    fine = pygame.transform.scale(picture.subsurface(place), (2 * place.width, 2 * place.height))
    for k in sorted(range(len(parts)), key=lambda k: float(seen[k][..., 2].mean())):
        ends = (seen[k] - [place.left, place.top, 0.0]) * 2.0
        radii = np.array([limb.radii for limb in parts[k]]) * ends[..., 2]
        for colour in UNDER_TO_OVER:
            own = [row for row, limb in enumerate(parts[k]) if limb.colour == colour]
            if own:
                _draw_part(fine, ends[own, :, :2], radii[own], colour)
    picture.blit(pygame.transform.smoothscale(fine, place.size), place)


def _draw_part(fine: pygame.Surface, ends: F64, radii: F64, colour: Colour) -> None:
    """Limbs of one colour, in layers from dark edge to light middle; ends (n, 2, 2), radii (n, 2), pixels."""
    for layer in range(LAYERS):
        share = layer / (LAYERS - 1)
        lit = _lit(colour, share)
        moved, smaller = ends + radii[..., None] * TO_LIGHT * share, radii * (1.0 - 0.85 * share)
        for (start, end), (wide, narrow) in zip(moved.tolist(), smaller.tolist(), strict=True):
            _capsule(fine, start, end, wide, narrow, lit)


def _around(seen: F64, margin_m: float) -> pygame.Rect:
    """The rectangle of pixels around projected points (..., 3), with a margin in metres."""
    points = seen.reshape(-1, 3)
    margin = margin_m * float(points[:, 2].max())
    low, high = (
        np.clip(points[:, :2].min(0) - margin, -9_999, 9_999),
        np.clip(points[:, :2].max(0) + margin, -9_999, 9_999),
    )
    return pygame.Rect(low.astype(int).tolist(), np.ceil(high - low).astype(int).tolist())


def _lit(colour: Colour, share: float) -> Colour:
    if share < 0.6:
        return _mix(_mix(colour, (16, 18, 30), 0.62), colour, share / 0.6)
    return _mix(colour, (255, 250, 240), 0.24 * (share - 0.6) / 0.4)


def _capsule(
    picture: pygame.Surface, start: list[float], end: list[float], r0: float, r1: float, colour: Colour
) -> None:
    """Two discs and what lies between their outer tangents, pixels."""
    pygame.draw.circle(picture, colour, start, r0)
    pygame.draw.circle(picture, colour, end, r1)
    (x0, y0), (x1, y1) = start, end
    dx, dy = x1 - x0, y1 - y0
    length = math.hypot(dx, dy)
    if length <= abs(r0 - r1) or length < 1e-6:
        return
    lean = (r0 - r1) / length
    side = math.sqrt(1.0 - lean * lean)
    nx, ny = (lean * dx - side * dy) / length, (lean * dy + side * dx) / length
    mx, my = (lean * dx + side * dy) / length, (lean * dy - side * dx) / length
    corners = (
        (x0 + r0 * nx, y0 + r0 * ny),
        (x1 + r1 * nx, y1 + r1 * ny),
        (x1 + r1 * mx, y1 + r1 * my),
        (x0 + r0 * mx, y0 + r0 * my),
    )
    pygame.draw.polygon(picture, colour, corners)


def draw_ball(picture: pygame.Surface, camera: Camera, point: F64, radius_m: float, colour: Colour) -> None:
    """A ball, in layers from dark edge to light spot."""
    x, y, scale = camera.project(point).tolist()
    radius = radius_m * scale
    for layer in range(LAYERS):
        share = layer / (LAYERS - 1)
        centre = (x + TO_LIGHT[0] * radius * share, y + TO_LIGHT[1] * radius * share)
        pygame.draw.circle(picture, _lit(colour, share), centre, max(radius * (1.0 - 0.86 * share), 1.0))


def draw_ball_shadow(picture: pygame.Surface, camera: Camera, point: F64, radius_m: float) -> None:
    """The shadow of a ball on the ground, fainter the higher it is."""
    x, y, scale = camera.project(point - LIGHT * (point[1] / LIGHT[1])).tolist()
    width = max(2.0 * radius_m * scale, 2.0)
    place = pygame.Rect(0, 0, int(width * 1.2), max(int(width * 0.4), 2))
    place.center = (int(x), int(y))
    shade = pygame.Surface(place.size, pygame.SRCALPHA)
    pygame.draw.ellipse(shade, (10, 12, 18, int(120 / (1.0 + point[1]))), shade.get_rect())
    picture.blit(shade, place)


def draw_ring(picture: pygame.Surface, camera: Camera, point: F64, radius_m: float, colour: Colour) -> None:
    """A ring around a point, and a line down to the ground."""
    x, y, scale = camera.project(point).tolist()
    foot = camera.project(point * [1.0, 0.0, 1.0])
    pygame.draw.aaline(picture, _mix(GRID, colour, 0.5), (x, y), foot[:2].tolist())
    pygame.draw.circle(picture, colour, (x, y), radius_m * scale, 2)


def _mix(a: tuple[int, ...], b: tuple[int, ...], share: float) -> Colour:
    red, green, blue = (round(x + (y - x) * share) for x, y in zip(a[:3], b[:3], strict=True))
    return red, green, blue
