"""The surroundings of a person: a furnished room, held and worn objects, a second person. All are background.

scene = random_scene(rng, person, cameras, FULL, make_person)
background_m, material = render_scene(scene, cameras[0])
rendering = render_person(person, cameras[0], background_m, material)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.synth.render import Material, PosedPerson, draw_mesh
from depthmocap.synth.scenes.furniture import yaw
from depthmocap.synth.scenes.objects import held_object
from depthmocap.synth.scenes.placing import Place, furnish, room_shell, seat
from depthmocap.synth.scenes.solids import NONE, Solids, capsules, join
from depthmocap.synth.scenes.worn import worn_object

#: Another person, or how to make one; it is turned and moved to its place.
SecondPerson: TypeAlias = PosedPerson | Callable[[np.random.Generator], PosedPerson]

_TRIES = 6


@dataclasses.dataclass(frozen=True)
class SceneSettings:
    """Probabilities of a scene's parts. The numbers of the presets are our choice.

    Attributes:
        room: probability of a floor, walls and a ceiling.
        furniture: least and largest number of pieces; without a room they stand around the person.
        hiding: share of the pieces that are put between a camera and the person, where there is room.
        held_object: probability of something in the hands.
        worn_object: probability of something on the back, shoulder, belly or head.
        second_person: probability of another person.
        walls_m: distance of the walls from the person, wider where cameras stand farther.
        second_person_m: distance between the two persons' hips, wider where they would touch.
        seen_by_one: least share of the joints that the scene does not hide from at least one camera.
        seen_by_each: the same for every camera.
    """

    room: float = 0.0
    furniture: tuple[int, int] = (0, 0)
    hiding: float = 0.3
    held_object: float = 0.0
    worn_object: float = 0.0
    second_person: float = 0.0
    walls_m: tuple[float, float] = (1.0, 4.0)
    second_person_m: tuple[float, float] = (0.4, 2.0)
    seen_by_one: float = 0.75
    seen_by_each: float = 0.4

    def __post_init__(self) -> None:
        for name in ("room", "hiding", "held_object", "worn_object", "second_person", "seen_by_one", "seen_by_each"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise InputError(f"scene: {name} must be 0 to 1, got {value}")
        for name in ("furniture", "walls_m", "second_person_m"):
            low, high = getattr(self, name)
            if low > high:
                raise InputError(f"scene: {name} has its minimum {low} above its maximum {high}: exchange them")
            if not (low >= 0 and np.isfinite(high)):
                raise InputError(f"scene: {name} must be finite and not negative, got {low} to {high}")


#: Nothing around the person, as in the paper.
OFF = SceneSettings()
#: For a network that labels segmented people: objects that hide them or touch them.
TRAINING = SceneSettings(furniture=(0, 2), hiding=1.0, held_object=0.25, worn_object=0.2, second_person=0.15)
#: Whole pictures of furnished rooms, for segmentation and detection.
FULL = SceneSettings(
    room=1.0, furniture=(4, 12), hiding=0.15, held_object=0.25, worn_object=0.25, second_person=0.25
)  # fmt: skip
SCENE_PRESETS = {"off": OFF, "training": TRAINING, "full": FULL}


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """The surroundings of a person, in the world.

    Attributes:
        shell: floor, walls and ceiling; empty without a room.
        furniture: furniture in the room or around the person.
        objects: objects that the person holds or wears.
        second: another person.
    """

    shell: Solids = NONE
    furniture: Solids = NONE
    objects: Solids = NONE
    second: PosedPerson | None = None

    @property
    def solids(self) -> Solids:
        """All but the second person."""
        return join([self.shell, self.furniture, self.objects])

    def contains(self, eye: Float[ndarray, "3"]) -> bool:
        """Whether a camera there is inside the room; True without a room."""
        return not len(self.shell) or self.shell.hold_any(eye[None].astype(float))


def random_scene(
    rng: np.random.Generator,
    person: PosedPerson,
    cameras: Sequence[DepthCamera],
    settings: SceneSettings,
    second_person: SecondPerson | None = None,
) -> Scene:
    """A scene around a person: the floor at the lowest point, the room around all cameras, nothing in the body or
    within half a metre of a camera, and the person in sight as the settings ask: what would hide more is left out.

    Raises:
        ValueError: when the settings want a second person and none is given.
    """
    if settings.second_person > 0 and second_person is None:
        raise ValueError("second_person must be given: the settings ask for one")
    eyes = np.array([c.world_from_camera[:3, 3] for c in cameras], dtype=float).reshape(-1, 3)
    everything = _all_points(person)
    floor_m = float(min([everything[:, 2].min(), *(eyes[:, 2] - 0.1)]))
    place = Place(eyes, person.joints, settings.seen_by_one, settings.seen_by_each)
    place.occupy(everything)

    objects = []
    if rng.random() < settings.worn_object:
        objects.append(worn_object(rng, person))
    if rng.random() < settings.held_object:
        objects.append(held_object(rng, person, floor_m))
    objects = join([thing for thing in objects if place.accept(thing, clear_of_body=False)])

    second = None
    if rng.random() < settings.second_person and second_person is not None:
        other = second_person if isinstance(second_person, PosedPerson) else second_person(rng)
        second = _place_second(rng, other, place, person, floor_m, settings.second_person_m)

    has_room = rng.random() < settings.room
    count = int(rng.integers(settings.furniture[0], settings.furniture[1] + 1))
    if not has_room and count == 0:
        return Scene(objects=objects, second=second)
    # The room has its own axes, its origin on the floor below the hips.
    origin = np.array([*person.joints[JOINT_INDEX["Hip"]][:2], floor_m])
    turn = yaw(rng.uniform(-np.pi, np.pi))
    local = place.moved(turn.T, -turn.T @ origin)
    shell = room_shell(rng, local, settings.walls_m)
    pieces = [seat(rng, local)] if count else []
    pieces += furnish(rng, local, shell, count, settings.hiding, against_walls=has_room)
    furniture = join(pieces).moved(turn, origin)
    return Scene(shell.moved(turn, origin) if has_room else NONE, furniture, objects, second)


def _all_points(person: PosedPerson) -> Float[ndarray, "p 3"]:
    return np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)]).astype(float)


def _place_second(
    rng: np.random.Generator,
    other: PosedPerson,
    place: Place,
    person: PosedPerson,
    floor_m: float,
    distance_m: tuple[float, float],
) -> PosedPerson | None:
    """The other person beside the first on the same floor; None where a few tries find no place.

    A plane between the two keeps them apart, so that they cannot touch in any posture."""
    hip = JOINT_INDEX["Hip"]
    for _ in range(_TRIES):
        azimuth, distance = rng.uniform(-np.pi, np.pi), rng.uniform(*distance_m)
        direction = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        turned = other.moved(yaw(rng.uniform(-np.pi, np.pi)), np.zeros(3))
        points = _all_points(turned)
        start = person.joints[hip] - turned.joints[hip]
        apart = (place.points @ direction).max() - ((points + start) @ direction).min()
        offset = start + max(distance, apart + 0.02) * direction
        offset[2] = floor_m - points[:, 2].min()
        turned = turned.moved(np.eye(3), offset)
        if place.accept(_stand_in(turned.joints), clear_of_body=False):
            place.occupy(_all_points(turned))
            return turned
    return None


def _stand_in(joints: Float[ndarray, "18 3"]) -> Solids:
    """Capsules along the bones, about as thick as a body, to test what the body hides."""
    ends = np.array([(JOINT_INDEX[a], JOINT_INDEX[b]) for a, b in BONES])
    trunk = np.array(["Sp" in b or "Hip" in b or "Neck" in b for _, b in BONES])
    return capsules(joints[ends[:, 0]], joints[ends[:, 1]], np.where(trunk, 0.14, 0.07))


def render_scene(scene: Scene, camera: DepthCamera) -> tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """Depth (metres along z, 0 where nothing is) and material of a scene without the person.

    The solids are cast through the lens's distortion; a second person is drawn without.

    Raises:
        ValueError: when the camera is outside the room.
    """
    eye = camera.world_from_camera[:3, 3]
    if not scene.contains(eye):
        raise ValueError(f"camera {camera.name!r} at {eye.round(2)} must be inside the room")
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    material = np.zeros(depth.shape, dtype=np.uint8)
    scene.solids.draw(camera, depth, material)
    if scene.second is not None:
        body = scene.second.body
        for vertices, faces in (
            (body.vertices, body.faces),
            *((layer.vertices, layer.faces) for layer in scene.second.layers),
        ):
            values = np.full(len(faces), Material.SECOND_PERSON, dtype=np.uint8)
            draw_mesh(vertices, faces, values, camera, depth, material, two_sided=True)
    depth[np.isinf(depth)] = 0
    return depth, material
