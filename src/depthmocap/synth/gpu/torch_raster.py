"""The z-buffer of ``kernels.raster`` in torch: triangles of many pictures at once, on any device.

A picture's pixel is one int64: the bits of its depth above, the number of the face below. Bits of positive floats are
in the order of the floats, so that the least key is the nearest face, and the first drawn among equals, as on the CPU.
``scatter_reduce`` with ``amin`` gives the same whatever the order of its writes.

Faces are small on the screen (most cover less than 4×4 pixels), and after those seen from behind and those between
pixel centres are left out few are left. Every pixel of the box around a face is tested, in one long list of (face,
pixel): nothing depends on how large a face is. The lists' lengths are read back to the host, three times for some
dozens of bodies.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor

#: Faces and pixels of their boxes handled at once, at about 100 bytes each: 200 MB and 400 MB on a GPU. A CPU is
#: fastest where they fit its cache.
FACES_AT_ONCE = {"cpu": 1 << 17, "cuda": 1 << 21}
PIXELS_AT_ONCE = {"cpu": 1 << 17, "cuda": 1 << 22}
#: Key of a pixel that shows nothing: infinitely far, no face. Faces are numbered from 1.
NOTHING = 0x7F800000 << 32


def keys_of_depth(depth_m: Float[Tensor, "b h w"]) -> Int[Tensor, "b h w"]:
    """Keys of pictures to draw over; depth 0 or infinite shows nothing."""
    return torch.where(depth_m > 0, depth_m, torch.inf).view(torch.int32).long() << 32


def depth_of_keys(keys: Int[Tensor, "b h w"]) -> Float[Tensor, "b h w"]:
    """Depth, infinite where nothing is."""
    return (keys >> 32).int().view(torch.float32)


def faces_of_keys(keys: Int[Tensor, "b h w"]) -> Int[Tensor, "b h w"]:
    """Number of the face that a pixel shows, 0 where none was drawn."""
    return keys & 0xFFFFFFFF


def project(
    points_camera: Float[Tensor, "*n 3"], intrinsics: Float[Tensor, "*m 4"], near_m: float
) -> Float[Tensor, "*n 3"]:
    """Pixel u, v and 1/z (float32) of camera-frame points; 1/z is −1 for those not beyond ``near_m``.

    Args:
        intrinsics: fx, fy, cx, cy.
    """
    x, y, z = points_camera.double().unbind(-1)
    fx, fy, cx, cy = intrinsics.double().unbind(-1)
    beyond = z > near_m
    w = torch.where(beyond, 1 / torch.where(beyond, z, 1.0), 0.0)
    return torch.stack([x * w * fx + cx, y * w * fy + cy, torch.where(beyond, w, -1.0)], -1).float()


def draw_shared(
    keys: Int[Tensor, "b h w"], points: Float[Tensor, "b v 3"], faces: Int[Tensor, "f 3"], two_sided: bool = False
) -> None:
    """Draw meshes of one topology, a picture each; their faces are numbered 1 to f.

    Args:
        points: of :func:`project`.
    """
    pictures, count, _ = points.shape
    number = len(faces)
    corners = faces.T.contiguous()
    flat = points.reshape(-1, 3).T.contiguous()
    at_once = max(1, FACES_AT_ONCE.get(keys.device.type, 1 << 21) // max(number, 1))
    ids = torch.arange(1, number + 1, device=keys.device)
    for start in range(0, pictures, at_once):
        picture = torch.arange(start, min(start + at_once, pictures), device=keys.device)
        index = (corners[:, None] + picture[:, None] * count).flatten(1)
        _draw(keys, flat, index, picture.repeat_interleave(number), ids.repeat(len(picture)), two_sided)


def draw_packed(
    keys: Int[Tensor, "b h w"],
    points: Float[Tensor, "n 3"],
    faces: Int[Tensor, "f 3"],
    picture: Int[Tensor, "f"],
    first: int,
    two_sided: bool,
) -> None:
    """Draw faces of any meshes, each into its own picture; they are numbered from ``first``."""
    flat, corners = points.T.contiguous(), faces.T.contiguous()
    ids = torch.arange(first, first + len(faces), device=keys.device)
    at_once = FACES_AT_ONCE.get(keys.device.type, 1 << 21)
    for start in range(0, len(faces), at_once):
        piece = slice(start, start + at_once)
        _draw(keys, flat, corners[:, piece], picture[piece], ids[piece], two_sided)


def _draw(keys: Tensor, points: Tensor, faces: Tensor, picture: Tensor, ids: Tensor, two_sided: bool) -> None:
    """Draw ``faces`` (3, f) of ``points`` (3, n) into the pictures (f,)."""
    height, width = keys.shape[1:]
    seen = _seen(points, faces, height, width, two_sided)
    faces, picture, ids = faces[:, seen], picture[seen], ids[seen]
    u, v, w = _corners(points, faces)
    if two_sided:  # turn those seen from behind, by exchanging two corners
        behind = _area(u, v) > 0
        u, v, w = (torch.stack([a[0], torch.where(behind, a[2], a[1]), torch.where(behind, a[1], a[2])])
                   for a in (u, v, w))  # fmt: skip
    left, right, top, bottom = _box(u, v, height, width)
    columns = right - left + 1
    counts = columns.long() * (bottom - top + 1)
    ends = counts.cumsum(0)
    flat = keys.view(-1)
    for piece, length in _pieces(ends, PIXELS_AT_ONCE.get(keys.device.type, 1 << 22)):
        count = counts[piece]
        face = torch.arange(piece.start, piece.stop, device=keys.device).repeat_interleave(count, output_size=length)
        before = (ends - counts)[piece.start]
        place = (torch.arange(length, device=keys.device) + before - (ends - counts)[face]).int()
        row = place // columns[face]
        y = top[face] + row
        x = left[face] + place - row * columns[face]
        # Corners relative to the pixel. A corner's difference from a pixel near it is exact in floating point, and
        # two faces get opposite numbers for the edge they share: no pixel falls between them.
        a, b, c = u.index_select(1, face) - x
        d, e, f = v.index_select(1, face) - y
        w0, w1, w2 = b * f - c * e, c * d - a * f, a * e - b * d
        total = w0 + w1 + w2
        inside = ((w0 <= 0) & (w1 <= 0) & (w2 <= 0) & (total < 0)).nonzero()[:, 0]
        face = face[inside]
        inverse = w.index_select(1, face)
        depth = total[inside] / (w0[inside] * inverse[0] + w1[inside] * inverse[1] + w2[inside] * inverse[2])
        key = (depth.view(torch.int32).long() << 32) | ids[face]
        pixel = (picture[face] * height + y[inside]) * width + x[inside]
        flat.scatter_reduce_(0, pixel, key, "amin")


def _corners(points: Tensor, faces: Tensor) -> list[Tensor]:
    """u, v and 1/z of the corners of ``faces`` (3, f), each (3, f)."""
    index = faces.reshape(-1)
    return [coordinate.index_select(0, index).view(3, -1) for coordinate in points]


def _area(u: Tensor, v: Tensor) -> Tensor:
    """Twice the signed area of triangles (3, f); negative where the front is seen, as v points down."""
    return (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])


def _box(u: Tensor, v: Tensor, height: int, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """First and last column and row whose pixel centres may lie in triangles (3, f), within the picture (int32)."""
    left = torch.minimum(torch.minimum(u[0], u[1]), u[2]).ceil().clamp(0, width)
    right = torch.maximum(torch.maximum(u[0], u[1]), u[2]).floor().clamp(-1, width - 1)
    top = torch.minimum(torch.minimum(v[0], v[1]), v[2]).ceil().clamp(0, height)
    bottom = torch.maximum(torch.maximum(v[0], v[1]), v[2]).floor().clamp(-1, height - 1)
    return left.int(), right.int(), top.int(), bottom.int()


def _seen(points: Tensor, faces: Tensor, height: int, width: int, two_sided: bool) -> Tensor:
    """Indices of the faces that may cover a pixel."""
    u, v, w = _corners(points, faces)
    area = _area(u, v)
    left, right, top, bottom = _box(u, v, height, width)
    kept = (area != 0 if two_sided else area < 0) & (left <= right) & (top <= bottom)
    return (kept & (w[0] > 0) & (w[1] > 0) & (w[2] > 0)).nonzero()[:, 0]


def _pieces(ends: Tensor, at_once: int) -> Iterator[tuple[slice, int]]:
    """Runs of faces with about ``at_once`` pixels (one face may have more), and how many they have."""
    if not len(ends):
        return
    total = int(ends[-1])
    if total <= at_once:
        yield slice(0, len(ends)), total
        return
    cuts = torch.searchsorted(ends, torch.arange(at_once, total, at_once, device=ends.device)) + 1
    places = torch.cat([cuts, cuts.new_tensor([len(ends)])]).unique()
    stops, sums = places.tolist(), ends[places - 1].tolist()
    start = before = 0
    for stop, end in zip(stops, sums, strict=True):
        yield slice(start, stop), end - before
        start, before = stop, end
