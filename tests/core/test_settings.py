"""Settings as JSON holds them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from depthmocap.core.settings import claim_folder, plain_settings
from depthmocap.errors import InputError


@dataclasses.dataclass(frozen=True)
class _Inner:
    weights: Path | None = Path("a/b.onnx")
    views: tuple[int, ...] = (1, 2)


@dataclasses.dataclass(frozen=True)
class _Outer:
    out: Path = Path("runs")
    inner: _Inner = _Inner()


def test_paths_become_strings_at_any_depth() -> None:
    plain = json.loads(json.dumps(plain_settings(_Outer())))
    assert plain == {"out": "runs", "inner": {"weights": "a/b.onnx", "views": [1, 2]}}


@pytest.mark.parametrize("text", ["", '{"out": ', "[" * 100_000, "[1]", "3", '{"n": ' + "9" * 5000 + "}", "\xff"])
def test_settings_that_were_cut_or_are_none_are_told_in_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "settings.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"settings\.json .*: choose another --out"):
        claim_folder(tmp_path, _Outer(), "a run", ())
