"""Errors of a depth sensor, pixel by pixel. Random numbers are a hash of a seed and a position."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy import ndarray

#: A depth step between pixels of more than this share of the depth is a silhouette, not a slope.
EDGE_SHARE = 0.04
#: tan² of the largest angle of incidence, about 80°; larger angles count as this one.
_LARGEST_TAN2 = 32.0
#: Standard deviations that the holes' noise hardly ever exceeds.
_NOISE_LIMIT = 3.5
#: Distance of the points at which multipath is computed (pixels).
FACING_STEP = 4
#: Side of a block that is searched for silhouettes (pixels).
EDGE_BLOCK = 4
#: Margin without depth around the image for :func:`simulate_readings`: the greatest displacement (pixels).
MARGIN = 8
#: Greatest distance of surfaces that illuminate each other (metres).
_FACING_M = 0.3

#: Without checks for division by zero, and not all of fastmath: NaN and infinity must stay valid.
_kernel = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})


class Pinhole(NamedTuple):
    """Intrinsics of the processed part of the image, and the square of the image's half diagonal (pixels²)."""

    fx: float
    fy: float
    cx: float
    cy: float
    corner2: float


class SensorTerms(NamedTuple):
    """The numbers of ``depthmocap.synth.sensing.sensor.SensorModel`` that :func:`simulate_readings` uses."""

    axial_0: float
    axial_1: float
    axial_2: float
    grazing: float
    correlation: float
    patch_px: float
    wave: float
    lateral_px: float
    fatten_px: float
    lost_far_px: float
    lost_near_px: float
    flying: float
    behind_m: float
    multipath_m: float
    reach_m: float
    hole_spread: float
    hole_dust: float
    vignette: float
    nearest_m: float
    farthest_m: float
    disparity_m: float
    step_m: float
    step_from_m: float


@_kernel
def _random_bits(seed: Any, index: Any) -> Any:
    """64 random bits of a position, by splitmix64's finaliser."""
    x = np.uint64(seed) + np.uint64(index) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@_kernel
def _uniform(bits: Any, i: int) -> Any:
    """One of four uniform numbers in 0–1 from the bits."""
    return np.float32((bits >> np.uint64(16 * i)) & np.uint64(0xFFFF)) * np.float32(1 / 65536)


@_kernel
def _normal(bits: Any) -> Any:
    """Nearly normal, deviation 1: a sum of four uniform numbers, never beyond ±3.46."""
    total = _uniform(bits, 0) + _uniform(bits, 1) + _uniform(bits, 2) + _uniform(bits, 3)
    return (total - np.float32(2)) * np.float32(1.7320508)


@_kernel
def smooth_noise(seed: int, cell: float, out: ndarray) -> None:
    """Smooth noise of deviation 1, correlated within about ``cell`` pixels.

    Values between the points of a lattice are interpolated with cosine and sine as weights. Their squares add up to 1,
    so that the deviation is the same everywhere.
    """
    height, width = out.shape
    shift_u, shift_v = _uniform(_random_bits(seed, -1), 0), _uniform(_random_bits(seed, -1), 1)
    across = int((width - 1) / cell + shift_u) + 2
    upper, lower = np.empty(across, np.float32), np.empty(across, np.float32)
    columns = np.empty(width, np.int64)
    near, far = np.empty(width, np.float32), np.empty(width, np.float32)
    for u in range(width):
        x = u / cell + shift_u
        columns[u] = int(x)
        near[u], far[u] = np.cos((x - int(x)) * np.pi / 2), np.sin((x - int(x)) * np.pi / 2)
    mixed = np.empty(across, np.float32)
    row = -1
    for v in range(height):
        y = v / cell + shift_v
        if int(y) != row:
            row = int(y)
            for i in range(across):
                upper[i] = _normal(_random_bits(seed, row * across + i))
                lower[i] = _normal(_random_bits(seed, (row + 1) * across + i))
        top, bottom = np.float32(np.cos((y - row) * np.pi / 2)), np.float32(np.sin((y - row) * np.pi / 2))
        for i in range(across):
            mixed[i] = top * upper[i] + bottom * lower[i]
        for u in range(width):
            out[v, u] = near[u] * mixed[columns[u]] + far[u] * mixed[columns[u] + 1]


