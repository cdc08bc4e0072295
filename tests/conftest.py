"""What many tests share: the body model takes seconds to build, so it is built once."""

from __future__ import annotations

import pytest

from depthmocap.body.model import Body, BodyModel, Phenotype


@pytest.fixture(scope="session")
def body_model() -> BodyModel:
    """The body model; tests that need it are skipped where anny is not installed."""
    pytest.importorskip("anny")
    return BodyModel.load()


@pytest.fixture(scope="session")
def default_body(body_model: BodyModel) -> Body:
    """The body that the regions are drawn on."""
    return body_model.shape(Phenotype())
