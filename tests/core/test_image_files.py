"""Pictures: their size is known before they are unpacked; cut and damaged ones are one line."""

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from depthmocap.core.reading.image_files import decode_png, png_header, read_picture
from depthmocap.errors import InputError

DEPTH = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)


def _png(width: int, height: int, rows: bytes = b"") -> bytes:
    """A 16-bit grey PNG that claims a size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def _encoded(array: np.ndarray = DEPTH) -> bytes:
    return cv2.imencode(".png", array)[1].tobytes()


def test_pictures_are_read_as_they_are_stored(tmp_path: Path) -> None:
    assert np.array_equal(decode_png(_encoded(), "it"), DEPTH)
    assert png_header(_encoded(), "it") == (64, 48, 16, "grey")
    path = tmp_path / "depth.png"
    path.write_bytes(_encoded())
    assert np.array_equal(read_picture(path), DEPTH)
    colours = np.random.default_rng(0).integers(0, 256, (48, 64, 4)).astype(np.uint8)
    Image.fromarray(colours).save(path)
    assert np.array_equal(read_picture(path, "RGBA", (64, 48)), colours)
    for mode, size in (("L", (64, 48)), ("RGBA", (64, 49))):
        with pytest.raises(InputError, match=f"expected a {mode} picture of {size[0]}×{size[1]}, got RGBA 64×48"):
            read_picture(path, mode, size)
    for kind in ("jpg", "bmp", "tiff"):
        Image.fromarray(colours[..., :3]).save(tmp_path / f"mask.{kind}")
        assert read_picture(tmp_path / f"mask.{kind}").shape == (48, 64, 3)


@pytest.mark.parametrize("size", [(30_000, 30_000), (10_000, 10_000), (2**31 - 1, 1), (0, 5)])
def test_a_picture_that_claims_a_great_size_is_not_unpacked(tmp_path: Path, size: tuple[int, int]) -> None:
    data = _png(*size)
    path = tmp_path / "bomb.png"
    path.write_bytes(data)
    for read in (lambda: decode_png(data, "it"), lambda: read_picture(path)):
        with pytest.raises(InputError, match="at most 64 million"):
            read()


def test_every_cut_and_many_damages_are_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data, path = _encoded(), tmp_path / "cut.png"
    rng = np.random.default_rng(0)
    damaged = [data[:at] for at in (0, 5, 20, 32, 33, 40, len(data) // 2, len(data) - 13, len(data) - 5)]
    damaged += [data[:60] + data[80:], data[:41] + bytes(8) + data[49:]]
    for at in rng.integers(8, len(data) - 12, 20):
        damaged.append(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
    for broken in damaged:
        path.write_bytes(broken)
        for read in (lambda broken=broken: decode_png(broken, str(path)), lambda: read_picture(path)):
            with pytest.raises(InputError) as caught:
                read()
            assert "\n" not in str(caught.value)
    assert "libpng" not in capfd.readouterr().err


def test_what_pillow_would_run_other_programs_for_is_no_picture(tmp_path: Path) -> None:
    path = tmp_path / "script.png"
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n")
    with pytest.raises(InputError, match="is not a readable picture: fetch"):
        read_picture(path)
    gif = io.BytesIO()
    Image.new("L", (8, 8)).save(gif, "GIF")
    path.write_bytes(gif.getvalue())
    with pytest.raises(InputError, match="is not a readable picture"):
        read_picture(path)
