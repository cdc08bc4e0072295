import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from depth_scene import bands

from depthmocap.body.skeleton import JOINTS
from depthmocap.cameras.health import MAX_REPEATS
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.recordings.timestamps import StampSet, add_empty_sets, frame_period_ns, group_stamps

PERIOD = 33_000_000
EPOCH = 1_700_000_000_000_000_000


def make_rig() -> Rig:
    eyes = ((0.0, -3.0, 1.3), (3.0, 0.0, 1.3), (-2.0, 2.0, 1.0))
    sizes = ((32, 24), (40, 30), (16, 16))
    return Rig(
        tuple(
            DepthCamera(
                f"cam{i}", w, h, 30.0, 31.0, w / 2, h / 2, look_at(np.array(eye), np.array([0.0, 0.0, 1.0])),
                depth_unit_m=(0.001, 0.00025, 0.001)[i],
            )
            for i, (eye, (w, h)) in enumerate(zip(eyes, sizes, strict=True))
        ),
        up="z",
    )  # fmt: skip


def make_frame(camera: DepthCamera, seed: int = 0) -> np.ndarray:
    return bands((camera.height, camera.width), np.random.default_rng(seed))


def write(path: Path, stamps: dict[str, list[int]], truth: dict[int, np.ndarray] | None = None) -> Rig:
    rig = make_rig()
    with RecordingWriter(path, rig) as writer:
        for stamp in sorted({s for own in stamps.values() for s in own}):
            frames = {name: make_frame(rig[name], stamp % 1000) for name, own in stamps.items() if stamp in own}
            writer.write(stamp, frames, (truth or {}).get(stamp))
    return rig


