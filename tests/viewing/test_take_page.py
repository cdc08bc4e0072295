"""The page of a take, by the server's own side: what is drawn, what controls do, what is refused."""

from __future__ import annotations

import contextlib
import io
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viewed import COMES_AT, GAP, OFF_M, SETS

from depthmocap.cli import main
from depthmocap.errors import InputError
from depthmocap.exporting.edits import Edit, Edits, TakeMarker, write_edits
from depthmocap.exporting.stored_result import read_result
from depthmocap.viewing.display_colours import confidence_colours, distance_colours
from depthmocap.viewing.take_page import TakePage
from depthmocap.viewing.viewed_take import open_take
from depthmocap.viewing.viewer_page import Page, as_html


def bones(drawing: Any) -> np.ndarray:
    """The ends of the bones that are drawn."""
    assert drawing._bones.visible
    return drawing._bones.points


def test_an_instant_is_drawn(page: Page, result: Path) -> None:
    take = open_take((result,))
    view = TakePage(page, take)
    view.draw(COMES_AT)
    joints = take.people[0].series(COMES_AT, COMES_AT + 1)[0][0]
    first, second, *others = view._people
    assert np.abs(bones(first)[..., 0].mean() - joints[:, 0].mean()) < 0.1
    assert np.allclose(bones(second) - bones(first), [0.8, 0, 0], atol=1e-5)
    assert not any(other._bones.visible for other in others)
    assert np.allclose(bones(first)[0] - bones(view._truth)[0], [OFF_M, 0, 0], atol=1e-5)
    assert view.drawing._cloud.visible and 10_000 < len(view.drawing._cloud.points) <= 30_000
    assert "confidence 0.90" in view.status.content and "frame 3 of 7" in view.status.content
    assert "from the truth: 2.0 cm" in view.status.content

    view.draw(GAP[0])
    # Who is not seen is not drawn, and the others move up.
    assert not second._bones.visible and "person 1: not seen" in view.status.content
    # The plot gets None where nothing is known, from which it leaves a gap.
    assert [value is None for value in view.plots._joint.data[1]] == [i in GAP for i in range(SETS)]


def test_controls_choose_what_is_drawn(page: Page, result: Path) -> None:
    view = TakePage(page, open_take((result,)))
    view.cloud.value, view.truth.value, view.person.value = "off", False, "person 2"
    view.draw(COMES_AT)
    first, second, *_ = view._people
    assert first._bones.visible and not second._bones.visible and not view._truth._bones.visible
    assert not view.drawing._cloud.visible
    view.colours.value, view.trails.value, view.person.value = "by person", True, "everybody"
    view.draw(COMES_AT + 1)
    assert len(np.unique(first._bones.colors.reshape(-1, 3), axis=0)) == 1 and first._trails.visible
    view.cloud.value, view.points.value = "by depth", "10,000"
    view.draw(COMES_AT)
    assert 1000 < len(view.drawing._cloud.points) <= 10_000
    view.colours.value = "off"
    view.draw(COMES_AT)
    assert not first._bones.visible
    view.show_pictures.value = True
    view.draw(COMES_AT)
    assert all(picture.visible and picture.image.shape[2] == 3 for picture in view._pictures.values())


def test_jumps_go_to_gaps_and_to_the_worst(page: Page, result: Path) -> None:
    view = TakePage(page, open_take((result,)))
    view.person.value = "person 1"
    view._choose_person()
    for kind, index in (("gap ›", GAP[0]), ("worst ›", 2), ("gap ›", GAP[0]), ("‹ gap", GAP[0])):
        view.jumps._impl.value = kind
        view._jump()
        assert view.player.index == index and not view.player.playing
    view.step(-1)
    assert view.player.index == GAP[0] - 1


def test_it_plays(page: Page, result: Path) -> None:
    import time

    with TakePage(page, open_take((result,))) as view:
        view._play(True)
        end_s = time.monotonic() + 10
        seen = set()
        while len(seen) < 3 and time.monotonic() < end_s:
            seen.add(int(view.slider.value))
            time.sleep(0.01)
        assert len(seen) >= 3


def test_names_from_files_are_text(page: Page, result: Path) -> None:
    digest = read_result(result).edits.digest
    bad = "<img src=x onerror=alert(1)>"
    edits = (Edit("name", name=bad), Edit("name", 1, name=bad))
    write_edits(result, Edits(digest, edits, (TakeMarker(int(open_take((result,)).stamps_ns[0]), bad),)))
    view = TakePage(page, open_take((result,)))
    view.draw(1)
    assert view.status.content.count("&lt;img src=x") == 3 and "<img" not in view.status.content
    assert as_html("a\n\x1b[2J<b>") == "a\\n\\x1b[2J&lt;b&gt;"


def test_colours() -> None:
    red, green = confidence_colours(np.array([0.0, 1.0]))
    assert red[0] > 200 > red[1] and green[1] > 200 > green[0]
    near, far = distance_colours(np.array([0.5, 5.0]), 0.5, 5.0)
    assert near[0] > near[2] and far[2] > far[0]


def test_addresses_that_cannot_be_served(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", str(result), "--no-open", "--port", str(port)]) == 2
    for more in (["--port", "70000"], ["--host", "192.0.2.1"]):
        assert main(["view", str(result), "--no-open", "--port", "0", *more]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3 and f"cannot serve on 127.0.0.1:{port}" in errors[0]
    assert "--port must be" in errors[1] and "cannot serve on 192.0.2.1" in errors[2]


def test_nothing_is_printed_and_no_tunnel_opened() -> None:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), Page("127.0.0.1", 0, "t") as page:
        assert page.server.request_share_url() is None
        with pytest.raises(InputError, match="cannot serve"):
            Page("127.0.0.1", page.server.get_port(), "t")
    assert said.getvalue() == ""


def test_no_browser_in_the_terminal(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: not opened.append(url))
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not page.open_browser() and not opened
    monkeypatch.setenv("DISPLAY", ":0")
    assert page.open_browser() and opened == [page.url]


def test_the_whole_take_has_a_time(page: Page, recording: Path) -> None:
    view = TakePage(page, open_take((recording,)))
    view.draw(SETS - 1)
    assert f"frame {SETS - 1} of {SETS - 1}" in view.status.content and view._truth._bones.visible
