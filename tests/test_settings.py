"""Settings as JSON holds them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from depthmocap.settings import plain_settings


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