def regular(count: int, start: int = 0) -> list[int]:
    return [start + i * PERIOD for i in range(count)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sound recording of six sets of three cameras."""
    write(tmp_path / "rec", {f"cam{i}": regular(6) for i in range(3)})
    return tmp_path / "rec"


@pytest.mark.parametrize("compression", [0, 1, 9])
def test_round_trip_is_exact(tmp_path: Path, compression: int) -> None:
    rig, rng = make_rig(), np.random.default_rng(0)
    raw = [{camera.name: make_frame(camera, i) for camera in rig.cameras} for i in range(4)]
    joints = [rng.normal(size=(18, 3)) for _ in range(4)]
    joints[2][3] = np.nan
    background = make_frame(rig["cam1"], 9)
    path = tmp_path / "räume" / "rec"
    with RecordingWriter(path, rig, {"cam1": background}, compression) as writer:
        for i, frames in enumerate(raw):
            writer.write(EPOCH + i * PERIOD, frames, joints[i])
    recording = Recording(path)
    assert (recording.up, recording.rig.names, recording.period_ns) == ("z", rig.names, PERIOD)
    assert len(recording) == 4
    for i, frame_set in enumerate(recording):
        assert frame_set.timestamp_ns == EPOCH + i * PERIOD
        assert [view.camera.name for view in frame_set.views] == list(rig.names)
        for view in frame_set.views:
            assert view.depth_m.dtype == np.float32
            expected = raw[i][view.camera.name].astype(np.float32) * np.float32(view.camera.depth_unit_m)
            np.testing.assert_array_equal(view.depth_m[view.depth_m > 0], expected[view.depth_m > 0])
        np.testing.assert_array_equal(frame_set.true_joints, joints[i])
    assert recording.problems == []
    assert recording.background("cam0") is None
    found = recording.background("cam1")
    assert found is not None
    np.testing.assert_allclose(found[background < 65535], background[background < 65535] * 0.00025, rtol=1e-6)


def test_period_is_the_fastest_cameras() -> None:
    assert frame_period_ns({"a": [0, 10, 20, 31, 40], "b": [0, 20, 40], "c": []}) == 10
    assert frame_period_ns({"a": [100 * i for i in range(30)], "broken": [0, 1]}) == 100
    assert frame_period_ns({"a": [5]}) == 33_333_333


def test_sets_are_within_half_a_period_and_take_one_frame_a_camera() -> None:
    stamps = {"a": [0, 100, 200, 300], "b": [30, 145, 260], "c": [10, 120, 130]}
    groups = [dict(s.stamps) for s in group_stamps(stamps, 100)]
    assert groups == [
        {"a": 0, "c": 10, "b": 30},
        {"a": 100, "c": 120},
        {"c": 130, "b": 145},
        {"a": 200},
        {"b": 260, "a": 300},
    ]
    times = [s.timestamp_ns for s in group_stamps(stamps, 100)]
    assert times == [10, 110, 137, 200, 280]
    assert [s.timestamp_ns for s in group_stamps({"a": [EPOCH + 1], "b": [EPOCH + 4]}, 100)] == [EPOCH + 2]


def test_time_offsets_move_sets_and_keep_timestamps() -> None:
    sets = group_stamps({"a": [0, 100], "b": [250, 350]}, 100, {"a": 125, "b": -125})
    assert [(s.timestamp_ns, dict(s.stamps)) for s in sets] == [(125, {"a": 0, "b": 250}), (225, {"a": 100, "b": 350})]


def test_gaps_become_empty_sets_and_long_pauses_do_not() -> None:
    def at(stamp: int) -> StampSet:
        return StampSet(stamp, {"a": stamp})

    sets, problems = add_empty_sets([at(0), at(100), at(148 + 100), at(552)], 100)
    assert [(s.timestamp_ns, bool(s.stamps)) for s in sets] == [
        (0, True), (100, True), (248, True), (349, False), (450, False), (552, True),
    ]  # fmt: skip
    assert problems == []
    sets, problems = add_empty_sets([at(0), at(60_000_000_000)], PERIOD)
    assert len(sets) == 2
    assert "60.0 s" in problems[0]


def test_missing_frames_and_gaps(tmp_path: Path) -> None:
    stamps = regular(10)
    own = {"cam0": [*stamps[:3], *stamps[6:]], "cam1": [s + 5_000_000 for s in (*stamps[:4], *stamps[6:])]}
    rig = write(tmp_path / "rec", own)
    shutil.rmtree(tmp_path / "rec" / "cam2")
    recording = Recording(tmp_path / "rec")
    names = [[view.camera.name for view in frame_set.views] for frame_set in recording]
    both = ["cam0", "cam1"]
    assert names == [both, both, both, ["cam1"], [], [], both, both, both, both]
    times = np.array([frame_set.timestamp_ns for frame_set in recording])
    assert np.abs(np.diff(times) - PERIOD).max() <= 2_500_000
    assert len(recording.problems) == 1
    assert "cam2" in recording.problems[0]
    assert [view.depth_m.shape for view in recording[0].views] == [(rig[name].height, rig[name].width) for name in both]


def test_a_misnamed_folder_is_reported(folder: Path) -> None:
    (folder / "cam2").rename(folder / "kinect2")
    problems = Recording(folder).problems
    assert any("cam2" in problem for problem in problems)
    assert any("kinect2" in problem for problem in problems)


def test_a_bad_later_frame_is_one_lost_view(folder: Path) -> None:
    bad = [folder / f"cam{i % 3}" / f"{(i + 1) * PERIOD}.png" for i in range(5)]
    bad[0].write_bytes(bad[0].read_bytes()[:-20])
    data = bytearray(bad[1].read_bytes())
    data[len(data) // 2] ^= 255
    bad[1].write_bytes(data)
    cv2.imwrite(str(bad[2]), np.zeros((16, 16), np.uint16))
    cv2.imwrite(str(bad[3]), np.full((24, 32), 65535, np.uint16))
    cv2.imwrite(str(bad[4]), np.zeros((30, 41), np.uint16))
    recording = Recording(folder)
    assert recording.problems == []
    for _ in range(2):  # a second pass reports nothing twice
        lost = [[c for c in recording.rig.names if c not in {v.camera.name for v in s.views}] for s in recording]
        assert lost == [[], ["cam0"], ["cam1"], ["cam2"], ["cam0"], ["cam1"]]
    assert len(recording.problems) == 5
    for path, problem in zip([bad[0], bad[1], bad[4], *bad[2:4]], recording.problems, strict=True):
        assert str(path) in problem
    assert all("no valid depth" in problem for problem in recording.problems[3:])


def test_frames_of_a_stuck_camera_are_left_out(tmp_path: Path) -> None:
    rig, count, stuck = make_rig(), 40, range(12, 35)
    with RecordingWriter(tmp_path / "rec", rig) as writer:
        for i, stamp in enumerate(regular(count)):
            frames = {camera.name: make_frame(camera, i) for camera in rig.cameras}
            if i in stuck:
                frames["cam1"] = make_frame(rig["cam1"], stuck[0])
            if i in (5, 6):
                frames["cam0"] = np.random.default_rng(i).integers(1, 60000, (24, 32)).astype(np.uint16)
            writer.write(stamp, frames)
    recording = Recording(tmp_path / "rec")
    out = range(stuck[0] + MAX_REPEATS, stuck[-1] + 1)  # as many equal ones a camera that works may deliver
    for _ in range(2):  # a second pass reports nothing twice
        seen = [{view.camera.name for view in frames.views} for frames in recording]
        assert [i for i, names in enumerate(seen) if "cam1" not in names] == list(out)
        assert [i for i, names in enumerate(seen) if "cam0" not in names] == [5, 6]
        assert all("cam2" in names for names in seen)
    noise, repeats = recording.problems
    assert f"{5 * PERIOD}.png: noise in place of depth (frames of 'cam0' left out from here on: 2)" in noise
    assert f"{out[0] * PERIOD}.png: the same picture again and again" in repeats
    assert f"(frames of 'cam1' left out from here on: {len(out)})" in repeats
    assert len(recording[stuck[-1]].views) == 3  # out of order nothing can be told


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((24, 31), np.uint16), "31×24 but rig.json says 32×24"),
        (np.zeros((24, 32), np.uint8), "8-bit grey"),
        (np.zeros((24, 32, 3), np.uint8), "8-bit RGB"),
        (np.zeros((24, 32, 4), np.uint16), "16-bit RGBA"),
        (None, "not a complete PNG"),
    ],
)
@pytest.mark.parametrize("name", ["0.png", "background.png"])
def test_a_bad_first_or_background_frame_is_an_error(
    folder: Path, image: np.ndarray | None, message: str, name: str
) -> None:
    path = folder / "cam0" / name
    if image is None:
        path.write_bytes((folder / "cam0" / "0.png").read_bytes()[:100])
    else:
        cv2.imwrite(str(path), image)
    with pytest.raises(InputError, match=message) as caught:
        Recording(folder)
    assert str(path) in str(caught.value)


def change_unit(folder: Path, unit_m: float) -> None:
    document = json.loads((folder / "rig.json").read_text())
    document["cameras"][1]["depth_unit_m"] = unit_m
    (folder / "rig.json").write_text(json.dumps(document))


def test_depth_of_another_unit(folder: Path) -> None:
    assert Recording(folder).problems == []
    change_unit(folder, 0.25)
    with pytest.raises(InputError, match=r"beyond .* further than any depth camera sees: see depth_unit_m of .*cam1"):
        Recording(folder)
    change_unit(folder, 2e-7)
    (problem,) = Recording(folder).problems
    assert "depth_unit_m of camera 'cam1'" in problem and "2e-07" in problem


def test_an_empty_background_is_an_error(folder: Path) -> None:
    cv2.imwrite(str(folder / "cam0" / "background.png"), np.zeros((24, 32), np.uint16))
    with pytest.raises(InputError, match="no valid depth"):
        Recording(folder)


def test_not_a_recording(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere is not a folder.*rig\.json"):
        Recording(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no rig\.json"):
        Recording(tmp_path)
    (tmp_path / "groundtruth.mat").touch()
    with pytest.raises(InputError, match="UBC3V section"):
        Recording(tmp_path)
    for i in range(3):
        shutil.rmtree(folder / f"cam{i}")
    with pytest.raises(InputError, match="no frames"):
        Recording(folder)


def test_file_names(folder: Path) -> None:
    (folder / "cam0" / "notes.txt").touch()
    (folder / "cam0" / "._0.png").touch()  # macOS leaves such files beside copies
    assert len(Recording(folder)) == 6
    copy = shutil.copy(folder / "cam0" / "0.png", folder / "cam0" / "00.png")
    with pytest.raises(InputError, match="same timestamp"):
        Recording(folder)
    for name in ("frame1.png", "1.5.png", "-3.png", "99999999999999999999.png"):
        copy = Path(copy).rename(folder / "cam0" / name)
        with pytest.raises(InputError, match=name):
            Recording(folder)


def test_a_camera_name_must_be_a_folder_name(folder: Path) -> None:
    text = (folder / "rig.json").read_text()
    (folder / "rig.json").write_text(text.replace('"cam2"', '"../cam2"'))
    with pytest.raises(InputError, match="cannot be a camera's name"):
        Recording(folder)


def test_clocks_must_agree(tmp_path: Path) -> None:
    apart = {"cam0": regular(5), "cam1": regular(5, EPOCH)}
    write(tmp_path / "apart", apart)
    with pytest.raises(InputError, match=r"'cam1'.*'cam0'.*clocks differ"):
        Recording(tmp_path / "apart")
    # A third camera that saw both spans vouches for the clocks: one was just exchanged for the other.
    write(tmp_path / "joined", {"cam0": regular(3), "cam1": regular(3, 6 * PERIOD), "cam2": regular(9)})
    assert len(Recording(tmp_path / "joined")) == 9


def test_truth_is_the_nearest_row_within_half_a_period(tmp_path: Path) -> None:
    stamps = regular(5, EPOCH)
    truth = {stamps[i]: np.full((18, 3), float(i)) for i in (0, 1, 3)}
    write(tmp_path / "rec", {"cam0": [s + 10_000_000 for s in stamps]})
    write(tmp_path / "other", {"cam0": stamps}, truth)
    shutil.copy(tmp_path / "other" / "truth.csv", tmp_path / "rec")
    found = [s.true_joints for s in Recording(tmp_path / "rec")]
    assert [None if joints is None else joints[0, 0] for joints in found] == [0, 1, None, 3, None]


def first_joints(recording: Recording) -> list[float | None]:
    return [None if s.true_joints is None else s.true_joints[0, 0] for s in recording]


def test_truth_has_the_frames_timestamps(tmp_path: Path) -> None:
    stamps = regular(4, EPOCH)
    write(tmp_path / "rec", {"cam0": stamps}, {stamp: np.full((18, 3), float(i)) for i, stamp in enumerate(stamps)})
    assert (tmp_path / "rec" / "truth.csv").read_text().startswith("timestamp_ns,Head_x,")
    # What is taken away at the beginning moves nothing.
    for stamp in stamps[:2]:
        (tmp_path / "rec" / "cam0" / f"{stamp}.png").unlink()
    recording = Recording(tmp_path / "rec")
    assert first_joints(recording) == [2, 3]
    assert [stamp for stamp, _ in recording.truth_rows()] == stamps
    assert of_truth(recording) == []


def of_truth(recording: Recording) -> list[str]:
    return [problem for problem in recording.problems if "true joints" in problem]


def with_seconds(folder: Path, times_s: list[float] | list[str]) -> Recording:
    """The recording with a truth.csv as earlier versions and other programs write it: of times in seconds."""
    columns = [f"{joint}_{axis}" for joint in JOINTS for axis in "xyz"]
    rows = [",".join(["time_s", *columns]), *(",".join([f"{t}", *[str(i)] * 54]) for i, t in enumerate(times_s))]
    (folder / "truth.csv").write_text("\n".join(rows))
    return Recording(folder)


def test_truth_in_seconds_is_of_the_frames_clock_or_from_the_first_frame(tmp_path: Path) -> None:
    stamps = regular(4, EPOCH)
    write(tmp_path / "rec", {"cam0": stamps})
    period_s = PERIOD / 1e9
    on_clock = with_seconds(tmp_path / "rec", [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in stamps[1:3]])
    assert first_joints(on_clock) == [None, 0, 1, None]
    from_first = with_seconds(tmp_path / "rec", [0.0, period_s])
    assert first_joints(from_first) == [0, 1, None, None]
    # So they are wherever they are read: convert and replay take them as rows.
    assert [stamp for stamp, _ in from_first.truth_rows()] == stamps[:2]
    assert of_truth(on_clock) == of_truth(from_first) == []
    (tmp_path / "rec" / "cam0" / f"{stamps[0]}.png").unlink()
    (problem,) = of_truth(with_seconds(tmp_path / "rec", [i * period_s for i in range(4)]))
    assert "go on for longer than the frames" in problem and "timestamp_ns" in problem


def test_truth_in_seconds_that_could_be_both_is_told(tmp_path: Path) -> None:
    write(tmp_path / "rec", {"cam0": [2 * PERIOD + stamp for stamp in regular(4)]})
    recording = with_seconds(tmp_path / "rec", [i * PERIOD / 1e9 for i in range(4)])
    assert first_joints(recording) == [2, 3, None, None]
    assert ["could count from the first frame" in problem for problem in of_truth(recording)] == [True]


def test_bad_truth(folder: Path) -> None:
    path = folder / "truth.csv"
    path.write_text("time_s,Head_x,Head_y\n0,1,2\n")
    with pytest.raises(InputError, match=r"truth\.csv lacks the columns"):
        Recording(folder)
    write(folder.parent / "other", {"cam0": [90 * 10**9]}, {90 * 10**9: np.zeros((18, 3))})
    shutil.copy(folder.parent / "other" / "truth.csv", path)
    assert "are none of the frames'" in Recording(folder).problems[0]


def test_writer_refuses_what_does_not_fit(tmp_path: Path) -> None:
    rig = make_rig()
    with RecordingWriter(tmp_path / "rec", rig) as writer:
        with pytest.raises(InputError, match="no camera 'cam9'"):
            writer.write(0, {"cam9": make_frame(rig["cam0"])})
        with pytest.raises(InputError, match="24 rows and 32 columns"):
            writer.write(0, {"cam0": make_frame(rig["cam1"])})
        with pytest.raises(InputError, match="negative"):
            writer.write(-1, {})
    with pytest.raises(InputError, match="exists already"):
        RecordingWriter(tmp_path / "rec", rig)
