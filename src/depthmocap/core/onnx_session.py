"""Opens networks in ONNX files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthmocap.core.network_devices import open_session
from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError

if TYPE_CHECKING:
    import onnxruntime

#: Largest size of a file (bytes).
_LARGEST = 1 << 30


def open_network(source: Path, missing: str) -> onnxruntime.InferenceSession:
    """Open a network, which runs on the device of ``networks_on``, by default on one core for each call.

    Args:
        missing: what to do if there is no such file, for the message.

    Raises:
        InputError: when the file cannot be read or is no network, or the device cannot run it.
    """
    # The runtime cannot open a path that is not UTF-8, so it gets the bytes.
    data = read_bytes(source, _LARGEST, missing)
    try:
        session = open_session(source.stem, data)
        # The runtime reports names that are no text only when they are read.
        _ = [end.name for end in (*session.get_inputs(), *session.get_outputs())]
        _ = session.get_modelmeta().custom_metadata_map
    except InputError:
        raise
    except Exception as error:  # the runtime's errors share no public base class
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{source} is not a readable ONNX network: {reason}") from None
    return session
