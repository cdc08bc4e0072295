"""A python-osc server receives what was sent."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from receivers import OscReceiver, osc, wait_until
from samples import EMPTY_RIG, sample_of, standing_pose

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.osc_stream import osc_message
from depthmocap.streaming.stream_protocol import StreamSetup

__all__ = ["osc"]


def test_joints_and_confidences_by_name(osc: OscReceiver) -> None:
    stream = open_stream(f"osc://127.0.0.1:{osc.port}")
    stream.start(StreamSetup(EMPTY_RIG, 2))
    one, two = standing_pose(40_000_000), standing_pose(40_000_000, x=1.0)
    two.joints[JOINTS.index("LHand")] = np.nan
    stream.send(sample_of(one, two))
    stream.send(sample_of())
    stream.close()
    wait_until(lambda: len(osc.of("/depthmocap/people")) == 3)
    assert osc.of("/depthmocap/people") == [(1, 2), (1, 2), ()]
    assert osc.of("/depthmocap/time") == [(1_700_000_000, 40_000_000)] * 2 + [(1_700_000_000, 0)]
    for number, pose in ((1, one), (2, two)):
        for i, name in enumerate(JOINTS):
            got = osc.of(f"/depthmocap/{number}/{name}")
            if np.isnan(pose.joints[i, 0]):
                assert got == []
            else:
                np.testing.assert_allclose(got, [[*pose.joints[i], pose.confidence[i]]], atol=1e-6)


@pytest.mark.parametrize(
    "values",
    [[], ["root"], ["abcd", "", "Häuser"], [0.1, -2.5, float("nan")], [1, -1, 2**31 - 1, 2**31, -(2**31), 2**40]],
)
def test_a_message_is_that_of_python_osc(values: list[str | int | float]) -> None:
    builder = OscMessageBuilder("/depthmocap/1/Head")
    for value in values:
        builder.add_arg(value)
    assert osc_message("/depthmocap/1/Head", values) == builder.build().dgram


def test_times_that_32_bits_do_not_hold(osc: OscReceiver) -> None:
    stream = open_stream(f"osc://127.0.0.1:{osc.port}")
    stream.start(StreamSetup(EMPTY_RIG))
    late = dataclasses.replace(sample_of(), unix_ns=5_000_000_000 * 10**9 + 1)
    stream.send(late)
    stream.close()
    assert wait_until(lambda: osc.of("/depthmocap/time")) == [(5_000_000_000, 1)]


def test_a_host_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*arguments: object, **others: object) -> None:
        raise OSError(-2, "Name or service not known")

    stream = open_stream("osc://nobody.invalid")
    monkeypatch.setattr("socket.getaddrinfo", unknown)
    with pytest.raises(InputError, match=r"^no host 'nobody\.invalid': Name or service not known$"):
        stream.start(StreamSetup(EMPTY_RIG))
