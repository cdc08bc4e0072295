"""A contact sheet of the sensors: one person in one room, exact, as each sensor reads it, and the difference."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray
from PIL import Image

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import atomic_write
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.perform import pose_sequence
from depthmocap.synth.motion.sequence import demo_motion
from depthmocap.synth.people.bodies import ONE_CHARACTER
from depthmocap.synth.people.garments import clothe
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES
from depthmocap.synth.render import PosedPerson, render_person
from depthmocap.synth.scenes.room import Box, Room, render_room
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS, SensorPreset

#: Sensors that differ from no other on the sheet; the modes of a Femto Bolt are those of an Azure Kinect.
SHOWN = tuple(name for name in SENSORS if not name.startswith("femto"))
_ROOM = Room(Box((-2.2, -2.4, 0.0), (2.2, 1.3, 2.6)), (Box((0.75, 0.3, 0.0), (1.25, 0.9, 0.7)),))
_TITLES = ("exact", "as read", "difference, ±3 cm", "a silhouette, exact", "as read")
_DIFFERENCE_M = 0.03
#: When the person of the demo's motion is shown.
_TIME_S = 0.2
#: Positions of the cameras relative to the floor below the person (metres),
_EYE = np.array([0.5, -1.75, 1.25])
#: and of the point they look at (metres).
_TARGET = np.array([0.0, 0.0, 0.95])


@dataclasses.dataclass(frozen=True)
class SensorSheetSettings:
    """One person in one room as every sensor reads it.

    Attributes:
        out: the picture, .png or .webp.
        seed: of the sensors' errors.
    """

    out: Path = Path("sensors.webp")
    seed: int = 0

    def __post_init__(self) -> None:
        if self.out.suffix.lower() not in (".png", ".webp"):
            raise InputError(f"--out must end in .png or .webp, got {self.out}")
        check_seed(self.seed)


@locks_outputs(files=("out",))
def write_sensor_sheet(settings: SensorSheetSettings) -> None:
    """The command: see :func:`sensor_sheet`."""
    sensor_sheet(settings.out, settings.seed)
    Terminal().print(f"wrote {settings.out}")


def sensor_sheet(path: Path, seed: int = 0) -> None:
    """Write the sheet, a picture 1400 pixels wide. Needs the extra ``train``.

    Raises:
        InputError: when the file cannot be written.
    """
    clothed = clothe(BodyModel.load().shape(ONE_CHARACTER), ORDINARY_CLOTHES, np.random.default_rng(0))
    person = next(pose_sequence(clothed, demo_motion(clothed, np.array([_TIME_S]))))
    blocks = 2
    rows = -(-len(SHOWN) // blocks)
    figure = Figure(figsize=(14, 1.5 * rows), dpi=100, layout="constrained", facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(rows, blocks * len(_TITLES), squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for i, name in enumerate(SHOWN):
        row, first = i % rows, i // rows * len(_TITLES)
        pictures = _pictures(person, SENSORS[name], np.random.default_rng([seed, i]))
        for k, picture in enumerate(pictures):
            axes[row, first + k].imshow(picture, interpolation="nearest")
            if row == 0:
                axes[row, first + k].set_title(_TITLES[k], fontsize=7, color="#6b737c")
        axes[row, first].text(
            0.0, -0.04, name, transform=axes[row, first].transAxes, va="top", fontsize=8, color="#2a2f35"
        )
    canvas.draw()
    with atomic_write(path) as unfinished:
        Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).save(unfinished, quality=80)


def _pictures(person: PosedPerson, preset: SensorPreset, rng: np.random.Generator) -> list[UInt8[ndarray, "_h _w 3"]]:
    middle = np.array([*person.joints[0, :2], 0.0])
    camera = preset.camera("camera", look_at(middle + _EYE, middle + _TARGET))
    view = render_person(person, camera, render_room(_ROOM, camera))
    read = sense(view.depth_m, view.material, camera, preset.model, rng)
    whole = _window(view.person, 1.15)
    head = _window(view.person & (np.arange(camera.height)[:, None] < _top(view.person, 0.3)), 0.7)
    shown = np.stack([view.depth_m, read], 1)
    depths = np.percentile(view.depth_m[view.person], [1, 99])
    pictures = [_coloured(shown[whole[0], i, whole[1]], *depths) for i in range(2)]
    pictures.append(_difference(view.depth_m[whole], read[whole]))
    pictures += [_coloured(shown[head[0], i, head[1]], *depths) for i in range(2)]
    return pictures


def _top(person: Bool[ndarray, "h w"], share: float) -> int:
    """The row that share of the person's height below the crown."""
    rows = np.flatnonzero(person.any(1))
    return int(rows[0] + share * (rows[-1] - rows[0]))


def _window(mask: Bool[ndarray, "h w"], scale: float) -> tuple[slice, slice]:
    """A square around the mask's middle, ``scale`` times its longer side, cut at the picture's border."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    half = scale * max(np.ptp(rows), np.ptp(columns)) / 2
    top, left = (rows[0] + rows[-1]) / 2 - half, (columns[0] + columns[-1]) / 2 - half
    return slice(max(int(top), 0), int(top + 2 * half)), slice(max(int(left), 0), int(left + 2 * half))


def _coloured(depth: Float[ndarray, "h w"], near_m: float, far_m: float) -> UInt8[ndarray, "h w 3"]:
    """The person's depths in colour, red near and blue far; far background is grey, invalid pixels are black."""
    level = np.clip((depth - near_m) / (far_m - near_m), 0, 1)
    turbo = cv2.applyColorMap((255 * (0.95 - 0.85 * level)).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    grey = np.clip(130 - 25 * (depth - far_m), 60, 130).astype(np.uint8)
    turbo = np.where((depth > far_m + 0.15)[..., None], grey[..., None], turbo)
    return np.where((depth > 0)[..., None], turbo, 0).astype(np.uint8)


def _difference(exact: Float[ndarray, "h w"], read: Float[ndarray, "h w"]) -> UInt8[ndarray, "h w 3"]:
    """Blue where the reading is too near, red where too far, black where it is lost."""
    share = np.clip((read - exact) / _DIFFERENCE_M, -1, 1)[..., None]
    white, red, blue = np.array([235, 235, 235]), np.array([190, 30, 30]), np.array([30, 70, 190])
    colour = white + np.abs(share) * (np.where(share > 0, red, blue) - white)
    return np.where(((read > 0) & (exact > 0))[..., None], colour, 0).astype(np.uint8)
