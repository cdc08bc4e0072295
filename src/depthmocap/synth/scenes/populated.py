"""Rooms with people who stand, sit, lie and touch each other, for finding people in whole depth images.

scene = populated_scene(rng, draw_person)
camera = scene.camera(rng, preset)
picture = scene.render(camera)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.render import Layer, Material, PosedPerson, draw_mesh
from depthmocap.synth.scenes.blanket import blanket_over
from depthmocap.synth.scenes.furniture import make_table, yaw
from depthmocap.synth.scenes.lookalikes import LOOKALIKES
from depthmocap.synth.scenes.objects import held_object
from depthmocap.synth.scenes.placing import Place, furnish, room_shell, seat
from depthmocap.synth.scenes.solids import NONE, Solids, above, box, cylinder, ellipsoid, join
from depthmocap.synth.scenes.worn import worn_object
from depthmocap.synth.sensing.sensors import SensorPreset

#: Probability of 0, 1, 2, … people.
_COUNTS = (0.25, 0.32, 0.21, 0.10, 0.07, 0.05)
#: Probability of 0, 1, 2, … things that resemble people.
_LOOKALIKES = (0.2, 0.25, 0.25, 0.2, 0.1)
#: Share of cameras that look at a person where there are people,
_AT_PEOPLE = 0.7
#: and of the others that look at what resembles one.
_AT_LOOKALIKES = 0.6
#: Share of further people who are put beside another one, near enough to touch.
_BESIDE = 0.6
#: People stand within this distance of the room's middle (metres).
_ABOUT_M = 2.5
#: Share of lying people who lie on a bed, a couch or a mat.
_ON_BED = 0.75
#: Share of seated people with a table before them.
_AT_TABLE = 0.5
#: Share of people in bed who are under a blanket.
_UNDER_BLANKET = 0.6
#: Share of people half of whom is behind the end of a wall, as in a doorway.
_IN_DOORWAY = 0.1
#: Cloth shows the person beneath if it lies no farther from the body than this (metres).
COVER_M = 0.15
#: Share of seated people who sit in a wheelchair.
_WHEELCHAIR = 0.15
#: A person lies if the body is lower than this (metres, of an adult)
_LYING_M = 0.75
#: and this much longer than high.
_LYING = 1.6
#: Walls are so far from the middle of a room (metres),
_WALLS_M = (1.5, 4.0)
#: and of a large one (metres).
_FAR_WALLS_M = (3.0, 7.0)
#: Share of large rooms.
_LARGE = 0.35
#: Cameras near by, far away and otherwise: share and distance from what they look at (metres), within their range.
_DISTANCES = ((0.2, (0.5, 1.5)), (0.25, (4.0, 8.5)), (0.55, (1.5, 7.0)))
#: Least distance of a camera from everybody's skin and from the room's walls (metres).
_CLEARANCE_M = 0.3
#: A person's number in a picture's code times this, plus the material.
_CODE = 16
_TRIES = 8
_NO_EYES = np.zeros((0, 3))
_HIP, _NECK = JOINT_INDEX["Hip"], JOINT_INDEX["Neck"]


@dataclasses.dataclass(frozen=True, eq=False)
class PeoplePicture:
    """What an ideal camera sees.

    Attributes:
        depth_m: metres along z, 0 where nothing is.
        material: of every pixel.
        person: number of the person of every pixel from 1, 0 where there is none.
    """

    depth_m: Float[ndarray, "h w"]
    material: UInt8[ndarray, "h w"]
    person: UInt8[ndarray, "h w"]


@dataclasses.dataclass(frozen=True, eq=False)
class PopulatedScene:
    """People in a room with its floor at z = 0.

    Attributes:
        people: in the world.
        dolls: small figures, which are no people.
        blankets: over people who lie.
        solids: everything else.
        lookalikes: the middles of things that resemble people.
        low, high: corners of the part of the room where cameras may stand.
    """

    people: tuple[PosedPerson, ...]
    dolls: tuple[PosedPerson, ...]
    blankets: tuple[Layer, ...]
    solids: Solids
    lookalikes: Float[ndarray, "n 3"]
    low: Float[ndarray, "3"]
    high: Float[ndarray, "3"]

    @property
    def centres(self) -> Float[ndarray, "p 3"]:
        """The middle of everybody's trunk."""
        return np.array([trunk_centre(person.joints) for person in self.people]).reshape(-1, 3)

    def camera(self, rng: np.random.Generator, preset: SensorPreset, name: str = "camera") -> DepthCamera | None:
        """A camera in the room that looks at somebody or at any place; None where a few tries find no free place."""
        reach = preset.range_m[1]
        for _ in range(_TRIES):
            if self.people and rng.random() < _AT_PEOPLE:
                person = self.people[int(rng.integers(len(self.people)))]
                middle = rng.random() < 0.5
                joint = trunk_centre(person.joints) if middle else person.joints[int(rng.integers(len(person.joints)))]
                target = joint + rng.normal(0, 0.35, 3)
            elif len(self.lookalikes) and rng.random() < _AT_LOOKALIKES:
                target = self.lookalikes[int(rng.integers(len(self.lookalikes)))] + rng.normal(0, 0.35, 3)
            else:
                target = rng.uniform(self.low, self.high) * [1, 1, 0.6]
            nearest, farthest = _DISTANCES[int(rng.choice(len(_DISTANCES), p=[share for share, _ in _DISTANCES]))][1]
            farthest = min(farthest, max(reach - 0.3, 1.8))
            distance = rng.uniform(min(nearest, 0.7 * farthest), farthest)
            azimuth, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.15, 2.7)
            down = np.clip(height - target[2], -0.95 * distance, 0.95 * distance)
            ground = np.sqrt(distance**2 - down**2)
            eye = target + np.array([ground * np.cos(azimuth), ground * np.sin(azimuth), down])
            if (eye < self.low).any() or (eye > self.high).any():
                continue
            if any(np.linalg.norm(person.vertices[::7] - eye, axis=1).min() < _CLEARANCE_M for person in self.people):
                continue
            if self.solids.grown(0.1).hold_any(eye[None]) and not _only_shell_holds(self.solids, eye):
                continue
            roll = (
                rng.uniform(-np.pi, np.pi)
                if rng.random() < 0.04
                else rng.normal(0, 0.25 if rng.random() < 0.2 else 0.05)
            )
            return preset.camera(name, look_at(eye, target, roll))
        return None

    def render(self, camera: DepthCamera) -> PeoplePicture:
        """Exact depth, materials and people, without lens distortion of the people."""
        depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
        code = np.zeros(depth.shape, dtype=np.uint8)
        self.solids.draw(camera, depth, code)
        for doll in self.dolls:
            _draw(doll, 0, camera, depth, code)
        for k, person in enumerate(self.people):
            _draw(person, k + 1, camera, depth, code)
        if self.blankets:
            bare, bare_code = depth.copy(), code.copy()
            for blanket in self.blankets:
                values = np.full(len(blanket.faces), blanket.material, np.uint8)
                draw_mesh(blanket.vertices, blanket.faces, values, camera, depth, code, two_sided=True)
            # Cloth right over somebody shows them, as clothes do.
            near = (depth < bare) & (bare < depth + COVER_M)
            code[near] += bare_code[near] // _CODE * _CODE
        depth[np.isinf(depth)] = 0
        return PeoplePicture(depth, code % _CODE, code // _CODE)


def trunk_centre(joints: Float[ndarray, "18 3"]) -> Float[ndarray, "3"]:
    """The middle between hips and neck."""
    return (joints[_HIP] + joints[_NECK]) / 2


def _only_shell_holds(solids: Solids, eye: Float[ndarray, "3"]) -> bool:
    """Whether no solid but the room's shell, which comes first, holds the eye."""
    rest = Solids(solids.kinds[1:], solids.halves[1:], solids.frames[1:], solids.materials[1:])
    return not rest.grown(0.1).hold_any(eye[None])


def _draw(person: PosedPerson, number: int, camera: DepthCamera, depth: ndarray, code: ndarray) -> None:
    body = person.body
    skin = np.full(len(body.faces), number * _CODE + Material.SKIN, np.uint8)
    draw_mesh(body.vertices, body.faces, skin, camera, depth, code)
    for layer in person.layers:
        values = np.full(len(layer.faces), number * _CODE + layer.material, np.uint8)
        draw_mesh(layer.vertices, layer.faces, values, camera, depth, code, two_sided=True)


def populated_scene(
    rng: np.random.Generator, draw_person: Callable[[np.random.Generator], PosedPerson] | None
) -> PopulatedScene:
    """A random room with people, furniture and things that resemble people.

    Args:
        draw_person: gives a person in any posture and place; None for a room without people.
    """
    people = _draw_people(rng, draw_person)
    joints = np.concatenate([person.joints for person in people]) if people else np.zeros((18, 3))
    place = Place(_NO_EYES, joints, 0.0, 0.0)
    if not people:
        place.occupy(np.zeros((1, 3)))  # the room is made around what is occupied
    people, supports, blankets = _support(rng, people, place)
    objects = []
    for person in people:
        if rng.random() < 0.2:
            objects.append(worn_object(rng, person))
        if rng.random() < 0.3:
            objects.append(held_object(rng, person, 0.0))
    dolls = _dolls(rng, draw_person) if draw_person and rng.random() < 0.08 else ()
    shell = room_shell(rng, place, _FAR_WALLS_M if rng.random() < _LARGE else _WALLS_M) if rng.random() < 0.92 else NONE
    corners = shell.corners.reshape(-1, 3) if len(shell) else np.array([[-5.0, -5.0, 0.0], [5.0, 5.0, 3.0]])
    low, high = corners.min(0), corners.max(0)
    pieces: list[Solids] = []
    if len(shell):
        pieces = furnish(rng, place, shell, int(rng.integers(0, 14)), 0.0, against_walls=True)
    count = int(rng.choice(len(_LOOKALIKES), p=_LOOKALIKES))
    drawn = [LOOKALIKES[i](rng) for i in rng.integers(len(LOOKALIKES), size=count)]
    lookalikes = [piece for piece in (_standing(rng, piece, place, low, high) for piece in drawn) if len(piece)]
    middles = np.array([piece.corners.reshape(-1, 3).mean(0) for piece in lookalikes]).reshape(-1, 3)
    solids = join([shell, *supports, *objects, *pieces, *lookalikes])
    margin = np.array([0.15, 0.15, 0.1])
    return PopulatedScene(tuple(people), dolls, tuple(blankets), solids, middles, low + margin, high - margin)


def _draw_people(
    rng: np.random.Generator, draw_person: Callable[[np.random.Generator], PosedPerson] | None
) -> list[PosedPerson]:
    count = int(rng.choice(len(_COUNTS), p=_COUNTS))
    people: list[PosedPerson] = []
    for _ in range(count if draw_person else 0):
        assert draw_person is not None
        person = draw_person(rng)
        placed = _placed(rng, person, people)
        if placed is not None:
            people.append(placed)
    return people


def _support(
    rng: np.random.Generator, people: list[PosedPerson], place: Place
) -> tuple[list[PosedPerson], list[Solids], list[Layer]]:
    """The people as they lie on beds, what they lie or sit on and what stands by them, and blankets over them."""
    people = list(people)
    supports: list[Solids] = []
    blankets: list[Layer] = []
    for k, person in enumerate(people):
        people[k], support = _supported(rng, person)
        supports.append(support)
        place.occupy(_points(people[k]))
        if len(support) and rng.random() < _UNDER_BLANKET:
            blankets.append(blanket_over(rng, people[k]))
    for person in people:
        of_person = Place(_NO_EYES, person.joints, 0.0, 0.0)
        of_person.occupy(_points(person))
        under = seat(rng, of_person)
        if len(under):
            supports.append(under)
            if rng.random() < _WHEELCHAIR:
                supports.append(wheels(rng, person))
            elif rng.random() < _AT_TABLE:
                supports.append(_table_before(rng, person, place))
    for person in people:
        if rng.random() < _IN_DOORWAY:
            wall = _wall_end(rng, person)
            if not any(wall.hold_any(other.vertices[::9].astype(float)) for other in people if other is not person):
                supports.append(wall)
    return people, supports, blankets


def _points(person: PosedPerson) -> Float[ndarray, "p 3"]:
    return np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)]).astype(float)


