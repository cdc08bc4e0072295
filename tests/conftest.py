"""What many tests share: the body model takes seconds to build, so it is built once."""

from __future__ import annotations

import importlib.util
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from type_checks import check_types_of

if TYPE_CHECKING:
    from virtual_time import VirtualTime

    from depthmocap.synth.body.mesh import Body, BodyModel

# Not of kernels, which are compiled as they stand, and of what wraps the standard streams, which are no instances of
# typing.TextIO. The package is imported by fixtures alone: the process that hands the tests out to others needs none.
check_types_of("depthmocap", but=("depthmocap.kernels", "depthmocap.core.console", "depthmocap.core.standard_streams"))

#: Modules that import torch at the top; without the extra "train" they are left out.
collect_ignore = [] if importlib.util.find_spec("torch") else ["test_data_commands.py"]


@pytest.fixture(scope="session")
def body_model() -> BodyModel:
    """The body model; tests that need it are skipped where anny is not installed."""
    pytest.importorskip("anny")
    from depthmocap.synth.body.mesh import BodyModel

    return BodyModel.load()


@pytest.fixture(scope="session", autouse=True)
def networks_open_once() -> Iterator[None]:
    """Each network is opened once."""
    from open_once import networks_open_once

    with networks_open_once():
        yield


@pytest.fixture
def virtual() -> Iterator[VirtualTime]:
    """Cameras, their threads and motion capture run in virtual time."""
    from virtual_time import virtual_time

    with virtual_time() as made:
        yield made


@pytest.fixture
def usual_signals() -> Iterator[None]:
    """Signals as a terminal's programs have them, however the tests were started: a background job ignores some."""
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
    usual = {name: signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL for name in names}
    before = {name: signal.signal(getattr(signal, name), usual[name]) for name in names}
    yield
    for name, handler in before.items():
        signal.signal(getattr(signal, name), handler)


@pytest.fixture(scope="session")
def default_body(body_model: BodyModel) -> Body:
    """The body that the regions are drawn on."""
    from depthmocap.synth.body.mesh import Phenotype

    return body_model.shape(Phenotype())
