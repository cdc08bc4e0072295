"""What may be a person is seen again as from nearer, by a network that knows distances only."""

import numpy as np
import pytest
from scipy import ndimage

from depthmocap.geometry import DepthCamera
from depthmocap.segment.closer_look import look_closer, unsure_region
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, DepthGrid

#: A wall, and before it something of which the network knows nothing there, but from nearer.
WALL_M, THING_M = 5.0, 3.0


def network(cells: np.ndarray) -> np.ndarray:
    """Unsure at 3 m, sure at 1.5 m, where it also tells an offset; nobody elsewhere."""
    depth_m = 2 ** (2 * cells[1] + 1)
    near, far = np.abs(depth_m - THING_M / 2) < 0.2, np.abs(depth_m - THING_M) < 0.2
    logits = np.where(near, 5.0, np.where(far, -2.0, -6.0))
    offsets = np.where(near, np.array([0.1, 0.2, 0.3])[:, None, None], 0.0)
    return np.concatenate([np.repeat(logits[None], 4, 0), offsets]).astype(np.float32)


def scene(turns: int, things: list[tuple[int, int]]) -> tuple[DepthGrid, np.ndarray, np.ndarray]:
    """A grid, an image with things of 30×40 pixels whose upper left corners these are, and which pixels show them."""
    grid = DepthGrid(DepthCamera("c", 512, 424, 365.0, 365.0, 255.5, 211.5), turns)
    depth_m, shown = np.full((424, 512), WALL_M, np.float32), np.zeros((424, 512), np.float32)
    for v, u in things:
        depth_m[v : v + 30, u : u + 40] = THING_M
        shown[v : v + 30, u : u + 40] = 1
    return grid, depth_m, grid.samples(shown) > 0


def look(grid: DepthGrid, depth_m: np.ndarray, last=()):
    samples_m = grid.samples(depth_m)
    logits, offsets = grid.to_camera(network(grid.inputs(samples_m)))
    empty = np.zeros(samples_m.shape, bool)
    return logits, offsets, look_closer(grid, depth_m, network, samples_m, logits, offsets, empty, last)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
@pytest.mark.parametrize("place", [(200, 300), (2, 470), (390, 0)])
def test_what_is_unsure_is_seen_from_nearer_where_it_is(turns, place):
    grid, depth_m, shown = scene(turns, [place])
    logits, offsets, looks = look(grid, depth_m)
    assert len(looks) == 1
    # Cells at a rim mix the thing with the wall.
    inside = shown.copy()
    for axis in (0, 1):
        for shift in (-2, -1, 1, 2):
            inside &= np.roll(shown, shift, axis)
    assert inside.sum() > 20
    assert (logits[inside] > 4).all()
    assert (logits[~shown & (grid.samples(depth_m) > 4)] < -3).all()
    expected = grid.to_camera(np.ones((7, 8, 8), np.float32) * np.array([0, 0, 0, 0, 0.1, 0.2, 0.3])[:, None, None])[1]
    cells = inside[::2, ::2] & inside[1::2, 1::2]
    np.testing.assert_allclose(offsets[:, cells], np.broadcast_to(expected[:, :1, 0], (3, cells.sum())), atol=1e-5)


def test_one_region_of_two_images_is_looked_at_and_looks_hold_while_nothing_changes():
    things = [(200, 300), (100, 100)]
    grid, depth_m, shown = scene(0, things)
    looks, sure = (), []
    for _ in range(7):
        logits, _, looks = look(grid, depth_m, looks)
        sure.append(int((logits[shown] > 4).sum()))
    assert sure[0] == sure[1] < 0.6 * sure[2]
    assert sure[2:] == [sure[2]] * 5
    moved = depth_m.copy()
    moved[depth_m == THING_M] = THING_M - 0.1
    assert all(not held.holds(grid.samples(moved)) for held in looks)


def test_nothing_is_looked_at_where_all_is_sure_small_near_or_empty():
    samples_m = np.full((96, 96), 3.0, np.float32)
    nothing = np.zeros(samples_m.shape, bool)

    def region(logit: float, cells: slice, depth_m: float = 3.0, empty: np.ndarray = nothing):
        logits = np.full(samples_m.shape, -6.0, np.float32)
        logits[cells, cells] = logit
        return unsure_region(samples_m * depth_m / 3, logits, empty)

    some = slice(20, 40)
    assert region(-2.0, some) is not None
    assert region(-6.0, some) is None
    assert region(5.0, some) is None
    assert region(-2.0, slice(20, 24)) is None
    assert (4 * 3 / (2 * CELL_FOCAL_PX)) ** 2 < 0.02
    assert region(-2.0, some, depth_m=0.8) is None
    assert region(-2.0, some, empty=~nothing) is None


def plain_unsure_region(samples_m, logits, empty):
    """The same by whole arrays: mask, rows, columns and depth of the region of the largest doubt."""
    may = (logits > -3.5) & (samples_m > 0) & ~empty
    cells = may[::2, ::2] | may[::2, 1::2] | may[1::2, ::2] | may[1::2, 1::2]
    labels = np.zeros(cells.shape, np.int32)
    ndimage.label(cells, output=labels)
    probability = 1 / (1 + np.exp(-logits))
    surface_m2 = np.square(samples_m / (2 * CELL_FOCAL_PX))
    best, most, depth_m = 0, 0.0, 0.0
    for label in range(1, int(labels.max()) + 1):
        of_region = may & (np.repeat(np.repeat(labels, 2, 0), 2, 1) == label)
        doubt = (probability * (1 - probability) * surface_m2)[of_region].sum()
        if surface_m2[of_region].sum() > 0.02 and logits[of_region].mean() < 1.5 and doubt > most:
            best, most, depth_m = label, doubt, float(np.median(samples_m[of_region]))
    if not best or depth_m < 1:
        return None
    rows, columns = (np.flatnonzero((labels == best).any(axis)) for axis in (1, 0))
    mask = ndimage.binary_dilation(labels == best)
    return mask, slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1), depth_m


@pytest.mark.parametrize("seed", range(12))
def test_the_unsure_region_is_that_of_whole_arrays(seed):
    rng = np.random.default_rng(seed)
    shape = 48, 64
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), rng.uniform(1, 4))
    logits = (smooth / smooth.std() * 3 - rng.uniform(1, 5)).astype(np.float32)
    samples_m = np.where(rng.random(shape) < 0.1, 0, rng.uniform(0.5, 4) + rng.normal(0, 0.1, shape)).astype(np.float32)
    empty = np.zeros(shape, bool)
    empty[:, : int(rng.integers(20))] = True
    region, expected = unsure_region(samples_m, logits, empty), plain_unsure_region(samples_m, logits, empty)
    assert (region is None) == (expected is None)
    if region is not None and expected is not None:
        np.testing.assert_array_equal(region.mask, expected[0])
        assert (region.rows, region.columns) == expected[1:3]
        assert region.depth_m == pytest.approx(expected[3])
