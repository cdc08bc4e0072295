"""What a command and the processes it starts do on the network, seen from outside and from within Python."""

from __future__ import annotations

import ipaddress
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

#: Every Python process that finds this as sitecustomize.py notes names that it looks up, and whom it talks to.
_HOOK = """\
import os, sys

def _watch(event, arguments):
    if event.startswith("socket.") and event.partition(".")[2] in {
        "connect", "sendto", "sendmsg", "getaddrinfo", "gethostbyname", "gethostbyaddr", "getnameinfo",
    }:
        what = arguments[0] if event.startswith("socket.get") else arguments[1]
        if isinstance(what, (str, bytes)) and not event.startswith("socket.get"):
            return  # the path of a Unix socket
        host = what[0] if isinstance(what, tuple) else what
        with open(os.environ["DEPTHMOCAP_WATCHED"], "a", encoding="utf-8") as file:
            file.write(f"{event} {host}\\n")

sys.addaudithook(_watch)
"""


def watched_environment(folder: Path) -> dict[str, str]:
    """Variables under which Python processes note what they do on the network in ``folder``."""
    (folder / "sitecustomize.py").write_text(_HOOK, encoding="utf-8")
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {"PYTHONPATH": os.pathsep.join(paths), "DEPTHMOCAP_WATCHED": str(folder / "python.log")}


def contacts(folder: Path) -> set[str]:
    """Hosts and names that processes asked for, loopback left out."""
    log = folder / "python.log"
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    return {line for line in lines if not _is_local(line.partition(" ")[2])}


def _is_local(host: str) -> bool:
    if host in ("None", "", "localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def strace(log: Path) -> list[str]:
    """The start of a command line that has its connections noted in ``log``; empty where there is no strace."""
    program = shutil.which("strace")
    if program is None:
        return []
    return [program, "-f", "-qq", "--seccomp-bpf", "-e", "trace=connect,sendto,sendmsg,sendmmsg", "-o", str(log)]


def traced_contacts(log: Path) -> set[str]:
    """Addresses in the log of strace that are not of this machine."""
    text = log.read_text(encoding="utf-8", errors="replace")
    found = re.findall(r'(?:inet_addr\("|inet_pton\(AF_INET6, ")([^"]+)', text)
    return {each for each in found if not _is_local(each.removeprefix("::ffff:"))}


def listening(processes: Iterable[int]) -> set[str]:
    """Addresses on which these processes listen, of Linux."""
    inodes = set()
    for process in processes:
        for link in Path(f"/proc/{process}/fd").glob("*"):
            try:
                inodes.add(link.readlink().name)
            except OSError:  # closed meanwhile
                continue
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
                found.add(_address(fields[1].partition(":")[0]))
    return found


def _address(kernel: str) -> str:
    """An address as the kernel prints it: words of four bytes, each in the machine's order."""
    raw = b"".join(bytes.fromhex(kernel[at : at + 8])[::-1] for at in range(0, len(kernel), 8))
    address = ipaddress.ip_address(raw)
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address)


def descendants(process: int) -> set[int]:
    """The process and all that it started, of Linux."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:  # ended meanwhile
            continue
        parents[int(stat.parent.name)] = int(fields[1])
    found = {process}
    while grown := {child for child, parent in parents.items() if parent in found} - found:
        found |= grown
    return found