def _placed(rng: np.random.Generator, person: PosedPerson, others: list[PosedPerson]) -> PosedPerson | None:
    """The person on the floor, turned at random, apart from the others by a plane or touching them."""
    person = person.moved(yaw(rng.uniform(-np.pi, np.pi)), np.zeros(3))
    points = _points(person)
    lowest = points[:, 2].min()
    for _ in range(_TRIES):
        if others and rng.random() < _BESIDE:
            other = others[int(rng.integers(len(others)))]
            azimuth = rng.uniform(-np.pi, np.pi)
            direction = np.array([np.cos(azimuth), np.sin(azimuth), 0])
            start = other.joints[_HIP] - person.joints[_HIP]
            apart = (_points(other)[::5] @ direction).max() - ((points[::5] + start) @ direction).min()
            offset = start + (apart + rng.uniform(-0.08, 0.5)) * direction
        else:
            angle, radius = rng.uniform(-np.pi, np.pi), _ABOUT_M * np.sqrt(rng.uniform())
            offset = np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0]) - person.joints[_HIP]
        offset[2] = -lowest
        moved = person.moved(np.eye(3), offset)
        if all(_apart(moved, other) for other in others):
            return moved
    return None


def _apart(one: PosedPerson, other: PosedPerson) -> bool:
    """Whether a vertical plane across the line between two people lets them overlap by no more than a touch."""
    line = other.joints[_HIP, :2] - one.joints[_HIP, :2]
    distance = float(np.linalg.norm(line))
    if distance < 0.2:
        return False
    direction = np.array([*line / distance, 0.0])
    return bool((_points(one)[::5] @ direction).max() < (_points(other)[::5] @ direction).min() + 0.1)


