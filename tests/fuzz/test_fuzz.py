"""A short round of ``make fuzz``: the same cases each time."""

from pathlib import Path

import pytest
from readers import READERS

from fuzz import Cases, kind_of

#: Those whose pictures are of a size that their format sets take longer to read; torch takes long to import.
SLOW, LEFT_OUT = ("ubc3v", "mhad", "panoptic", "eval", "ridge", "itop", "label", "recording"), ("weights", "checkpoint")


@pytest.mark.parametrize("reader", [reader for reader in READERS if reader not in LEFT_OUT])
def test_whatever_is_in_a_file_is_read_or_refused_in_one_line(reader: str, tmp_path: Path) -> None:
    for package in READERS[reader].needs:
        pytest.importorskip(package)
    cases = Cases(reader, tmp_path, seed=1)
    for number in range(1 if reader in SLOW else 4):
        fault = cases.fault(number)
        assert not fault, f"case {number}: {kind_of(fault)}\n{fault}"


def test_a_case_is_made_of_its_reader_seed_and_number_alone(tmp_path: Path) -> None:
    contents, whole = [], {}
    for i, numbers in enumerate([(3, 7), (7,)]):
        (tmp_path / str(i)).mkdir()
        cases = Cases("recording", tmp_path / str(i), seed=2)
        whole = {path.name: data for path, data in cases._whole.items()}
        for number in numbers:
            cases.spoil(number)
        contents.append({path.name: path.read_bytes() for path in cases.folder.rglob("*") if path.is_file()})
    assert contents[0] == contents[1]
    assert contents[0] != whole
