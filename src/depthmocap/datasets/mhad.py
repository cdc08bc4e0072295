"""Berkeley MHAD: twelve people, eleven actions, five repetitions, seen by two opposing Kinect 1 and a marker system.

    Kinect/Kin0K/SNN/ANN/RNN/kin_k0K_sNN_aNN_rNN_depth_%05d.pgm
    Kinect/Correspondences/corr_moc_kin0K_sNN_aNN_rNN.txt
    Mocap/SkeletalData/skl_sNN_aNN_rNN.bvh
    Calibration/camcfg_k0K.yml, Calibration/RwTw_k0K.txt

The world is the marker system's, Y up, here in metres. The 640×480 pictures need no scaling to look like a Kinect 2's:
the classifier's window is scaled by the person's size, and holds the size of a pixel in metres.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.core.reading.input_files import read_bytes, read_text
from depthmocap.datasets.annotated import AnnotatedFrame
from depthmocap.datasets.bvh_joints import BvhJoints, read_bvh_joints
from depthmocap.datasets.volume import Volume, scene_background
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import is_rigid, rigid_inverse
from depthmocap.segment.static_scene import PersonSegmenter

#: Columns of a depth picture.
WIDTH = 640
#: Rows of a depth picture.
HEIGHT = 480
KINECTS = (1, 2)
_ARM = ("Collar", "Shoulder", "Arm", "Elbow", "Forearm", "Hand", "HandEnd")
_LEG = ("Hip", "Thigh", "Knee", "Shin", "Foot", "Toe", "ToeEnd")
#: Our names of the 30 joints and 5 ends of a skeleton, depth first: trunk, arms, legs. Arm, Forearm, Thigh and Shin
#: are the middles of the bones.
MHAD_JOINTS = (
    *("Hips", "Spine1", "Spine2", "Spine3", "Neck", "Head", "HeadEnd"),
    *(side + joint for limb in (_ARM, _LEG) for side in "RL" for joint in limb),
)
_LIMB = len(_ARM)
_ENDS = range(_LIMB - 1, len(MHAD_JOINTS), _LIMB)
#: Our nearest joint of some of their joints.
MHAD_CORRESPONDENCE = {
    "Hips": "Hip", "Spine1": "Spine", "Spine2": "Spine1", "Spine3": "Spine2", "Neck": "Neck", "Head": "Head",
    **{side + joint: side + ours for side in "RL" for joint, ours in (
        ("Shoulder", "Shoulder"), ("Elbow", "Elbow"), ("Hand", "Hand"), ("Hip", "Hip"), ("Knee", "Knee"),
        ("Foot", "Foot"),
    )},
}  # fmt: skip
ACTIONS = {
    "a01": "jumping", "a02": "jumping jacks", "a03": "bending", "a04": "punching", "a05": "waving both hands",
    "a06": "waving one hand", "a07": "clapping", "a08": "throwing", "a09": "sitting down and standing up",
    "a10": "sitting down", "a11": "standing up",
}  # fmt: skip
#: Largest text file, bytes.
_LARGEST_TEXT = 1 << 24
#: Largest picture, bytes, with some room for comments.
_LARGEST_PGM = 2 * WIDTH * HEIGHT + (1 << 16)
#: Comments end with their line, so that matching never backtracks.
_PGM = re.compile(rb"P5\s+(?:#[^\n]*\n\s*)*(\d{1,5})\s+(\d{1,5})\s+(\d{1,5})\s")
_UNIT_M = 0.01  # of the skeletons: ten times their numbers are millimetres
_TRUNK = [MHAD_JOINTS.index(name) for name in ("Spine1", "Spine2", "Spine3", "Neck")]
#: Number of sequences from which the background is estimated.
_SAMPLED_SEQUENCES = 12
#: Number of frames from each of them.
_SAMPLED_FRAMES = 4
#: Least share of the sampled frames in which the true trunk must lie on the person.
_LEAST_ON_PERSON = 0.5


@dataclasses.dataclass(frozen=True, order=True)
class Sequence:
    """One repetition of an action by a subject."""

    subject: int
    action: int
    repetition: int

    def __str__(self) -> str:
        return f"s{self.subject:02d}_a{self.action:02d}_r{self.repetition:02d}"

    def depth_path(self, root: Path, kinect: int, frame: int) -> Path:
        """The depth picture of a Kinect's frame."""
        folders = (f"Kin{kinect:02d}", f"S{self.subject:02d}", f"A{self.action:02d}", f"R{self.repetition:02d}")
        return Path(root, "Kinect", *folders, f"kin_k{kinect:02d}_{self}_depth_{frame:05d}.pgm")

    def skeleton_path(self, root: Path) -> Path:
        """The marker system's skeleton."""
        return root / "Mocap" / "SkeletalData" / f"skl_{self}.bvh"

    def correspondence_path(self, root: Path, kinect: int) -> Path:
        """Which frame of the marker system each Kinect frame belongs to."""
        return root / "Kinect" / "Correspondences" / f"corr_moc_kin{kinect:02d}_{self}.txt"