def _supported(rng: np.random.Generator, person: PosedPerson) -> tuple[PosedPerson, Solids]:
    """A lying person on a bed or couch, often; everybody else as they are."""
    size = np.ptp(_points(person), axis=0)
    if size[2] > _LYING_M or max(size[:2]) < _LYING * size[2] or rng.random() > _ON_BED:
        return person, NONE
    height = rng.uniform(0.02, 0.12) if rng.random() < 0.25 else rng.uniform(0.3, 0.75)
    return bed_under(rng, person, height)


def bed_under(rng: np.random.Generator, person: PosedPerson, height: float) -> tuple[PosedPerson, Solids]:
    """A lying person on a bed or couch of this height (metres), and the bed."""
    points = _points(person)
    low, high = points.min(0), points.max(0)
    size = high - low
    axis = np.array([size[0] >= size[1], size[1] > size[0]])
    half = np.maximum(size[:2] / 2 + rng.uniform(0.03, 0.4), np.where(axis, 0.95, 0.4))
    centre = (low + high)[:2] / 2 + rng.normal(0, 0.05, 2)
    sinks = rng.uniform(0, 0.05)
    parts = [box((*centre, height / 2), (*half, height / 2))]
    if rng.random() < 0.6:  # a headboard or the back of a couch
        side = int(rng.integers(2))
        at = centre.copy()
        at[side] += rng.choice([-1, 1]) * (half[side] + 0.04)
        thick = half.copy()
        thick[side] = 0.04
        top = height + rng.uniform(0.2, 0.6)
        parts.append(box((*at, top / 2), (*thick, top / 2)))
    if rng.random() < 0.5:
        head = person.joints[JOINT_INDEX["Head"]]
        parts.append(ellipsoid((head[0], head[1], height), (0.3, 0.25, max(head[2] - 0.1 - low[2], 0.03))))
    return person.moved(np.eye(3), np.array([0.0, 0.0, height - sinks - low[2]])), join(parts)


