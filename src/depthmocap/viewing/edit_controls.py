"""Controls that correct a result on its page; every correction is kept in ``edits.json`` at once."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Sequence
from typing import get_args

import viser

from depthmocap.core.camera_names import safe_name
from depthmocap.core.console import Terminal
from depthmocap.core.locks import lock_folder
from depthmocap.errors import InputError
from depthmocap.exporting.edits import EDITS_FILE, LONGEST_NAME, Edit, Edits, TakeMarker, read_edits, write_edits
from depthmocap.exporting.export_command import EXPORT_FILE, ExportSettings, export
from depthmocap.exporting.file_settings import FormatName
from depthmocap.exporting.stored_result import StoredResult
from depthmocap.viewing.take_page import TakePage, person_choice
from depthmocap.viewing.viewer_page import as_html, every, plain

#: Corrections that are listed, the last at the end.
_LISTED = 12
NOBODY: str = "–"


class EditControls:
    """The tab of corrections of a page that shows a result."""

    def __init__(self, view: TakePage) -> None:
        assert view.take.result is not None
        self._view, self._lock = view, threading.Lock()
        self._original: StoredResult = view.take.result
        self._edits: Edits = view.take.result.edits
        gui = view.page.server.gui
        with view.tabs.add_tab("Correct", viser.Icon.PENCIL):
            self.done = gui.add_html("")
            self.undo = gui.add_button("Undo the last", icon=viser.Icon.ARROW_BACK_UP)
            self.person: viser.GuiDropdownHandle[str] = gui.add_dropdown("Person", (NOBODY,))
            with gui.add_folder("Over a span of frames"):
                last = len(view.take) - 1
                self.first = gui.add_number("From", 0, min=0, step=1)
                self.last = gui.add_number("To", last, min=0, step=1)
                self.here = gui.add_button_group("This frame", ("is the first", "is the last"))
                self.exchange = gui.add_button("Exchange left and right")
                self.delete = gui.add_button("Delete the person's poses")
                self.trim = gui.add_button("Keep only this part of the take")
            with gui.add_folder("People"):
                self.split = gui.add_button("Split: from this frame on somebody else")
                self.other: viser.GuiDropdownHandle[str] = gui.add_dropdown("Other", (NOBODY,))
                self.join = gui.add_button("Join: the other is the same person")
                self.remove = gui.add_button("Delete the person")
            with gui.add_folder("Names"):
                self.name = gui.add_text("Name", "")
                self.naming = gui.add_button_group("Give it to", ("the person", "the take"))
            with gui.add_folder("Markers"):
                self.text = gui.add_text("Marker", "")
                self.mark = gui.add_button("Set it at this frame")
                self.markers: viser.GuiDropdownHandle[str] = gui.add_dropdown("Set", (NOBODY,))
                self.marked = gui.add_button_group("It", ("go there", "remove"))
            with gui.add_folder("Export, with these corrections"):
                self.format = gui.add_dropdown("Format", get_args(FormatName))
                self.folder = gui.add_text("Folder", "export", hint="in the folder of the results")
                self.export = gui.add_button("Export", icon=viser.Icon.DOWNLOAD)
        for handle, call in (
            (self.undo, self._undo), (self.here, self._take_frame),
            (self.exchange, lambda: self._over_span("exchange")),
            (self.delete, lambda: self._over_span("delete")), (self.trim, self._trim), (self.split, self._split),
            (self.join, self._join), (self.remove, lambda: self._add(Edit("delete", self._number(self.person)))),
            (self.naming, self._give_name), (self.mark, self._set_marker), (self.marked, self._use_marker),
            (self.export, self._export),
        ):  # fmt: skip
            every(handle, self._showing_errors(call))
        self._refresh()

    def _showing_errors(self, call: Callable[[], None]) -> Callable[[], None]:
        def showing() -> None:
            with self._view.page.errors_shown(), self._lock:
                call()

        return showing

    def _change(self, edits: Edits) -> None:
        """Show the result with these corrections, and keep them.

        Raises:
            InputError: when they do not fit the result, somebody else has changed them, or they cannot be written.
        """
        result, folder = self._original.edited(edits), self._original.folder
        if read_edits(folder, edits.digest) != self._edits:
            raise InputError(f"{folder / EDITS_FILE} was changed by somebody else: open the page anew")
        self._view.change_result(result)
        with lock_folder(folder):
            write_edits(folder, edits)
        self._edits = edits
        self._refresh()

    def _add(self, edit: Edit) -> None:
        self._change(dataclasses.replace(self._edits, edits=(*self._edits.edits, edit)))

    def _undo(self) -> None:
        if not self._edits.edits:
            raise InputError("nothing was corrected")
        self._change(dataclasses.replace(self._edits, edits=self._edits.edits[:-1]))

    def _refresh(self) -> None:
        """Lists as they are now."""
        people = tuple(person_choice(person.number, person.label) for person in self._view.take.people) or (NOBODY,)
        for dropdown in (self.person, self.other):
            if dropdown.options != people:
                dropdown.options = people
        result = self._view.take.result
        markers = tuple(self._marker_choice(marker) for marker in (result.markers if result is not None else ()))
        if self.markers.options != (markers or (NOBODY,)):
            self.markers.options = markers or (NOBODY,)
        lines = [as_html(self._words(edit), 120) for edit in self._edits.edits[-_LISTED:]]
        more = len(self._edits.edits) - len(lines)
        text = "<br>".join([*([f"… and {more} before"] if more else []), *lines]) or "Nothing was corrected."
        self.done.content = f'<div style="padding: 0.4em 1em; font-size: 0.85em">{text}</div>'

    def _words(self, edit: Edit) -> str:
        """A correction in words."""
        start_ns = min(int(table.stamps_ns[0]) for table in self._original.original.values())

        def at(stamp: int | None, otherwise: str) -> str:
            return otherwise if stamp is None else f"{(stamp - start_ns) * 1e-9:.2f} s"

        whom = "the take" if edit.person is None else f"person {edit.person}"
        span = f"{at(edit.first_ns, 'the start')} to {at(edit.last_ns, 'the end')}"
        whole = edit.first_ns is None and edit.last_ns is None
        return {
            "name": f"{whom} is called {edit.name}",
            "join": f"person {edit.other} is {whom}",
            "split": f"{whom} is person {edit.other} from {at(edit.first_ns, 'the start')} on",
            "exchange": f"{whom}: left and right exchanged, {span}",
            "delete": f"{whom} deleted" + ("" if whole else f", {span}"),
            "trim": f"only {span}",
        }[edit.kind]

    def _marker_choice(self, marker: TakeMarker) -> str:
        seconds = (marker.timestamp_ns - int(self._view.take.stamps_ns[0])) * 1e-9
        return plain(f"{seconds:.2f} s {marker.text}")

    def _number(self, dropdown: viser.GuiDropdownHandle[str]) -> int:
        """The number of the person who is chosen in a list."""
        for person in self._view.take.people:
            if person_choice(person.number, person.label) == dropdown.value:
                return person.number
        raise InputError("choose a person")

    def _stamp(self, frame: int) -> int:
        return int(self._view.take.stamps_ns[min(max(frame, 0), len(self._view.take) - 1)])

    def _span(self) -> tuple[int, int]:
        first, last = int(self.first.value), int(self.last.value)
        if first > last:
            raise InputError(f"the span ends at frame {last}, before it begins at {first}")
        return self._stamp(first), self._stamp(last)

    def _take_frame(self) -> None:
        (self.first if self.here.value == "is the first" else self.last).value = self._view.player.index

    def _over_span(self, kind: str) -> None:
        first_ns, last_ns = self._span()
        number = self._number(self.person)
        exchange = Edit("exchange", number, first_ns=first_ns, last_ns=last_ns)
        self._add(exchange if kind == "exchange" else dataclasses.replace(exchange, kind="delete"))

    def _trim(self) -> None:
        first_ns, last_ns = self._span()
        self._add(Edit("trim", first_ns=first_ns, last_ns=last_ns))
        self.first.value, self.last.value = 0, len(self._view.take) - 1

    def _split(self) -> None:
        numbers = [*self._original.original, *(edit.other for edit in self._edits.edits if edit.other is not None)]
        stamp = self._stamp(self._view.player.index)
        self._add(Edit("split", self._number(self.person), max(numbers) + 1, first_ns=stamp))

    def _join(self) -> None:
        self._add(Edit("join", self._number(self.person), self._number(self.other)))

    def _give_name(self) -> None:
        person = self._number(self.person) if self.naming.value == "the person" else None
        self._add(Edit("name", person, name=self.name.value[:LONGEST_NAME]))

    def _set_marker(self) -> None:
        marker = TakeMarker(self._stamp(self._view.player.index), self.text.value[:LONGEST_NAME])
        if not marker.text:
            raise InputError("write what the marker says")
        self._change(dataclasses.replace(self._edits, markers=(*self._edits.markers, marker)))

    def _use_marker(self) -> None:
        chosen = [marker for marker in self._edits.markers if self._marker_choice(marker) == self.markers.value]
        if not chosen:
            raise InputError("no marker is set")
        if self.marked.value == "go there":
            self._view.step(self._view.take.index_at(chosen[0].timestamp_ns) - self._view.player.index)
        else:
            left: Sequence[TakeMarker] = [marker for marker in self._edits.markers if marker != chosen[0]]
            self._change(dataclasses.replace(self._edits, markers=tuple(left)))

    def _export(self) -> None:
        name = self.folder.value.strip()
        if name != safe_name(name):
            raise InputError(f"{name!r} cannot be a folder's name: call it {safe_name(name)!r}")
        folder, chosen = self._original.folder, self.format.value
        settings = ExportSettings(folder, folder / name, formats=(chosen,))
        if settings.out.exists() and not (settings.out / EXPORT_FILE).exists():
            raise InputError(f"{settings.out} was not made by an export: choose another name")
        paths = export(settings, Terminal(quiet=True))
        self._view.page.tell(f"{len(paths)} files written to {settings.out}")