class MhadSet:
    """The frames of both Kinects with the marker system's joints (see ``AnnotatedSet``).

    A frame of Kinect 1 and the nearest in time of Kinect 2 are a pair. Frames without a partner within half a frame
    period are skipped, as are missing and unreadable files (``problems``).
    """

    name = "Berkeley MHAD"
    joints = MHAD_JOINTS
    correspondence = MHAD_CORRESPONDENCE
    up = "y"

    def __init__(
        self, root: Path, subjects: tuple[int, ...] = (), actions: tuple[int, ...] = (), every: int = 1
    ) -> None:
        """
        Args:
            root: holds Kinect, Mocap and Calibration.
            subjects: numbers of the subjects to read, by default all.
            actions: numbers of the actions to read, by default all.
            every: read every ``every``-th frame only.

        Raises:
            InputError: when no sequence is found, or the calibration is missing or malformed.
        """
        if every < 1:
            raise InputError(f"--every must be at least 1, got {every}")
        self.root, self.every, self.fps = root, every, 30.0 / every
        self.problems: list[str] = []
        sequences = _sequences(root)
        if not sequences:
            raise InputError(
                f"{root} holds no Mocap/SkeletalData/skl_sNN_aNN_rNN.bvh: give the folder with the Kinect, Mocap and "
                "Calibration folders of Berkeley MHAD"
            )
        self.sequences = [
            sequence for sequence in sequences
            if (not subjects or sequence.subject in subjects) and (not actions or sequence.action in actions)
        ]  # fmt: skip
        if not self.sequences:
            raise InputError(f"{root} holds none of the subjects {subjects or 'all'} and actions {actions or 'all'}")
        self.cameras = {kinect: read_mhad_camera(root, kinect) for kinect in KINECTS}

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        """Frames sequence by sequence, both views masked.

        Raises:
            InputError: when the calibration disagrees with the pictures.
        """
        self.problems.clear()
        for kinect in KINECTS:
            absent = [s for s in self.sequences if not self._has_depth(s, kinect)]
            if absent:
                folder = absent[0].depth_path(self.root, kinect, 0).parent
                self.problems.append(f"{len(absent)} sequences left out, the first because {folder} not found")
        for sequence in self._with_depth:
            lost: list[str] = []
            try:
                frames, joints_world = self._open(sequence)
            except InputError as error:
                self.problems.append(f"{sequence}: left out, {error}")
                continue
            for pair, joints in zip(frames, joints_world, strict=True):
                try:
                    views = tuple(self._view(sequence, k, int(i)) for k, i in zip(KINECTS, pair, strict=True))
                except InputError as error:
                    lost.append(str(error))
                    continue
                masked = tuple(dataclasses.replace(view, mask=self.segmenter(view)) for view in views)
                subject, action = f"s{sequence.subject:02d}", f"a{sequence.action:02d}"
                yield AnnotatedFrame(masked, joints, subject, action, int(pair[0]))
            if lost:
                self.problems.append(f"{sequence}: {len(lost)} of {len(frames)} frames left out, the first: {lost[0]}")

    @functools.cached_property
    def segmenter(self) -> PersonSegmenter:
        """Background subtraction with a background from frames spread over the sequences (``volume``).

        Raises:
            InputError: when no frame can be read, or the true trunk is not where the pictures show the person.
        """
        samples: dict[int, list[View]] = collections.defaultdict(list)
        truths: list[ndarray] = []
        sequences = self._with_depth
        spread = np.linspace(0, len(sequences) - 1, min(_SAMPLED_SEQUENCES, len(sequences))).round().astype(int)
        for sequence in [sequences[i] for i in spread]:
            try:
                frames, joints_world = self._open(sequence)
            except InputError:
                continue  # reported when the sequence is read
            for i in np.unique(np.linspace(0, len(frames) - 1, _SAMPLED_FRAMES).round().astype(int)):
                try:
                    views = [self._view(sequence, k, int(f)) for k, f in zip(KINECTS, frames[i], strict=True)]
                except InputError:
                    continue
                for kinect, view in zip(KINECTS, views, strict=True):
                    samples[kinect].append(view)
                truths.append(joints_world[i])
        if not truths:
            raise InputError(f"{self.root}: of the sequences tried none has depth of both Kinects and a skeleton")
        space = Volume.around(np.concatenate(truths), self.up)
        segmenter = PersonSegmenter({
            camera.name: scene_background([view.depth_m for view in samples[kinect]], camera, space)
            for kinect, camera in self.cameras.items()
        })  # fmt: skip
        for kinect in KINECTS:
            self._check_calibration(kinect, samples[kinect], truths, segmenter)
        return segmenter

    def _has_depth(self, sequence: Sequence, kinect: int) -> bool:
        return sequence.depth_path(self.root, kinect, 0).parent.is_dir()

    @property
    def _with_depth(self) -> list[Sequence]:
        return [sequence for sequence in self.sequences if all(self._has_depth(sequence, kinect) for kinect in KINECTS)]

    def _check_calibration(
        self, kinect: int, views: list[View], truths: list[ndarray], segmenter: PersonSegmenter
    ) -> None:
        on_person = []
        for view, joints in zip(views, truths, strict=True):
            row, column = view.camera.nearest_pixels(joints[_TRUNK])
            inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
            mask = segmenter(view)
            on_person += [bool(here and mask[r, c]) for here, r, c in zip(inside, row, column, strict=True)]
        if np.mean(on_person) < _LEAST_ON_PERSON:
            raise InputError(
                f"{self.root / 'Calibration'}: RwTw_k{kinect:02d}.txt and camcfg_k{kinect:02d}.yml disagree with the "
                f"pictures: they put the true trunk on the person in {np.mean(on_person):.0%} of {len(views)} sampled "
                "frames; take the calibration that came with these recordings"
            )

    def _open(self, sequence: Sequence) -> tuple[Int[ndarray, "n 2"], Float[ndarray, "n 35 3"]]:
        """Pairs of Kinect frames of a sequence, and their joints (metres)."""
        mocap_frames = [_correspondences(sequence.correspondence_path(self.root, kinect)) for kinect in KINECTS]
        pairs = _pairs(*mocap_frames)[:: self.every]
        if not len(pairs):
            raise InputError(
                f"{sequence.correspondence_path(self.root, 2)} has no frame at the time of one of Kinect 1"
            )
        path = sequence.skeleton_path(self.root)
        motion = read_bvh_joints(path)
        mocap = mocap_frames[0][pairs[:, 0]]
        if mocap.max() >= len(motion.values):
            raise InputError(
                f"{path} has {len(motion.values)} frames, but {sequence.correspondence_path(self.root, 1)} asks for "
                f"frame {mocap.max()}"
            )
        return pairs, mhad_joints(motion, path, mocap)

    def _view(self, sequence: Sequence, kinect: int, frame: int) -> View:
        raw = read_pgm(sequence.depth_path(self.root, kinect, frame))
        return View(self.cameras[kinect], self.cameras[kinect].to_metres(raw))


