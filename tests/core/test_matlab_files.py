"""MATLAB files: what is packed is measured before it is unpacked."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from depthmocap.core.reading import matlab_files as matlab
from depthmocap.core.reading.matlab_files import read_mat
from depthmocap.errors import InputError


def test_what_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mat"
    for packed in (False, True):
        savemat(path, {"x": np.zeros(100_000), "y": np.arange(3)}, do_compression=packed)
        assert read_mat(path, squeeze_me=True)["y"].tolist() == [0, 1, 2]
    assert path.stat().st_size < 2000
    monkeypatch.setattr(matlab, "LARGEST_MAT", 700_000)
    with pytest.raises(InputError, match="unpacks to more than"):
        read_mat(path)


def test_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"x": {"a": np.eye(4), "b": "text"}}, do_compression=True)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for broken in [data[:at] for at in (0, 100, 130, len(data) - 9)] + [
        data[:at] + bytes([data[at] ^ 0x5A]) + data[at + 1 :] for at in rng.integers(126, len(data), 20)
    ]:
        path.write_bytes(broken)
        try:
            read_mat(path)
        except InputError as error:
            assert "\n" not in str(error)
    with pytest.raises(InputError, match="not found: fetch it"):
        read_mat(tmp_path / "none.mat", "fetch it")
