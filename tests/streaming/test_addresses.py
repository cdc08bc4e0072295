"""What can be an address of a stream, and what cannot."""

from __future__ import annotations

import sys

import pytest

from depthmocap.errors import InputError
from depthmocap.streaming.addresses import open_stream, place


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("127.0.0.1:9000", "a stream is SCHEME://HOST:PORT, such as osc://127.0.0.1:9000, not '127.0.0.1:9000'"),
        ("", "a stream is SCHEME://HOST:PORT"),
        ("http://127.0.0.1", "there is no stream http://, only osc://"),
        ("osc://127.0.0.1:x", "the address 'osc://127.0.0.1:x' is wrong: Port could not"),
        ("osc://127.0.0.1:70000", "the address 'osc://127.0.0.1:70000' is wrong: Port out of range"),
        ("osc://[::1:9000", "the address 'osc://.*is wrong"),
        ("osc://127.0.0.1:9000/joints", "has more than a host and a port"),
        ("osc://me@127.0.0.1:9000", "has more than a host and a port"),
        ("osc://127.0.0.1:9000?a=1", "has more than a host and a port"),
        ("osc://127. 0.0.1:9000", "has more than a host and a port"),
        ("lsl://a\nb", r"the name of a stream is at most 100 printable characters, not 'a\\nb'"),
        ("lsl://" + 101 * "a", "the name of a stream is at most 100"),
        ("osc://127.0.0.1:0", "port is from 1 to 65535, got 0"),
    ],
)
def test_a_wrong_address_is_one_line(address: str, message: str) -> None:
    pytest.importorskip("pythonosc")
    with pytest.raises(InputError, match=message):
        open_stream(address)


@pytest.mark.parametrize(
    ("address", "module", "package"),
    [
        ("osc://", "pythonosc", "python-osc"),
        ("vmc://", "pythonosc", "python-osc"),
        ("ws://", "websockets", "websockets"),
    ],
)
def test_a_missing_package_is_told_with_its_extra(
    monkeypatch: pytest.MonkeyPatch, address: str, module: str, package: str
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"^this needs the package '{package}': pip install 'depthmocap\[stream\]'$"):
        open_stream(address)


def test_a_host_with_colons_is_in_brackets() -> None:
    assert (place("::1", 80), place("localhost", 80)) == ("[::1]:80", "localhost:80")
