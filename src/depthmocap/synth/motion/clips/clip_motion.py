"""The result of the readers of motion capture files: a tree of joints and its rotations, in the file's axes."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """A moving skeleton. In the zero pose all rotations are the identity.

    Attributes:
        names: joints, parents before their children; the first is the root.
        parents: index of every joint's parent, −1 for the root.
        offsets: from the parent's joint in the zero pose, in the file's unit of length.
        ends: from the last joint of a limb to its tip; zeros if a joint has children or the file has no tip.
        rotations: of every joint relative to its parent.
        frame_time_s: seconds between frames.
        root_path: positions of the root, in the file's axes and unit of length; zeros if the file has none.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[ndarray, "j 3"]
    ends: Float[ndarray, "j 3"]
    rotations: Float[ndarray, "n j 3 3"]
    frame_time_s: float
    root_path: Float[ndarray, "n 3"]

    def world_rotations(self) -> Float[ndarray, "n j 3 3"]:
        """Rotation of every joint away from the zero pose, in the file's world."""
        world = self.rotations.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                world[:, joint] = world[:, parent] @ self.rotations[:, joint]
        return world

    def children(self, joint: int) -> list[int]:
        """Children of a joint."""
        return [child for child, parent in enumerate(self.parents) if parent == joint]

    def ancestors(self, joint: int) -> list[int]:
        """A joint, its parent, and so on up to the root."""
        chain = [joint]
        while self.parents[chain[-1]] >= 0:
            chain.append(self.parents[chain[-1]])
        return chain

    def common_ancestor(self, joints: list[int]) -> int:
        """The lowest common ancestor of some joints (possibly one of them)."""
        shared = set(self.ancestors(joints[0])).intersection(*(self.ancestors(joint) for joint in joints[1:]))
        return max(shared, key=lambda joint: len(self.ancestors(joint)))

    def tail(self, joint: int) -> Float[ndarray, "3"]:
        """From a joint to the nearest descendant at another position, in the zero pose (for a hand: the middle finger);
        zeros if there is none."""
        children = sorted(self.children(joint), key=lambda child: "mid" not in self.names[child].lower())
        for child in children:
            if np.linalg.norm(self.offsets[child]) > 1e-6:
                return self.offsets[child]
        for child in children:
            if "umb" not in self.names[child]:
                return self.tail(child)
        return self.ends[joint]

    def heads(self, world: Float[ndarray, "j 3 3"]) -> Float[ndarray, "j 3"]:
        """Places of the joints under world rotations, the root at the origin."""
        places = np.zeros((len(self.names), 3))
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                places[joint] = places[parent] + world[parent] @ self.offsets[joint]
        return places


def frame_step(frame_time_s: float) -> int:
    """Frames to go on at a time for about 30 postures a second."""
    return max(1, round(1 / 30 / frame_time_s))


def reason(error: Exception) -> str:
    """Why a file could not be parsed, in one line. The BVH parser's errors carry open files after their message."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    if isinstance(error, UnicodeDecodeError):
        return "it is not text"
    if isinstance(error, KeyError):
        return f"it lacks {error}"
    if isinstance(error, IndexError):
        return "a line is cut off"
    return str(error.args[0]) if error.args else type(error).__name__
