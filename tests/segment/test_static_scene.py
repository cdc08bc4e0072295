import numpy as np
import pytest
from depth_scene import make_camera, render, sense

from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import Rig
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.segment.static_scene import PersonSegmenter

PATH = [(np.sin(i / 2.1), 0.6 * np.sin(i / 1.3)) for i in range(20)]


class Frames(FrameSource):
    """A plain frame source, without background frames."""

    def __init__(self, views: list[View]) -> None:
        self.views = views

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> FrameSet:
        return FrameSet(index, (self.views[index],))


def overlap(found: np.ndarray, true: np.ndarray) -> float:
    return (found & true).sum() / (found | true).sum()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def walk(rng: np.random.Generator) -> tuple[Frames, list[np.ndarray]]:
    camera = make_camera()
    exact = [render(camera, [xy]) for xy in PATH]
    views = [View(camera, sense(depth_m, rng)) for depth_m, _ in exact]
    masks = [mask & (view.depth_m > 0) for view, (_, mask) in zip(views, exact, strict=True)]
    return Frames(views), masks


@pytest.mark.parametrize("noise", [1.0, 2.5])
def test_person_before_a_background_frame(rng: np.random.Generator, noise: float) -> None:
    for camera in (make_camera(), make_camera("wide", 320, 240, x=0.8)):
        background_m, _ = render(camera, [])
        segment = PersonSegmenter({camera.name: sense(background_m, rng, noise)})
        for xy in [(0.0, 0.0), (0.4, -1.2), (-0.8, 0.9)]:
            depth_m, mask = render(camera, [xy])
            view = View(camera, sense(depth_m, rng, noise))
            assert overlap(segment(view), mask & (view.depth_m > 0)) > 0.9
        for _ in range(5):
            assert not segment(View(camera, sense(background_m, rng, noise))).any()


def test_background_learnt_from_the_recording(walk: tuple[Frames, list[np.ndarray]], rng: np.random.Generator) -> None:
    frames, masks = walk
    segment = PersonSegmenter.from_recording(frames)
    assert segment.problems == []
    assert min(overlap(segment(view), mask) for view, mask in zip(frames.views, masks, strict=True)) > 0.9
    camera = make_camera()
    assert not segment(View(camera, sense(render(camera, [])[0], rng))).any()


def test_feet_are_kept(rng: np.random.Generator) -> None:
    camera = make_camera(width=512, height=424)
    depth_m, mask = render(camera, [(0.0, 0.0)])
    depth_m = sense(depth_m, rng)
    found = PersonSegmenter({"cam0": render(camera, [])[0]})(View(camera, depth_m))
    points = camera.unproject(depth_m, mask) @ camera.world_from_camera[:3, :3].T + camera.world_from_camera[:3, 3]
    feet = points[:, 2] < 0.1
    assert found[mask & (depth_m > 0)][feet].mean() > 0.6


def test_parts_cut_off_by_an_occluder_are_kept(rng: np.random.Generator) -> None:
    camera = make_camera()
    background_m, _ = render(camera, [], hidden_below_m=0.75)
    segment = PersonSegmenter({"cam0": background_m})
    depth_m, mask = render(camera, [(0.1, 0.0)], hidden_below_m=0.75)
    view = View(camera, sense(depth_m, rng))
    found = segment(view)
    assert overlap(found, mask & (view.depth_m > 0)) > 0.9
    arm = mask & (np.arange(camera.width) > 140) & (view.depth_m > 0)  # touches nothing in the picture
    assert arm.sum() > 50
    assert found[arm].mean() > 0.8


def test_someone_apart_and_small_things_are_left_out(rng: np.random.Generator) -> None:
    camera = make_camera()
    segment = PersonSegmenter({"cam0": render(camera, [])[0]})
    _, front = render(camera, [(-0.7, -0.5)])
    depth_m, both = render(camera, [(-0.7, -0.5), (3.4, 2.0)])  # the other is half out of the picture
    view = View(camera, sense(depth_m, rng))
    assert (both & ~front).sum() > 300
    assert overlap(segment(view), front & (view.depth_m > 0)) > 0.9
    ball = render(camera, [])[0]
    ball[40:52, 40:52] = 2.0  # 0.02 m²
    assert not segment(View(camera, ball)).any()


