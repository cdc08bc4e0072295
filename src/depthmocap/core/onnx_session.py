"""Networks in ONNX files, ready to run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError

if TYPE_CHECKING:
    import onnxruntime

#: Bytes of a file, at most.
_LARGEST = 1 << 30


def open_network(source: Path, missing: str) -> onnxruntime.InferenceSession:
    """A network that runs on one core.

    Args:
        missing: what to give, for the message where there is no such file.

    Raises:
        InputError: when the file cannot be read or is no network.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    # The runtime itself opens no file whose path is not UTF-8.
    data = read_bytes(source, _LARGEST, missing)
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        # Names that are no text are told of when they are asked for.
        _ = [end.name for end in (*session.get_inputs(), *session.get_outputs())]
        _ = session.get_modelmeta().custom_metadata_map
    except Exception as error:  # the runtime's errors share no public base class
        told = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{source} is not a readable ONNX network: {told}") from None
    return session
