"""Corrections from the page: what is clicked is in the edit file at once, and shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viewed import COMES_AT, SETS

from depthmocap.body.skeleton import MIRROR
from depthmocap.errors import InputError
from depthmocap.exporting import read_trc
from depthmocap.exporting.edits import EDITS_FILE, Edits, write_edits
from depthmocap.exporting.stored_result import read_result
from depthmocap.viewing.edit_controls import EditControls
from depthmocap.viewing.take_page import TakePage
from depthmocap.viewing.viewed_take import open_take
from depthmocap.viewing.viewer_page import Page


@pytest.fixture
def controls(page: Page, result: Path) -> EditControls:
    return EditControls(TakePage(page, open_take((result,))))


def choose(handle: Any, value: Any) -> None:
    """Set an input, or click one of a group of buttons."""
    handle._impl.value = value


def test_left_and_right_are_exchanged_over_a_span(controls: EditControls, result: Path) -> None:
    view = controls._view
    before = read_result(result).people[0].table.joints
    for frame, which in ((1, "is the first"), (3, "is the last")):
        view.player.go_to(frame)
        choose(controls.here, which)
        controls._take_frame()
    choose(controls.person, "person 1")
    controls._over_span("exchange")
    after = read_result(result).people[0].table.joints
    assert np.array_equal(after[1:4], before[1:4][:, MIRROR]) and np.array_equal(after[:1], before[:1])
    assert np.array_equal(view.take.people[0].table.joints, after, equal_nan=True)
    assert "left and right exchanged" in controls.done.content
    controls._undo()
    assert not (result / EDITS_FILE).exists() and "Nothing was corrected" in controls.done.content
    with pytest.raises(InputError, match="nothing was corrected"):
        controls._undo()


def test_people_are_split_joined_named_and_deleted(controls: EditControls, result: Path) -> None:
    view = controls._view
    view.player.go_to(COMES_AT + 1)
    choose(controls.person, "person 2")
    controls._split()
    assert [person.number for person in read_result(result).people] == [1, 2, 3]
    choose(controls.person, "person 1")
    choose(controls.other, "person 3")
    controls._join()
    choose(controls.name, "Ann")
    choose(controls.naming, "the person")
    controls._give_name()
    assert controls.person.options == ("1 Ann", "person 2") == view.person.options[1:]
    choose(controls.naming, "the take")
    choose(controls.name, "<b>walk</b>")
    controls._give_name()
    stored = read_result(result)
    assert stored.name == "<b>walk</b>" and [person.label for person in stored.people] == ["Ann", "person 2"]
    assert "&lt;b&gt;walk" in controls.done.content and "<b>walk" not in controls.done.content
    view.draw(1)
    assert "&lt;b&gt;walk" in view.status.content


def test_only_a_part_is_kept(controls: EditControls) -> None:
    view = controls._view
    controls.first.value, controls.last.value = 2, 5
    controls._trim()
    assert len(view.take) == 4 and view.slider.max == 3 and (controls.first.value, controls.last.value) == (0, 3)
    view.draw(3)
    controls.first.value, controls.last.value = 3, 1
    with pytest.raises(InputError, match="ends at frame 1"):
        controls._trim()
    controls._undo()
    assert len(view.take) == SETS


def test_markers(controls: EditControls, result: Path) -> None:
    view = controls._view
    with pytest.raises(InputError, match="no marker"):
        controls._use_marker()
    with pytest.raises(InputError, match="what the marker says"):
        controls._set_marker()
    view.player.go_to(4)
    choose(controls.text, "trial 3")
    controls._set_marker()
    (marker,) = read_result(result).markers
    assert marker.text == "trial 3" and marker.timestamp_ns == view.take.stamps_ns[4]
    view.draw(3)
    assert "trial 3" not in view.status.content
    view.draw(5)
    assert "trial 3" in view.status.content
    view.player.go_to(0)
    choose(controls.marked, "go there")
    controls._use_marker()
    assert view.player.index == 4
    choose(controls.marked, "remove")
    controls._use_marker()
    assert read_result(result).markers == ()


def test_what_cannot_be_is_told_and_changes_nothing(
    controls: EditControls, result: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(controls._view.page, "tell", lambda text, wrong=False: told.append(text))
    choose(controls.other, controls.person.value)
    controls._showing_errors(controls._join)()
    digest = read_result(result).edits.digest
    write_edits(result, Edits(digest, (), controls._edits.markers))
    choose(controls.text, "a")
    controls._set_marker()
    write_edits(result, Edits(digest))  # somebody else
    controls._showing_errors(controls._set_marker)()
    assert "cannot be joined" in told[0] and "by somebody else" in told[1] and len(told) == 2
    assert not (result / EDITS_FILE).exists()


def test_the_part_that_was_chosen_is_exported(controls: EditControls, result: Path) -> None:
    controls.first.value, controls.last.value = 2, 6
    controls._trim()
    choose(controls.format, "trc")
    controls._export()
    times_s, *_ = read_trc(result / "export" / "person-1" / "pose.trc")
    assert len(times_s) == 5
    controls._export()  # into the same folder again
    for name, message in (("../elsewhere", "cannot be a folder's name"), ("person-1", "not made by an export")):
        choose(controls.folder, name)
        with pytest.raises(InputError, match=message):
            controls._export()
