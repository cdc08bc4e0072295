"""What several files of the project say is the same in all of them."""

from __future__ import annotations

import importlib.metadata
import re
import zlib
from pathlib import Path

import depthmocap

ROOT = Path(__file__).parents[1]
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_version_is_the_packages() -> None:
    assert importlib.metadata.version("depthmocap") == depthmocap.__version__
    assert not re.search(r"^version = \"", PROJECT, re.M)


def test_hooks_have_the_versions_of_make_lint() -> None:
    hooks = re.findall(r"ruff==[\d.]+", (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    assert hooks and set(hooks) == set(re.findall(r"\bruff==[\d.]+", PROJECT))


def test_every_python_that_is_promised_is_tested() -> None:
    promised = re.findall(r"Programming Language :: Python :: (3\.\d+)", PROJECT)
    workflow = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    tested = re.search(r"python: \[(.*)\]", workflow)
    assert tested is not None and re.findall(r"3\.\d+", tested[1]) == promised
    assert f'requires-python = ">={promised[0]}"' in PROJECT and f'pythonVersion = "{promised[0]}"' in PROJECT
    assert f"Python {promised[0]}–{promised[-1]}" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_workflows_install_what_make_does() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    workflow = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    made = re.search(r"^EXTRAS = (.*)$", makefile, re.M)
    installed = [set(each.split(",")) for each in re.findall(r"extras: (.*)", workflow)]
    assert made is not None
    base = set(made[1].split(","))
    assert installed == [base | {"realsense"}, base]


def test_what_is_packaged_is_below_20_mb() -> None:
    files = [path for path in (ROOT / "src" / "depthmocap").rglob("*") if path.is_file()]
    packaged = [path for path in files if path.suffix not in (".pyc", ".nbi", ".nbc")]
    assert sum(len(zlib.compress(path.read_bytes())) for path in packaged) < 20e6  # as a wheel holds them
    assert not [path for path in packaged if path.suffix in (".safetensors", ".pt")]  # of training: in weights/