def mhad_joints(motion: BvhJoints, path: Path, frames: Int[ndarray, "n"]) -> Float[ndarray, "n 35 3"]:
    """Joints of frames of a skeleton, metres, in the order of ``MHAD_JOINTS``.

    The right limbs follow from the frames: they are on the right in the direction of the toes.

    Raises:
        InputError: when the skeleton is not of 30 joints and 5 ends in the known order.
    """
    skeleton = motion.skeleton
    if tuple(np.flatnonzero(skeleton.is_end)) != tuple(_ENDS):
        raise InputError(
            f"{path} has {len(skeleton.names)} joints and ends, expected {len(MHAD_JOINTS)}: seven of the trunk, the "
            "arms and the legs each, the last of each seven an end"
        )
    joints = motion.positions(frames) * _UNIT_M
    arm, leg = _LIMB, 3 * _LIMB
    foot, toe = _LEG.index("Foot"), _LEG.index("ToeEnd")
    toes = sum(joints[:, first + toe] - joints[:, first + foot] for first in (leg, leg + _LIMB))
    right = np.cross(toes, [0.0, 1.0, 0.0])
    order = list(range(_LIMB))
    for first, joint in ((arm, _ARM.index("Shoulder")), (leg, _LEG.index("Hip"))):
        sides = [first, first + _LIMB]
        if ((joints[:, sides[1] + joint] - joints[:, sides[0] + joint]) * right).sum() > 0:
            sides.reverse()
        order += [start + i for start in sides for i in range(_LIMB)]
    return joints[:, order]


