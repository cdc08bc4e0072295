"""What the package gives away by name."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest

import depthmocap

#: Imports all that lies directly in the package, which alone could hide a public function of the same name.
SCRIPT = """
import importlib, pkgutil, types
import depthmocap
for module in pkgutil.iter_modules(depthmocap.__path__, "depthmocap."):
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        assert not error.name.startswith("depthmocap"), error
for name in ("run", "live", "calibrate", "load_pipeline", "open_recording"):
    assert isinstance(getattr(depthmocap, name), types.FunctionType), name
"""


def test_every_public_name_is_there() -> None:
    assert all(getattr(depthmocap, name) is not None for name in depthmocap.__all__)
    assert set(depthmocap.__all__) <= set(dir(depthmocap))
    assert sorted(set(depthmocap.__all__)) == sorted(depthmocap.__all__)


def test_a_name_that_is_not_public() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'stop_motion'"):
        depthmocap.stop_motion  # noqa: B018


def test_functions_stay_functions_when_packages_are_imported() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)


def test_no_package_bears_the_name_of_something_public() -> None:
    packages = {module.name for module in pkgutil.iter_modules(depthmocap.__path__)}
    assert not packages & set(depthmocap.__all__)
    assert importlib.import_module("depthmocap.offline.run").run is depthmocap.run
