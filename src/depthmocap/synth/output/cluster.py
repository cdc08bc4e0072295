"""The same work on a Ray cluster (extra: cluster)."""

from __future__ import annotations

import collections
import itertools
import logging
import socket
from collections.abc import Callable, Generator, Iterable
from typing import Any, TypeVar

from depthmocap.ending import keeping_handlers
from depthmocap.errors import InputError, missing_extra
from depthmocap.synth.output.workers import limit_threads

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: A task whose worker or node died is given to others so many times.
_RETRIES = 5


def ordered_on_ray(
    function: Callable[[_Task], _Result], tasks: Iterable[_Task], address: str
) -> Generator[_Result, None, None]:
    """As :func:`depthmocap.synth.output.workers.ordered`, on the cores of a Ray cluster.

    Tasks that write files need a folder that every node sees under the same path, and nodes with the same version of
    this package. For the same pictures from all nodes, their kind of processor must be one: sums may be fused
    otherwise.

    Args:
        address: the cluster's, such as ``ray://head:10001`` or ``auto``; "local" starts one on this machine, which
            ends with the work. A cluster that this process is connected to already is used as it is.

    Raises:
        InputError: when ray is not installed, the cluster cannot be reached, or a task's workers keep dying.
    """
    try:
        import ray
        from ray.exceptions import RayError, RayTaskError
    except ImportError:
        raise missing_extra("ray", "cluster") from None
    ours = not ray.is_initialized()
    if ours:
        try:
            _knock(address)
            with keeping_handlers():
                ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
        except (OSError, ValueError, RuntimeError) as error:
            reason = str(error).partition("\n")[0]
            raise InputError(f"no Ray cluster at --ray {address} ({reason}): start one, or give local") from None
    try:
        remote = ray.remote(max_retries=_RETRIES)(_with_one_thread)
        most = 2 * max(int(ray.cluster_resources().get("CPU", 1)), 1)
        left = iter(tasks)
        under_way: collections.deque[Any] = collections.deque(
            remote.remote(function, task) for task in itertools.islice(left, most)
        )
        while under_way:
            try:
                result: Any = ray.get(under_way[0])
            except RayTaskError as error:
                raise error.cause if isinstance(error.cause, Exception) else error from None
            except RayError as error:
                reason = str(error).strip().partition("\n")[0]
                raise InputError(
                    f"a task was lost {_RETRIES + 1} times ({reason}): the nodes may lack memory; run again to go on"
                ) from None
            under_way.popleft()
            under_way.extend(remote.remote(function, task) for task in itertools.islice(left, 1))
            yield result
    finally:
        if ours:
            ray.shutdown()


def _knock(address: str) -> None:
    """Raises an ``OSError`` at once where nobody listens: Ray itself waits for minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=10).close()


def _with_one_thread(function: Callable[[_Task], _Result], task: _Task) -> _Result:
    limit_threads()
    return function(task)
