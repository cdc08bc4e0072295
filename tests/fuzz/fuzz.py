"""``make fuzz``: spoilt inputs for every reader, each reader in a process of its own.

Whatever is in a file, it is read or refused by an ``InputError`` of one line, within 10 seconds and 1 GB. A case is
made of its reader, the seed and its number alone:
``python tests/fuzz/fuzz.py --readers rig --seed 0 --first 1234 --cases 1 --keep FOLDER`` shows what comes of it, and
keeps its input.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import faulthandler
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
from mutations import spoilt
from reader import check_message
from readers import READERS

from depthmocap.errors import InputError

#: A case takes no longer (s), and its process no more memory (bytes).
LONGEST_S, LARGEST = 10.0, 1 << 30
#: Room for what is asked for and never used (bytes).
_ASKED = 3 << 29


class Cases:
    """The cases of one reader: its whole input is made once, and files of it are spoilt and put back."""

    def __init__(self, reader: str, folder: Path, seed: int) -> None:
        self._reader, self._words = READERS[reader], [seed, zlib.crc32(reader.encode())]
        self.folder = folder / "input"
        self.folder.mkdir()
        self._reader.make(self.folder)
        files = sorted(path for path in self.folder.rglob("*") if path.is_file())
        self._whole = {path: path.read_bytes() for path in files}
        self._files = [path for path in files if any(part in path.name for part in self._reader.only)]
        self._reader.read(self.folder)  # what is whole is read
        self._spoilt: list[Path] = []

    def spoil(self, number: int) -> None:
        """Put the case's input into the folder."""
        for path in self._spoilt:
            path.write_bytes(self._whole[path])
        rng = np.random.default_rng([*self._words, number])
        self._spoilt = [self._files[int(rng.integers(len(self._files)))] for _ in range(int(rng.choice((1, 1, 1, 2))))]
        for path in self._spoilt:
            path.write_bytes(spoilt(path, self._whole[path], rng))

    def fault(self, number: int) -> str:
        """What is wrong with what comes of a case, "" for nothing."""
        self.spoil(number)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                self._reader.read(self.folder)
        except InputError as error:
            try:
                check_message(str(error))
            except AssertionError as fault:
                return str(fault)
        except OSError as error:
            if error.filename is None:  # commands show others as a line of the file and what is wrong with it
                return "".join(traceback.format_exception(error))
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            return "".join(traceback.format_exception(error))
        return ""


def kind_of(fault: str) -> str:
    """Where in the package it came to be, and what it is."""
    lines = fault.strip().splitlines()
    places = [line.strip() for line in lines if "/depthmocap/" in line and line.strip().startswith("File")]
    place = places[-1].split("/depthmocap/")[-1].replace('", line ', ":").split(", in ") if places else ["?", "?"]
    return f"{place[0]} {place[-1]}: {lines[-1].partition(':')[0][:80] if lines else ''}"


def _child(reader: str, seed: int, first: int, last: int) -> None:
    """Run cases, and write the number of each before it begins and its fault after it."""
    faulthandler.enable()
    told = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what a library prints is not ours
    with tempfile.TemporaryDirectory() as folder:
        cases = Cases(reader, Path(folder), seed)
        _limit_memory()
        for number in range(first, last):
            told.write(f"{json.dumps([number, None])}\n")
            with contextlib.redirect_stdout(io.StringIO()):
                fault = cases.fault(number)
            if not fault and _peak() > LARGEST:
                fault = f"MemoryError: more than {LARGEST >> 20} MB"
            told.write(f"{json.dumps([number, fault])}\n")
            if _peak() > LARGEST:
                return  # memory that was once taken counts for ever


def _limit_memory() -> None:
    try:
        import resource
    except ModuleNotFoundError:  # not on Windows
        return
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + _ASKED, resource.RLIM_INFINITY))