def read_mhad_camera(root: Path, kinect: int) -> DepthCamera:
    """A Kinect's calibration: intrinsics, lens and ``X_camera = Rw X_world + Tw`` (files in millimetres).

    Raises:
        InputError: when a file is missing or malformed, or does not suit 640×480 pictures.
    """
    lens, pose = (root / "Calibration" / name for name in (f"camcfg_k{kinect:02d}.yml", f"RwTw_k{kinect:02d}.txt"))
    lens_text, text = (
        read_text(path, _LARGEST_TEXT, "the Calibration folder of Berkeley MHAD is needed") for path in (lens, pose)
    )
    try:
        storage = cv2.FileStorage(lens_text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        node = storage.getNode("Camera_1")
        matrix, distortion = node.getNode("K").mat(), node.getNode("Dist").mat()
    except (cv2.error, SystemError):  # SystemError: OpenCV cannot pass its error on
        matrix = distortion = None
    if matrix is None or matrix.shape != (3, 3) or distortion is None or distortion.size < 4:
        raise InputError(f"{lens} must hold Camera_1 with K (3×3) and Dist (four numbers)")
    if not (0 < matrix[0, 2] < WIDTH and 0 < matrix[1, 2] < HEIGHT and min(matrix[0, 0], matrix[1, 1]) > 0):
        raise InputError(f"{lens}: K is not of a {WIDTH}×{HEIGHT} picture: centre {matrix[0, 2]:g}, {matrix[1, 2]:g}")
    camera_from_world = np.eye(4)
    for key, part in (("Rw", np.s_[:3, :3]), ("Tw", np.s_[:3, 3])):
        match = re.search(rf"^\s*{key}\s*=(.*)$", text, re.MULTILINE)
        words = match.group(1).split() if match else []
        shape = camera_from_world[part].shape
        try:
            camera_from_world[part] = np.array(words, np.float64).reshape(shape)
        except ValueError:
            raise InputError(f"{pose} must hold a line {key}= with {np.prod(shape)} numbers") from None
    camera_from_world[:3, 3] /= 1000
    if not is_rigid(camera_from_world):
        raise InputError(f"{pose}: Rw is not a rotation")
    k1, k2, p1, p2 = map(float, distortion.ravel()[:4])
    fx, fy, cx, cy = map(float, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    world_from_camera = rigid_inverse(camera_from_world)
    return DepthCamera(f"Kinect {kinect}", WIDTH, HEIGHT, fx, fy, cx, cy, world_from_camera, (k1, k2, p1, p2, 0.0))


def read_pgm(path: Path) -> ndarray:
    """A 640×480 PGM of 16 bits, most significant byte first.

    Raises:
        InputError: when it is missing, cut off or of another kind.
    """
    data = read_bytes(path, _LARGEST_PGM)
    header = _PGM.match(data)
    if header is None or int(header[3]) < 256 or (int(header[1]), int(header[2])) != (WIDTH, HEIGHT):
        raise InputError(f"{path} is not a binary PGM of {WIDTH}×{HEIGHT} pixels and 16 bits")
    pixels = data[header.end() :]
    if len(pixels) < 2 * WIDTH * HEIGHT:
        raise InputError(f"{path} is cut off: {len(pixels)} of {2 * WIDTH * HEIGHT} bytes")
    return np.frombuffer(pixels, ">u2", WIDTH * HEIGHT).reshape(HEIGHT, WIDTH).astype(np.uint16)


def _sequences(root: Path) -> list[Sequence]:
    """All sequences with a skeleton or correspondences, so that their missing files can be reported."""
    names = [path.stem for path in (root / "Mocap" / "SkeletalData").glob("skl_*.bvh")]
    names += [path.stem for path in (root / "Kinect" / "Correspondences").glob("corr_moc_kin*.txt")]
    matches = (re.search(r"_s(\d\d)_a(\d\d)_r(\d\d)$", name) for name in names)
    return sorted({Sequence(*map(int, match.groups())) for match in matches if match})


def _correspondences(path: Path) -> Int[ndarray, "n"]:
    """The marker system's frame of each Kinect frame."""
    rows = [line for line in read_text(path, _LARGEST_TEXT).split("\n") if line.partition("#")[0].strip()]
    try:
        table = np.loadtxt(rows, ndmin=2) if rows else np.empty((0, 3))
    except ValueError as error:
        raise InputError(f"{path} cannot be read: {error}") from None
    # A number that is not finite fails both comparisons.
    if table.shape[1] < 3 or not len(table) or not ((table[:, 2] >= 0) & (table[:, 2] < 2**31)).all():
        raise InputError(f"{path} must hold three columns, the third a frame of the marker system, in a row per frame")
    return table[:, 2].astype(np.int64)


def _pairs(first: Int[ndarray, "n"], second: Int[ndarray, "m"]) -> Int[ndarray, "p 2"]:
    """Frames of both Kinects at the same time, to half a frame period; times are frames of the marker system."""
    period = float(np.median(np.diff(first))) if len(first) > 1 else 16.0
    nearest = np.abs(first[:, None] - second[None]).argmin(1)
    near = np.abs(first - second[nearest]) <= max(period / 2, 1)
    return np.stack([np.flatnonzero(near), nearest[near]], 1)