@_kernel
def cast_shadows(depth: ndarray, focal_baseline: float, dark: ndarray) -> None:
    """Mark the pixels that an emitter (or a second camera) beside the camera does not reach.

    ``focal_baseline`` is the focal length in pixels times the metres to the emitter, positive on the right. Along a row
    the emitter sees pixels at ``u - focal_baseline / z``; a pixel out of order there is occluded.
    """
    height, width = depth.shape
    sign = 1 if focal_baseline > 0 else -1
    for v in range(height):
        first = np.inf
        for i in range(width):
            u = width - 1 - i if sign > 0 else i
            z = depth[v, u]
            if z > 0:
                # Mirrored for an emitter on the left, so that it always decreases.
                projected = sign * (u - focal_baseline / z)
                if projected > first + 0.5:
                    dark[v, u] = True
                elif projected < first:
                    first = projected


@_kernel
def _shift(pixels: Any) -> int:
    """A displacement in whole pixels, within the margin."""
    # The cast truncates towards zero; the large number makes that a floor.
    return min(max(int(pixels + 1024.5) - 1024, -MARGIN), MARGIN)


@_kernel
def _slope(previous: Any, z: Any, after: Any) -> Any:
    """Change of depth per pixel; at a silhouette, that on the side without the jump."""
    a, b = z - previous, after - z
    # Conditional expressions compile without branches.
    a, b = b if previous <= 0 else a, a if after <= 0 else b
    slope = a if abs(a) < abs(b) else b
    return np.float32(0) if max(previous, after) <= 0 else slope


@_kernel
def facing_share(depth: ndarray, focal: float, out: ndarray) -> None:
    """Share (0–1) of a surface's surroundings in front of its tangent plane, near enough to illuminate it.

    ``out`` has a point for every ``FACING_STEP`` pixels. Eight points around it, 4 and 9 cm away, are sampled.
    """
    height, width = depth.shape
    turns = np.arange(8) * np.pi / 4
    reach = np.where(np.arange(8) % 2 == 1, 0.04, 0.09).astype(np.float32)
    across, down = (reach * np.cos(turns)).astype(np.float32), (reach * np.sin(turns)).astype(np.float32)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            v, u = min(i * FACING_STEP, height - 1), min(j * FACING_STEP, width - 1)
            z = depth[v, u]
            out[i, j] = 0
            if z <= 0:
                continue
            zu = _slope(depth[v, max(u - 1, 0)], z, depth[v, min(u + 1, width - 1)])
            zv = _slope(depth[max(v - 1, 0), u], z, depth[min(v + 1, height - 1), u])
            scale = np.float32(focal) / z
            total = np.float32(0)
            for k in range(8):
                du, dv = int(scale * across[k]), int(scale * down[k])
                if not (0 <= v + dv < height and 0 <= u + du < width):
                    continue
                other = depth[v + dv, u + du]
                in_front = z + zu * du + zv * dv - other
                if other > 0 and 0.01 < in_front < _FACING_M:
                    total += in_front / np.sqrt(in_front * in_front + reach[k] * reach[k])
            out[i, j] = total / 8


@_kernel
def mark_silhouettes(depth: ndarray, around: int, blocks: ndarray) -> None:
    """Mark the blocks of ``EDGE_BLOCK`` pixels that contain a depth jump, and ``around`` blocks on every side of
    them."""
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            right = depth[v, u + 1] if u < width - 1 else np.float32(0)
            below = depth[v + 1, u] if v < height - 1 else np.float32(0)
            edge = EDGE_SHARE * z
            if abs(right - z) > edge or abs(below - z) > edge:
                i, j = v // EDGE_BLOCK, u // EDGE_BLOCK
                blocks[max(i - around, 0) : i + around + 1, max(j - around, 0) : j + around + 1] = True


