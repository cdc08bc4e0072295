"""The coarse grid of the network that finds people."""

import dataclasses

import numpy as np
import pytest

from depthmocap.geometry import DepthCamera, look_at
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, GRID_STEP, DepthGrid

KINECT = DepthCamera("kinect", 512, 424, 365.0, 365.0, 255.5, 211.5)


@pytest.mark.parametrize(("width", "height", "focal"), [(512, 424, 365.0), (320, 240, 285.6), (160, 120, 90.0)])
def test_a_cell_has_the_same_angle_for_every_camera(width, height, focal):
    grid = DepthGrid(DepthCamera("c", width, height, focal, focal, width / 2, height / 2))
    rows, columns = grid.shape
    assert rows % GRID_STEP == columns % GRID_STEP == 0
    across = grid.rays[0, 2:40:2, 0]
    assert np.diff(across).mean() == pytest.approx(1 / CELL_FOCAL_PX, rel=0.03)
    assert grid.column_starts[0] == 0
    assert grid.column_starts[-1] == width
    assert (np.diff(grid.row_starts) >= 0).all()


def test_samples_are_pixels_and_nothing_lies_beyond_the_image():
    depth_m = np.random.default_rng(0).uniform(1, 2, (424, 512)).astype(np.float32)
    grid = DepthGrid(KINECT)
    samples = grid.samples(depth_m)
    known = samples > 0
    assert np.isin(samples[known], depth_m).all()
    assert np.isnan(grid.rays[~known]).all()
    # The ray of a sample is that of its pixel.
    row, column = np.argwhere(depth_m == samples[10, 20])[0]
    assert grid.rays[10, 20] == pytest.approx(KINECT.rays[row, column])


def test_inputs_tell_depth_relief_and_slopes():
    grid = DepthGrid(KINECT)
    z = np.full((grid.shape[0] * 2, grid.shape[1] * 2), 2.0, np.float32)
    z[4:6, 4:6] = [[1.9, 2.1], [0.0, 2.0]]
    z[:2] = 0
    inputs = grid.inputs(z)
    assert inputs[0, 0].max() == 0
    assert inputs[1, 10, 10] == 0  # 2 m
    assert inputs[0, 2, 2] == 0.75
    assert inputs[2:6, 2, 2] == pytest.approx([-0.6, 0.6, 0.0, 0.0], abs=1e-5)
    slope = np.broadcast_to(2 + 0.01 * np.arange(z.shape[1]), z.shape).astype(np.float32)
    inputs = grid.inputs(slope)
    # 2 cm a cell; a cell at 2.2 m is 3.5 cm wide; half of the slope is told.
    assert inputs[6, 10, 10] == pytest.approx(0.02 / (2.205 / CELL_FOCAL_PX) / 2, rel=0.03)
    assert np.abs(inputs[7, 2:-2]).max() == 0


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_outputs_come_back_as_the_camera_has_its_image(turns):
    """A turned grid sees what a turned camera would see, and what it says is turned back."""
    pose = look_at(np.array([0.0, -3.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    camera = dataclasses.replace(KINECT, world_from_camera=pose)
    grid = DepthGrid(camera, turns)
    rng = np.random.default_rng(1)
    rows, columns = grid.shape
    outputs = rng.normal(size=(7, rows, columns)).astype(np.float32)
    logits, offsets = grid.to_camera(outputs)
    assert logits.shape == grid.rays.shape[:2]
    by_samples = np.empty((2 * rows, 2 * columns), np.float32)
    for k in range(4):
        by_samples[k // 2 :: 2, k % 2 :: 2] = outputs[k]
    assert (np.rot90(logits, turns) == by_samples).all()
    # An offset is the same direction in the world, told by the turned camera's axes or by the camera's.
    turned = camera.turned(turns)
    told = np.rot90(offsets, turns, axes=(1, 2))[:, 5, 7] @ camera.world_from_camera[:3, :3].T
    assert told == pytest.approx(outputs[4:, 5, 7] @ turned.world_from_camera[:3, :3].T, abs=1e-5)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_the_part_around_what_is_marked_holds_it_in_steps_of_the_network(turns):
    grid = DepthGrid(KINECT, turns)
    marked = np.zeros(grid.samples(np.zeros((424, 512), np.float32)).shape, bool)
    assert grid.part_around(marked, 4, 0.7) == (slice(0, 0), slice(0, 0))
    marked[50:70, 30:50] = True
    marked[5, 100] = True  # a single sample is noise
    part = grid.part_around(marked, 4, 0.7)
    assert part is not None
    rows, columns = part
    assert {each % GRID_STEP for each in (rows.start, rows.stop, columns.start, columns.stop)} == {0}
    assert (rows.stop - rows.start) * (columns.stop - columns.start) < 0.3 * grid.shape[0] * grid.shape[1]
    rim = np.ones(grid.shape, bool)
    rim[rows.start + 4 : rows.stop - 4, columns.start + 4 : columns.stop - 4] = False
    marked[5, 100] = False
    assert not (np.rot90(marked, turns)[::2, ::2] & rim).any()
    assert grid.part_around(np.ones_like(marked), 4, 0.7) is None


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_the_part_is_that_of_the_cells_that_are_marked_as_a_whole(turns, seed):
    rng, grid = np.random.default_rng(seed), DepthGrid(KINECT, turns)
    marked = np.zeros(grid.samples(np.zeros((424, 512), np.float32)).shape, bool)
    marked[30:60, 20 + 10 * seed : 70 + 10 * seed] = rng.random((30, 50)) < 0.4
    full = np.rot90(marked, turns).reshape(grid.shape[0], 2, grid.shape[1], 2).all((1, 3))
    expected = []
    for places, size in zip(np.nonzero(full), grid.shape, strict=True):
        first, end = max(places.min() - 3, 0), min(places.max() + 4, size)
        expected.append(slice(first // GRID_STEP * GRID_STEP, -(-end // GRID_STEP) * GRID_STEP))
    assert grid.part_around(marked, 3, 1.0) == tuple(expected)