def _peak() -> int:
    try:
        import resource
    except ModuleNotFoundError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def run_reader(reader: str, seed: int, first: int, last: int, until_s: float) -> Iterator[tuple[int, str]]:
    """The faults of a reader's cases, by number; a process that dies or hangs is followed by another."""
    number = first
    while number < last and time.monotonic() < until_s:
        arguments = [sys.executable, __file__, "--child", reader, str(seed), str(number), str(last)]
        with tempfile.TemporaryFile("w+") as errors:
            child = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=errors, text=True)
            assert child.stdout is not None
            begun: int | None = None
            hung = threading.Event()
            watch = _Watch(child, hung)
            for line in child.stdout:
                watch.feed()
                with contextlib.suppress(ValueError):
                    at, fault = json.loads(line)
                    begun = at if fault is None else None
                    if fault is not None:
                        number = at + 1
                        yield at, fault
                if time.monotonic() > until_s:
                    child.kill()
            child.wait()
            watch.end()
            if begun is not None and time.monotonic() < until_s:
                errors.seek(0)
                why = f"hung for {LONGEST_S:.0f} s" if hung.is_set() else f"died with {child.returncode}"
                number = begun + 1
                yield begun, f"{errors.read()[-2000:]}\n{why}"
            elif child.returncode and time.monotonic() < until_s:
                errors.seek(0)
                raise RuntimeError(f"{reader}: its cases cannot be made\n{errors.read()[-3000:]}")


class _Watch:
    """Ends a process that says nothing for too long; it has longer to begin."""

    def __init__(self, child: subprocess.Popen[str], hung: threading.Event) -> None:
        self._child, self._hung, self._last = child, hung, time.monotonic() + 90
        self._over = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def feed(self) -> None:
        self._last = time.monotonic()

    def end(self) -> None:
        self._over.set()

    def _run(self) -> None:
        while not self._over.wait(0.2):
            if time.monotonic() - self._last > LONGEST_S:
                self._hung.set()
                self._child.kill()
                return


def main() -> int:
    """Returns 1 when there was a fault."""
    if sys.argv[1:2] == ["--child"]:
        reader, *numbers = sys.argv[2:]
        _child(reader, *map(int, numbers))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readers", nargs="*", default=list(READERS), choices=list(READERS), metavar="READER")
    parser.add_argument("--cases", type=int, default=2000, help="of each reader")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0, help="of all readers together, at most")
    parser.add_argument("--keep", type=Path, help="a folder for the input of every case that has a fault")
    settings = parser.parse_args()
    until_s, found = time.monotonic() + 60 * settings.minutes, 0
    for reader in settings.readers:
        kinds: dict[str, list[int]] = collections.defaultdict(list)
        begun, count, hangs, large = time.monotonic(), 0, 0, 0
        last = settings.first + settings.cases
        for number, fault in run_reader(reader, settings.seed, settings.first, last, until_s):
            count += 1
            if fault:
                kinds[kind_of(fault)].append(number)
                hangs, large = hangs + ("hung for" in fault[-30:]), large + ("MemoryError" in fault[-200:])
                if settings.cases == 1:
                    print(fault)
                if settings.keep is not None:
                    _keep(reader, settings.seed, number, settings.keep)
        faults = sum(map(len, kinds.values()))
        found += faults
        seconds = time.monotonic() - begun
        print(
            f"{reader}: {count} cases in {seconds:.0f} s, {faults - hangs - large} tracebacks, {hangs} hangs, "
            f"{large} beyond {LARGEST >> 20} MB",
            flush=True,
        )
        for kind, numbers in sorted(kinds.items(), key=lambda each: -len(each[1])):
            some = ", ".join(map(str, numbers[:4])) + (", …" if len(numbers) > 4 else "")
            print(f"  {len(numbers)} × {kind} (cases {some})", flush=True)
    return min(found, 1)


def _keep(reader: str, seed: int, number: int, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as made:
        cases = Cases(reader, Path(made), seed)
        cases.spoil(number)
        shutil.copytree(cases.folder, folder / f"{reader.replace(' ', '-')}-{seed}-{number}", dirs_exist_ok=True)


if __name__ == "__main__":
    sys.exit(main())
