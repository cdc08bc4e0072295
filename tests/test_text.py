import io
import logging
from pathlib import Path

import pytest
from rich.live import Live
from rich.table import Table
from rich.text import Text

from depthmocap.cli import main
from depthmocap.core.console import Terminal, progress_text
from depthmocap.errors import LONGEST, InputError
from depthmocap.text import camera_list, harmless, joined, shortened

HOSTILE = "left[/x]\x1b[2J\x07\r\n• forged :bug: \u202e\udcff"
SHOWN = r"left[/x]\x1b[2J\x07\r\n• forged :bug: \u202e\udcff"


@pytest.mark.parametrize("text", ["Küche links", "カメラ 1", "دوربین\u200cها", "a\u00a0b", "$\\frac{$", "[/x]"])
def test_text_that_can_be_printed_stays_as_it_is(text: str) -> None:
    assert harmless(text) == text


def test_what_steers_a_terminal_or_forges_lines_is_shown_as_python_writes_it() -> None:
    assert harmless(HOSTILE) == SHOWN


def test_the_terminal_shows_hostile_text_on_one_line_by_whatever_way_it_comes() -> None:
    from rich.progress import track

    console = Terminal()
    console.file = io.TextIOWrapper(written := io.BytesIO(), encoding="utf-8")
    table = Table("camera", title=HOSTILE)
    table.add_row(HOSTILE)
    table.add_row(Text(HOSTILE))
    console.print(HOSTILE)
    console.print(table)
    for _ in track(range(1), progress_text(HOSTILE), console=console):
        pass
    with Live(table, console=console):
        pass
    console.file.flush()
    lines = written.getvalue().decode().splitlines()
    assert not any(letter in line for line in lines for letter in "\x1b\x07\r\u202e")
    assert lines[0] == SHOWN
    assert sum(SHOWN in line for line in lines) >= 5  # of it printed, in two titles, two cells and the progress bar


def test_warnings_of_commands_are_harmless_lines(tmp_path: Path) -> None:
    assert main(["info", str(tmp_path)]) == 2
    record = logging.LogRecord("depthmocap", logging.WARNING, "", 0, "left out: %s", (HOSTILE,), None)
    assert logging.lastResort is not None
    assert logging.lastResort.format(record) == f"left out: {SHOWN}"


def test_a_message_that_is_too_long_loses_the_middle_of_what_it_quotes() -> None:
    path, fix = "/recordings/" + "x" * 500 + "/rig.json", "rename it in rig.json, and the folder of its frames"
    message = str(InputError(f"{path}: camera 'left' cannot be a folder's name; {fix}\nand a second line"))
    assert len(message) == LONGEST
    assert message.startswith("/recordings/xxx")
    assert f"…{'x' * 20}" in message
    assert message.endswith(rf"xxx/rig.json: camera 'left' cannot be a folder's name; {fix}\nand a second line")


@pytest.mark.parametrize("text", ["word " * 200, "'" + "a" * 400 + "' and '" + "b" * 500 + "'", "é" * 1000])
def test_no_text_is_longer_than_what_it_may_be(text: str) -> None:
    assert shortened("short", 5) == "short"
    assert len(shortened(text, 100)) <= 100
    assert "…" in shortened(text, 100)


def test_what_is_told_of_several_is_one_sentence() -> None:
    assert camera_list(["a"]) == "camera 'a'"
    assert camera_list(["a", "b", "c"]) == "cameras 'a', 'b' and 'c'"
    assert joined([]) == ""
    assert joined(["one is bad.", "one is bad", "two is bad"]) == "one is bad; two is bad"
    assert joined(["a", "b", "c", "d"]) == "a; b; and 2 more"
