"""People in rooms as different depth sensors read them, with the labels: docs/images/engine.webp.

python examples/07_data_engine.py engine.webp
"""

import sys

import cv2
import numpy as np
from numpy import ndarray
from PIL import Image

from depthmocap.body.regions import DISPLAY_COLOURS
from depthmocap.frames import View
from depthmocap.synth.sample import CameraRange, Recipe, Sampler

SENSORS = ("kinect2", "azure-nfov-binned", "realsense-d435", "itop", "kinect1")
SIDE = 240


def picture(view: View) -> ndarray:
    """The depth above the labels, around the person. Grey in the labels is cloth or hair over no skin."""
    assert view.mask is not None and view.labels is not None
    rows, columns = np.nonzero(view.mask)
    height, width = view.depth_m.shape
    side = int(min(height, width, 1.25 * max(np.ptp(rows), np.ptp(columns))))
    top = min(max(int(rows.mean()) - side // 2, 0), height - side)
    left = min(max(int(columns.mean()) - side // 2, 0), width - side)
    part = slice(top, top + side), slice(left, left + side)
    depth, labels, mask = view.depth_m[part], view.labels[part], view.mask[part]
    near, far = np.quantile(depth[mask], 0.02) - 0.3, np.quantile(depth[mask], 0.98) + 1.5
    grey = (40 + 200 * np.clip((far - depth) / (far - near), 0, 1)).astype(np.uint8)
    image = np.ascontiguousarray(cv2.applyColorMap(grey, cv2.COLORMAP_BONE)[..., ::-1])
    image[depth == 0] = 0
    coloured = DISPLAY_COLOURS[labels]
    coloured[labels == 0] = image[labels == 0] // 3
    coloured[mask & (labels == 0)] = 120
    above = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.vstack([above, cv2.resize(coloured, (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)])


def shown(view: View) -> int:
    """How much of the person's skin can be labelled."""
    return 0 if view.labels is None else int(np.count_nonzero(view.labels))


def main(path: str) -> None:
    """One person a sensor, of three views the one that shows most of them."""
    cameras = CameraRange(distance_m=(2.0, 2.6), height_m=(0.9, 1.9))
    tiles = []
    for index, sensor in enumerate(SENSORS):
        recipe = Recipe("open", sensors=(sensor,), noise="sensor", scene="full", cameras=cameras)
        views = Sampler(recipe, seed=4)(index).views
        tiles.append(picture(max(views, key=shown)))
    Image.fromarray(np.hstack(tiles)).save(path, quality=85)


if __name__ == "__main__":
    main(sys.argv[1])