def wheels(rng: np.random.Generator, person: PosedPerson) -> Solids:
    """The wheels, handles and footrest of a wheelchair around a seated person."""
    right, left = person.joints[JOINT_INDEX["RHip"]], person.joints[JOINT_INDEX["LHip"]]
    feet = (person.joints[JOINT_INDEX["RFoot"]] + person.joints[JOINT_INDEX["LFoot"]]) / 2
    hips = (right + left) / 2
    side = (left - right) * [1, 1, 0]
    side /= np.linalg.norm(side)
    back = np.cross(side, [0.0, 0.0, 1.0])
    back *= -np.sign(back @ (feet - hips))
    turn = np.stack([side, np.cross([0.0, 0.0, 1.0], side), [0.0, 0.0, 1.0]], 1)
    radius, half = rng.uniform(0.25, 0.33), rng.uniform(0.24, 0.32)
    parts = []
    for sign in (-1, 1):
        hub = hips * [1, 1, 0] + sign * half * side + 0.05 * back + above(radius)
        parts.append(cylinder(hub - 0.015 * side, hub + 0.015 * side, radius))
        small = feet * [1, 1, 0] + 0.8 * sign * half * side + 0.1 * back + above(0.08)
        parts.append(cylinder(small - 0.015 * side, small + 0.015 * side, 0.08))
        arm = hips + 0.9 * sign * half * side + above(0.2)
        parts.append(box(arm - 0.1 * back, (0.03, 0.18, 0.02), turn))
    parts.append(box(feet - above(0.09), (0.16, 0.1, 0.015), turn))
    return join(parts)


