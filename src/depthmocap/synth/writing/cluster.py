"""The same work on a Ray cluster (extra: cluster)."""

from __future__ import annotations

import collections
import contextlib
import functools
import ipaddress
import itertools
import logging
import os
import secrets
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any, TypeVar

from depthmocap.core.interrupts import preserved_handlers
from depthmocap.errors import InputError, missing_extra
from depthmocap.synth.writing.workers import limit_threads

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: Largest number of attempts of a task whose workers or nodes die.
_RETRIES = 5
#: The address of a cluster on this machine that is started for the work, and ends with it.
LOCAL = "local"


class RayCluster:
    """A Ray cluster, connected to when the first task comes and left at the end; a context manager.

    A cluster that this process is connected to already is used as it is, and stays connected.
    """

    def __init__(self, address: str) -> None:
        """``address``: the cluster's, such as ``ray://head:10001`` or ``auto``. "local" starts one on this machine,
        which other machines cannot reach, and which ends with this."""
        self._address = address
        self._connection = contextlib.ExitStack()

    def __enter__(self) -> RayCluster:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def ordered(self, function: Callable[[_Task], _Result], tasks: Iterable[_Task]) -> Generator[_Result, None, None]:
        """As :func:`depthmocap.synth.writing.workers.ordered`, on the cores of the cluster.

        Tasks that write files need a folder that every node sees under the same path, and nodes with the same version
        of this package. For the same pictures from all nodes, their kind of processor must be one: sums may be fused
        otherwise.

        Raises:
            InputError: when ray is not installed, the cluster cannot be reached, or a task's workers keep dying.
        """
        left = iter(tasks)
        first = list(itertools.islice(left, 1))
        if not first:
            return
        ray = self._connected()
        from ray.exceptions import RayError, RayTaskError

        remote = ray.remote(max_retries=_RETRIES)(_with_one_thread)
        most = 2 * max(int(ray.cluster_resources().get("CPU", 1)), 1)
        under_way: collections.deque[Any] = collections.deque(
            remote.remote(function, task) for task in itertools.chain(first, itertools.islice(left, most - 1))
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

    def _connected(self) -> Any:
        """Ray, connected to the cluster."""
        try:
            import ray
        except ImportError:
            raise missing_extra("ray", "cluster") from None
        if ray.is_initialized():
            return ray
        local = self._address == LOCAL
        options: dict[str, Any] = {"include_dashboard": False} if local else {}
        if local:
            self._connection.enter_context(_to_itself())
        try:
            _knock(self._address)
            with preserved_handlers():
                ray.init(address=self._address, log_to_driver=False, logging_level=logging.ERROR, **options)
        except Exception as error:  # Ray raises plain ones too
            reason = str(error).partition("\n")[0]
            if local:
                raise InputError(f"Ray does not start here ({reason}): run again, or without --ray") from None
            raise InputError(f"no Ray cluster at --ray {self._address} ({reason}): start one, or give local") from None
        self._connection.callback(ray.shutdown)
        if local and not _is_loopback(ray.util.get_node_ip_address()):
            raise InputError("this version of Ray opens --ray local to other machines: start a cluster of your own")
        return ray


@contextlib.contextmanager
def _to_itself() -> Iterator[None]:
    """What keeps a cluster that is started within to this machine, and quiet.

    Ray listens on all interfaces where clusters of several machines may be, and has no other switch for that. It looks
    up cloud hosts of three makers even if it shall not report usage, which a proxy that is none ends at once. Its token
    would be written into the user's home if none were given.
    """
    from ray._private import ray_constants

    proxy = "http://127.0.0.1:1"
    ours = {
        ray_constants.ENABLE_RAY_CLUSTERS_ENV_VAR: "0",
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_AUTH_TOKEN": os.environ.get("RAY_AUTH_TOKEN") or _token(),
        "http_proxy": proxy,
        "https_proxy": proxy,
        "no_proxy": "127.0.0.1,localhost,::1",
    }
    before = dict(os.environ)
    clusters = ray_constants.ENABLE_RAY_CLUSTER  # read from its variable when Ray was imported
    os.environ.update(ours)
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = clusters
        for name in {*before, *os.environ}:  # Ray sets some itself
            if name not in before:
                del os.environ[name]
            elif os.environ.get(name) != before[name]:
                os.environ[name] = before[name]


@functools.cache
def _token() -> str:
    """One a process, because Ray keeps the first it sees."""
    return secrets.token_hex(32)


def _is_loopback(host: str) -> bool:
    return host == "localhost" or ipaddress.ip_address(host).is_loopback


def _knock(address: str) -> None:
    """Raise an ``OSError`` at once where no server listens; Ray itself waits for minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=10).close()


def _with_one_thread(function: Callable[[_Task], _Result], task: _Task) -> _Result:
    limit_threads()
    return function(task)
