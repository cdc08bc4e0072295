import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.recordings.depth_codec import CODINGS, Coding, decode_depth, encode_depth

pytest.importorskip("zstandard")


def noisy_ramp(width: int = 64, height: int = 48) -> np.ndarray:
    rng = np.random.default_rng(0)
    depth = 2000 + 5 * np.arange(width) + rng.normal(0, 3, (height, width))
    depth[rng.random(depth.shape) < 0.05] = 0
    return depth.astype(np.uint16)


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (24, 33)])
def test_any_picture_comes_back_bit_for_bit(coding: Coding, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 65536, shape).astype(np.uint16), np.full(shape, 65535, np.uint16)]
    for raw in [*pictures, np.tile(np.array([[0, 65535]], np.uint16), shape)]:
        found = decode_depth(encode_depth(raw, coding), coding, (raw.shape[1], raw.shape[0]))
        assert found.dtype == np.uint16
        np.testing.assert_array_equal(found, raw)


def test_a_view_of_a_larger_picture_is_coded_and_left_as_it_was() -> None:
    raw = noisy_ramp()
    before = raw.copy()
    part = raw[::2, 3:40]
    np.testing.assert_array_equal(decode_depth(encode_depth(part), "delta-zstd"), part)
    np.testing.assert_array_equal(raw, before)


def test_the_default_is_smaller_than_png() -> None:
    raw = noisy_ramp(512, 424)
    sizes = {coding: len(encode_depth(raw, coding)) for coding in CODINGS}
    assert sizes["delta-zstd"] < 0.9 * sizes["png"] < sizes["raw"]
    assert sizes["delta-zstd"] * 2.5 < raw.nbytes


@pytest.mark.parametrize("coding", CODINGS)
def test_damage_is_told(coding: Coding) -> None:
    raw = noisy_ramp()
    data = encode_depth(raw, coding)
    for bad in (b"", data[:5], data[: len(data) // 2]):
        with pytest.raises(InputError):
            decode_depth(bad, coding, (64, 48))
    with pytest.raises(InputError):
        decode_depth(data, coding, (48, 65))


def test_a_size_that_the_data_do_not_have_is_told() -> None:
    data = encode_depth(noisy_ramp())
    for width, height in ((0, 48), (2**31, 2**31), (64, 49)):
        with pytest.raises(InputError, match="damaged"):
            decode_depth(width.to_bytes(4, "little") + height.to_bytes(4, "little") + data[8:], "delta-zstd")


def test_an_unknown_coding_is_told() -> None:
    with pytest.raises(InputError, match="'jpeg' is not known"):
        decode_depth(b"abc", "jpeg")