@_kernel
def _incidence(above: ndarray, here: ndarray, below: ndarray, v: int, camera: Pinhole, secant2: ndarray) -> None:
    """1 / cos² of the angles of incidence in one row, from the row and its neighbours, all with their margins.

    The normal of a surface with slopes (p, q) in pixels is (-fx p, -fy q, z + du p + dv q), and its product with the
    ray (x, y, 1) is the depth z.
    """
    dv = np.float32(v - camera.cy)
    fx, fy, y = np.float32(camera.fx), np.float32(camera.fy), dv / np.float32(camera.fy)
    one = np.float32(1)
    for u in range(secant2.size):
        z = here[u + MARGIN]
        p = _slope(here[u + MARGIN - 1], z, here[u + MARGIN + 1])
        q = _slope(above[u + MARGIN], z, below[u + MARGIN])
        du = np.float32(u) - np.float32(camera.cx)
        x = du / fx
        a, b, c = fx * p, fy * q, z + du * p + dv * q
        secant2[u] = (a * a + b * b + c * c) * (one + x * x + y * y) / (z * z)


@_kernel
def simulate_readings(
    depth: ndarray,
    material: ndarray,
    reflectance: ndarray,
    dark: ndarray,
    faced: ndarray,
    blocks: ndarray,
    smooth: ndarray,
    camera: Pinhole,
    terms: SensorTerms,
    seed: int,
    out: ndarray,
) -> None:
    """The reading of every pixel with depth; ``out`` keeps its 0 elsewhere, and where a pixel is lost.

    ``depth`` has a margin around the image. ``smooth`` holds five noise fields: displacement along u and v, error, slow
    error, and holes. ``dark`` and ``faced`` come from :func:`cast_shadows` and :func:`facing_share`, ``blocks`` from
    :func:`mark_silhouettes`. Arrays of terms that are switched off may be empty.
    """
    # One long function, because calls with array arguments cost more than their work.
    height, width = out.shape
    patches = terms.patch_px > 1
    shared, independent = np.float32(np.sqrt(terms.correlation)), np.float32(np.sqrt(1 - terms.correlation))
    dust, blob = np.float32(np.sqrt(terms.hole_dust)), np.float32(np.sqrt(1 - terms.hole_dust))
    holes = terms.reach_m < np.inf
    shadowed, corrected, edges = dark.size > 0, faced.size > 0, blocks.size > 0
    secant2 = np.empty(width, np.float32)
    # The holes' noise hardly ever exceeds this: a stronger signal is never lost.
    spread = np.float32(terms.hole_spread)
    safe = np.exp(np.float32(_NOISE_LIMIT) * spread)
    reach2, falloff = np.float32(terms.reach_m**2), np.float32(terms.vignette / camera.corner2)
    constant, linear, square = np.float32(terms.axial_0), np.float32(terms.axial_1), np.float32(terms.axial_2)
    grazing, wave, steepest = np.float32(terms.grazing), np.float32(terms.wave), np.float32(_LARGEST_TAN2)
    dimmest, one = np.float32(0.02), np.float32(1)
    for v in range(height):
        row = v + MARGIN
        dv2 = np.float32((v - camera.cy) ** 2)
        _incidence(depth[row - 1], depth[row], depth[row + 1], v, camera, secant2)
        for u in range(width):
            column = u + MARGIN
            true_depth = depth[row, column]
            if true_depth <= 0 or (shadowed and dark[v, u]):
                continue
            index = v * width + u
            z = true_depth
            left, right = depth[row, column - 1], depth[row, column + 1]
            above, below = depth[row - 1, column], depth[row + 1, column]
            if edges and blocks[v // EDGE_BLOCK, u // EDGE_BLOCK]:
                edge = np.float32(EDGE_SHARE) * true_depth
                if patches:
                    gu, gv = smooth[0, v, u], smooth[1, v, u]
                else:
                    bits = _random_bits(seed + 1, index)
                    # Triangular, deviation 1.
                    gu = (_uniform(bits, 0) + _uniform(bits, 1) - np.float32(1)) * np.float32(2.4494897)
                    gv = (_uniform(bits, 2) + _uniform(bits, 3) - np.float32(1)) * np.float32(2.4494897)
                z = depth[row + _shift(terms.lateral_px * gv), column + _shift(terms.lateral_px * gu)]
                if z <= 0:
                    continue
                for sign in (-1, 1):
                    if terms.fatten_px > 0:
                        length = sign * terms.fatten_px
                        other = depth[row + _shift(length * gv), column + _shift(length * gu)]
                        if 0 < other < z - edge:
                            z = other
                nearest, farthest = min(left, right, above, below), max(left, right, above, below)
                flies = False
                if nearest <= 0 or nearest < true_depth - edge or farthest > true_depth + edge:
                    chance = _random_bits(seed + 2, index)
                    flies = _uniform(chance, 0) < terms.flying
                    if flies:
                        far = farthest if farthest > z + edge else z + np.float32(terms.behind_m)
                        if 0 < nearest < z - edge:
                            far, z = z, nearest
                        # The near surface returns more light: mixed depths are mostly near it.
                        z += np.float32(_uniform(chance, 1) ** 2) * np.float32(far - z)
                lost = False
                norm = np.float32(1) / np.sqrt(gu * gu + gv * gv + np.float32(1e-6))
                gu, gv = gu * norm, gv * norm
                for _ in range(4):
                    # Four directions at right angles: one of them is within 45° of the normal of any silhouette.
                    gu, gv = -gv, gu
                    if terms.lost_far_px > 0:
                        other = depth[row + _shift(terms.lost_far_px * gv), column + _shift(terms.lost_far_px * gu)]
                        lost |= 0 < other < z - edge
                    if terms.lost_near_px > 0:
                        other = depth[row + _shift(terms.lost_near_px * gv), column + _shift(terms.lost_near_px * gu)]
                        lost |= other <= 0 or other > z + edge
                if lost and not flies:
                    continue
            du = np.float32(u - camera.cx)
            returned = reflectance[material[v, u]] * (one - falloff * (du * du + dv2))
            if holes:
                signal = returned * reach2 / (z * z * np.sqrt(secant2[u]))
                if signal < safe:
                    draw = blob * smooth[4, v, u] if terms.hole_dust < 1 else np.float32(0)
                    if terms.hole_dust > 0:
                        draw += dust * _normal(_random_bits(seed + 3, index))
                    if signal < np.exp(spread * draw):
                        continue
            sigma = constant + z * (linear + z * square)
            sigma *= (one + grazing * min(secant2[u] - one, steepest)) / np.sqrt(max(returned, dimmest))
            error = independent * _normal(_random_bits(seed, index))
            if terms.correlation > 0:
                error += shared * smooth[2, v, u]
            if terms.wave > 0:
                error += wave * smooth[3, v, u]
            z += sigma * error
            if corrected:
                z += terms.multipath_m * faced[v, u]
            if terms.disparity_m > 0 and z > 0:
                # Disparity has whole steps; disparity_m is the focal length times the baseline, divided by a step.
                z = terms.disparity_m / max(np.round(terms.disparity_m / z), 1)
            if terms.step_m > 0:
                z = terms.step_from_m + np.round((z - terms.step_from_m) / terms.step_m) * terms.step_m
            if terms.nearest_m <= z <= terms.farthest_m and z > 0:
                out[v, u] = z


@_kernel
def blend_edges(depth: ndarray, share: float, seed: int, out: ndarray) -> None:
    """Mix a share of the pixels next to pixels without depth with their 0, with random weights."""
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            out[v, u] = z
            if z > 0:
                left, right = depth[v, max(u - 1, 0)], depth[v, min(u + 1, width - 1)]
                above, below = depth[max(v - 1, 0), u], depth[min(v + 1, height - 1), u]
                if min(left, right, above, below) <= 0:
                    bits = _random_bits(seed, v * width + u)
                    if _uniform(bits, 0) < share:
                        out[v, u] = z * _uniform(bits, 1)