def _table_before(rng: np.random.Generator, person: PosedPerson, place: Place) -> Solids:
    """A table before a seated person; nothing where there is no room for one."""
    hips = (person.joints[JOINT_INDEX["RHip"]] + person.joints[JOINT_INDEX["LHip"]]) / 2
    knees = (person.joints[JOINT_INDEX["RKnee"]] + person.joints[JOINT_INDEX["LKnee"]]) / 2
    ahead = (knees - hips)[:2]
    turn = yaw(float(np.arctan2(ahead[0], -ahead[1])))
    for _ in range(_TRIES):
        table = make_table(rng)
        around = table.corners.reshape(-1, 3)
        at = hips[:2] + ahead / np.linalg.norm(ahead) * (around[:, 1].max() + rng.uniform(0.2, 0.6))
        moved = table.moved(turn, np.array([*at, 0.0]))
        if place.accept(moved):
            return moved
    return NONE


def _wall_end(rng: np.random.Generator, person: PosedPerson) -> Solids:
    """A wall that ends at a person and hides one half of them from many sides."""
    length, thickness, height = rng.uniform(1.0, 3.0), rng.uniform(0.05, 0.25), rng.uniform(1.9, 2.6)
    turn = yaw(rng.uniform(-np.pi, np.pi))
    x, y, _ = trunk_centre(person.joints) + turn @ np.array([length / 2 + rng.normal(0, 0.15), rng.normal(0, 0.15), 0])
    return box((x, y, height / 2), (length / 2, thickness / 2, height / 2), turn)


def _standing(
    rng: np.random.Generator, piece: Solids, place: Place, low: Float[ndarray, "3"], high: Float[ndarray, "3"]
) -> Solids:
    """A piece somewhere on the floor; nothing where a few tries find no place."""
    for _ in range(_TRIES):
        at = rng.uniform(np.maximum(low[:2], -3), np.minimum(high[:2], 3))
        moved = piece.moved(yaw(rng.uniform(-np.pi, np.pi)), np.array([*at, 0.0]))
        if place.accept(moved):
            return moved
    return NONE


def _dolls(
    rng: np.random.Generator, draw_person: Callable[[np.random.Generator], PosedPerson]
) -> tuple[PosedPerson, ...]:
    """One doll or action figure, 0.15–0.32 m high, on the floor or at the height of a table."""
    person = draw_person(rng)
    size = float(np.ptp(person.body.vertices, axis=0).max())
    scale = rng.uniform(0.15, 0.32) / size
    azimuth = rng.uniform(-np.pi, np.pi)
    at = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * rng.uniform(0.3, 2.0)
    at[2] = rng.choice([0.0, rng.uniform(0.4, 1.0)])
    small = person.moved(scale * np.eye(3), np.zeros(3))
    lowest = np.array([0.0, 0.0, small.lowest_m])
    return (small.moved(np.eye(3), at - lowest - small.joints[_HIP] * [1, 1, 0]),)
