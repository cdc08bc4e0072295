"""Files that commands write do not take the place of others."""

from pathlib import Path

import pytest

from depthmocap.core.output import check_outputs, write_json
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import Outputs
from depthmocap.evaluate.ubc3v_protocol import Ubc3vEvaluation


def test_files_that_may_be_written(tmp_path: Path) -> None:
    read = tmp_path / "set"
    read.mkdir()
    check_outputs({"--json": tmp_path / "a.json", "--csv": tmp_path / "new" / "folder" / "a.csv", "--report": None})
    check_outputs({"--json": read / "new.json"}, {"the set": read, "the mask": None})
    assert [path.name for path in tmp_path.rglob("*")] == ["set"]  # nothing is left by the check


def test_files_that_may_not(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "settings.json").touch()
    (tmp_path / "link").symlink_to(tmp_path / "set" / "settings.json")
    read: dict[str, Path | None] = {"the set": tmp_path / "set"}
    one = tmp_path / "a.json"
    with pytest.raises(InputError, match=r"--csv must not be the file of --json, got .*a\.json: choose another name"):
        check_outputs({"--json": one, "--csv": tmp_path / "x" / ".." / "a.json"})
    with pytest.raises(InputError, match="--json must not be the set"):
        check_outputs({"--json": tmp_path / "set"}, read)
    with pytest.raises(InputError, match="--json must be a file, got the folder"):
        check_outputs({"--json": tmp_path / "set"})
    for path in ("set/settings.json", "link"):
        with pytest.raises(InputError, match="--json must not be a file of the set"):
            check_outputs({"--json": tmp_path / path}, read)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write .*a\.json"):
        check_outputs({"--json": tmp_path / "file" / "x" / "a.json"})


def test_evaluations_see_to_their_files_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--csv must not be the file of --json"):
        Outputs(json=tmp_path / "x", csv=tmp_path / "x")
    (tmp_path / "settings.json").touch()
    with pytest.raises(InputError, match="--json must not be a file of what root names"):
        Ubc3vEvaluation(tmp_path, json=tmp_path / "settings.json")
    (tmp_path / "net.onnx").touch()
    with pytest.raises(InputError, match="--report must not be what weights names"):
        Ubc3vEvaluation(tmp_path / "data", weights=tmp_path / "net.onnx", report=tmp_path / "net.onnx")


def test_numbers_that_are_none_are_null(tmp_path: Path) -> None:
    path = tmp_path / "new" / "n.json"
    write_json(path, {"a": float("nan"), "b": [float("inf"), 1.5], "ü": ("x", {"c": None})})
    words = '{ "a": null, "b": [ null, 1.5 ], "ü": [ "x", { "c": null } ] }'
    assert path.read_text(encoding="utf-8").split() == words.split()