def test_open_space_has_no_background(rng: np.random.Generator) -> None:
    """Where the room is out of range, whatever returns light is foreground."""
    camera = make_camera()
    background_m, _ = render(camera, [])
    far = (camera.rays[..., 1] < 0.1) & (background_m > 3.5)

    def look(xy: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        depth_m, mask = render(camera, [xy])
        return sense(np.where(far & ~mask, 0, depth_m).astype(np.float32), rng), mask

    segment = PersonSegmenter.from_recording(Frames([View(camera, look(xy)[0]) for xy in PATH]))
    depth_m, mask = look((0.2, 0.1))
    assert overlap(segment(View(camera, depth_m)), mask & (depth_m > 0)) > 0.9


def test_a_room_of_unknown_depth_is_not_a_person() -> None:
    camera = make_camera()
    depth_m, _ = render(camera, [])
    assert PersonSegmenter({"cam0": np.zeros_like(depth_m)})(View(camera, depth_m)).mean() < 0.02


@pytest.mark.parametrize("people", [[], [(0.0, 0.0)]])
def test_a_still_scene_is_reported(rng: np.random.Generator, people: list[tuple[float, float]]) -> None:
    camera = make_camera()
    depth_m, _ = render(camera, people)
    frames = Frames([View(camera, sense(depth_m, rng)) for _ in range(8)])
    segment = PersonSegmenter.from_recording(frames)
    assert "background.png" in segment.problems[0] and "--segment auto" in segment.problems[0]
    assert not segment(frames.views[0]).any()


def test_three_still_cameras_are_reported_in_one_line(rng: np.random.Generator) -> None:
    views = [View(make_camera(name), render(make_camera(name), [])[0]) for name in "abc"]
    sets = [FrameSet(i, tuple(views)) for i in range(3)]

    class Source(FrameSource):
        camera_names = tuple(view.camera.name for view in views)

        def __len__(self) -> int:
            return len(sets)

        def __getitem__(self, index: int) -> FrameSet:
            return sets[index]

    (problem,) = PersonSegmenter.from_recording(Source()).problems
    assert problem.startswith("cameras 'a', 'b' and 'c': a whole person is found in at most 0% of the sampled frames")


def test_true_masks_and_mode_none(walk: tuple[Frames, list[np.ndarray]]) -> None:
    view = walk[0].views[0]
    masked = View(view.camera, view.depth_m, mask=walk[1][0])
    segment = PersonSegmenter.from_recording(Frames([masked] * 3))
    assert segment(masked) is masked.mask
    assert not segment(view).any()  # nothing is known of this camera
    segment = PersonSegmenter.from_recording(walk[0], "none")
    np.testing.assert_array_equal(segment(view), view.depth_m > 0)
    with pytest.raises(InputError, match="background"):
        PersonSegmenter({"cam0": np.ones((4, 4))})(view)


def test_background_frames_of_a_recording_are_used(tmp_path, rng: np.random.Generator) -> None:
    rig = Rig((make_camera("a"), make_camera("b", 128, 106, x=1.0)))
    background_m = {camera.name: render(camera, [])[0] for camera in rig.cameras}
    exact = {camera.name: render(camera, [(0.0, 0.0)]) for camera in rig.cameras}
    with RecordingWriter(tmp_path / "rec", rig, {"a": np.round(background_m["a"] * 1000).astype(np.uint16)}) as writer:
        for i in range(3):
            raw = {name: np.round(sense(d, rng) * 1000).astype(np.uint16) for name, (d, _) in exact.items()}
            writer.write(i * 33_000_000, raw)
    recording = Recording(tmp_path / "rec")
    segment = PersonSegmenter.from_recording(recording)
    assert [problem[:10] for problem in segment.problems] == ["camera 'b'"]  # still, and no background frame
    a, b = recording[1].views
    assert overlap(segment(a), exact["a"][1] & (a.depth_m > 0)) > 0.9
    assert not segment(b).any()
