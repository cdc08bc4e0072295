"""Depth sensors by name: size, field of view and what each makes of an exact picture. See ``docs/guides/sensors.md``.

Sources of the numbers:

* Kinect 1 and Xtion: Khoshelham and Elberink, "Accuracy and Resolution of Kinect Depth Data for Indoor Mapping
  Applications" (Sensors, 2012): steps of an eighth of a pixel of disparity, errors that grow with z²; Nguyen, Izadi
  and Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking" (3DIMPVT, 2012): axial
  deviation 1.2 mm + 1.9 mm (z - 0.4)², here multiplied out, and lateral deviation 0.8 px.
* Kinect 2: Fankhauser et al., "Kinect v2 for Mobile Robot Navigation: Evaluation and Modeling" (ICAR, 2015): axial
  deviation (1.5 - 0.5 z + 0.3 z²) mm, more at grazing angles.
* Azure Kinect and Femto Bolt (the same time-of-flight camera): ranges and resolutions of Microsoft's and Orbbec's
  hardware specifications; a random error of at most 17 mm is specified, and ours is of the usual order instead.
* RealSense: Intel's "Best-Known-Methods for Tuning Intel RealSense D400 Depth Cameras": deviation is
  z² · subpixel / (focal length · baseline), subpixel about 0.05 for well textured targets; fields of view, baselines
  and ranges of the data sheets.

What these leave open (reflectances, lost and flying pixels, patches, waves, multipath) is our choice, made by comparing
statistics with pictures of a Kinect 1, a Kinect 2, an Xtion and a D415 (``depthmocap.evaluate.depth_statistics``).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.synth.sensing.sensor import SensorModel


@dataclasses.dataclass(frozen=True)
class SensorPreset:
    """A depth camera that can be bought: intrinsics in pixels without distortion, and its errors."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: SensorModel
    depth_unit_m: float = 0.001

    @property
    def range_m(self) -> tuple[float, float]:
        """Nearest and farthest reading."""
        return self.model.range_m

    def camera(self, name: str, world_from_camera: Float[ndarray, "4 4"]) -> DepthCamera:
        """Such a camera in a place."""
        return DepthCamera(
            name,
            self.width,
            self.height,
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            world_from_camera,
            depth_unit_m=self.depth_unit_m,
        )


#: Near infrared reflectance relative to fair skin and cloth, in the order of ``Material``; nothing stands for unknown.
_TOF_REFLECTANCE = (1.0, 1.0, 1.0, 0.15, 0.06, 0.3, 1.0, 0.7, 1.0)
_PATTERN_REFLECTANCE = (1.0, 1.0, 1.0, 0.3, 0.2, 0.5, 1.0, 0.7, 1.0)
#: Stereo finds little to match on plain walls.
_STEREO_REFLECTANCE = (1.0, 1.0, 1.0, 0.6, 0.35, 0.6, 0.5, 0.6, 1.0)

_KINECT2 = SensorModel(
    range_m=(0.5, 8.0),
    axial_m=(0.0015, -0.0005, 0.0003),
    grazing=0.2,
    lateral_px=0.3,
    lost_px=(1.35, 1.35),
    flying=0.04,
    multipath_m=0.03,
    reach_m=11.5,
    reflectance=_TOF_REFLECTANCE,
    hole_spread=0.35,
    hole_px=3.0,
    vignette=0.93,
    shadow_m=-0.01,
    step_m=0.001,
)
_AZURE = dataclasses.replace(
    _KINECT2,
    range_m=(0.5, 3.86),
    axial_m=(0.0006, 0.0, 0.00015),
    lost_px=(1.2, 1.2),
    flying=0.04,
    reach_m=10.0,
    vignette=0.8,
    shadow_m=0.0,
)
_KINECT1 = SensorModel(
    range_m=(0.5, 8.0),
    axial_m=(0.0015, -0.00152, 0.0019),
    correlation=0.95,
    patch_px=6.0,
    wave=0.5,
    wave_px=60.0,
    lateral_px=0.8,
    fatten_px=1.5,
    lost_px=(0.6, 0.0),
    reach_m=10.0,
    reflectance=_PATTERN_REFLECTANCE,
    hole_spread=0.5,
    hole_px=6.0,
    hole_dust=0.01,
    vignette=0.3,
    shadow_m=0.075,
    baseline_m=0.075,
    disparity_step_px=0.125,
    step_m=0.001,
)
_D435 = SensorModel(
    range_m=(0.2, 10.0),
    axial_m=(0.0, 0.0, 0.05 / (424 * 0.05)),
    correlation=0.98,
    patch_px=12.0,
    wave=0.5,
    wave_px=50.0,
    lateral_px=0.8,
    fatten_px=2.0,
    lost_px=(6.0, 0.0),
    reach_m=7.0,
    reflectance=_STEREO_REFLECTANCE,
    hole_spread=0.9,
    hole_px=12.0,
    hole_dust=0.0,
    vignette=0.3,
    shadow_m=0.05,
    baseline_m=0.05,
    disparity_step_px=1 / 32,
    step_m=0.001,
)
#: 8 bits over 50–800 cm, times the factor that the authors' toolkit reads them with.
_UBC3V = SensorModel(range_m=(0.515, 8.24), step_m=7.5 / 255 * 1.03, step_from_m=0.515)

_AZURE_WIDE = dataclasses.replace(_AZURE, range_m=(0.25, 2.21), reach_m=6.0)
_AZURE_BINNED = dataclasses.replace(_AZURE, range_m=(0.5, 5.46), reach_m=14.0)
_AZURE_WIDE_BINNED = dataclasses.replace(_AZURE, range_m=(0.25, 2.88), reach_m=8.0)


def _azure(width: int, height: int, focal: float, cx: float, cy: float, model: SensorModel) -> SensorPreset:
    return SensorPreset(width, height, focal, focal, cx, cy, model)


#: Focal lengths are those of usual calibrations: data sheets count the field of view with the lens's distortion.
_NFOV = _azure(640, 576, 504.5, 321.8, 332.0, _AZURE)
_NFOV_BINNED = _azure(320, 288, 252.25, 160.7, 165.8, _AZURE_BINNED)
_WFOV = _azure(1024, 1024, 504.5, 513.8, 516.0, _AZURE_WIDE)
_WFOV_BINNED = _azure(512, 512, 252.25, 256.7, 257.8, _AZURE_WIDE_BINNED)

SENSORS: dict[str, SensorPreset] = {
    "kinect1": SensorPreset(640, 480, 580.0, 580.0, 319.5, 239.5, _KINECT1),
    "kinect2": SensorPreset(512, 424, 366.7, 366.7, 261.3, 204.1, _KINECT2),
    # The ray table of datasets.ubc3v, as a pinhole.
    "ubc3v": SensorPreset(512, 424, 368.74, 367.93, 253.15, 205.13, _UBC3V),
    "azure-nfov": _NFOV,
    "azure-nfov-binned": _NFOV_BINNED,
    "azure-wfov": _WFOV,
    "azure-wfov-binned": _WFOV_BINNED,
    "femto-bolt-nfov": _NFOV,
    "femto-bolt-nfov-binned": _NFOV_BINNED,
    "femto-bolt-wfov": _WFOV,
    "femto-bolt-wfov-binned": _WFOV_BINNED,
    "realsense-d435": SensorPreset(848, 480, 424.0, 424.0, 423.5, 239.5, _D435),
    "realsense-d455": SensorPreset(
        848,
        480,
        424.0,
        424.0,
        423.5,
        239.5,
        dataclasses.replace(
            _D435, range_m=(0.4, 12.0), axial_m=(0.0, 0.0, 0.05 / (424 * 0.095)), shadow_m=0.095, baseline_m=0.095
        ),
    ),
    # An Xtion Pro at 320×240: the disparity is still counted at 640×480; shadows and lost pixels are filled in.
    "itop": SensorPreset(
        320,
        240,
        1 / 0.0035,
        1 / 0.0035,
        160.0,
        120.0,
        dataclasses.replace(
            _KINECT1,
            patch_px=4.0,
            wave_px=30.0,
            lateral_px=0.5,
            fatten_px=0.8,
            lost_px=(0.0, 0.0),
            reach_m=14.0,
            shadow_m=0.0,
            disparity_step_px=0.0625,
        ),
    ),
}

#: Never drawn for training, so that it shows how well what was learnt carries over to a sensor never seen.
HELD_OUT_SENSOR = "kinect1"
#: All others; those sold under two names once.
TRAINED_SENSORS = tuple(dict.fromkeys(preset for name, preset in SENSORS.items() if name != HELD_OUT_SENSOR))


def find_sensor(name: str) -> SensorPreset:
    """A preset by its name.

    Raises:
        InputError: when there is none of that name.
    """
    if name not in SENSORS:
        raise InputError(f"no sensor {name!r}: expected one of {', '.join(SENSORS)}")
    return SENSORS[name]


def random_preset(rng: np.random.Generator, held_out: bool = False) -> SensorPreset:
    """One of the sensors but the held-out one, each as likely, sensors under two names counted once; with ``held_out``
    that one. Place the camera so that the person is within its range: that of some modes ends at 2.2 m."""
    if held_out:
        return SENSORS[HELD_OUT_SENSOR]
    return TRAINED_SENSORS[int(rng.integers(len(TRAINED_SENSORS)))]


def random_model(rng: np.random.Generator, preset: SensorPreset) -> SensorModel:
    """Errors around a preset's, from a third to three times as strong, for training (domain randomisation).

    Every term is drawn by itself. A sensor without errors, as UBC3V's, is left as it is half of the time and else
    gets the errors of a Kinect 2. Pictures are at times mirrored (the projector is on the other side), interpolated at
    silhouettes, or counted in coarser steps, as processing and files of others do.
    """
    model = preset.model
    if model.axial_m == (0.0, 0.0, 0.0):
        if rng.random() < 0.5:
            return model
        model = dataclasses.replace(_KINECT2, range_m=model.range_m, step_m=model.step_m, step_from_m=model.step_from_m)

    def times(limit: float) -> float:
        return float(np.exp(rng.uniform(-np.log(limit), np.log(limit))))

    strength = times(3.0)
    reflectance = np.array(model.reflectance) * np.exp(rng.normal(0, 0.5, len(model.reflectance)))
    # Not all drivers remove the pixels that float at silhouettes.
    raw = model.flying > 0 and rng.random() < 0.3
    flying = rng.uniform(0.1, 0.5) if raw else model.flying * times(3.0)
    lost = tuple(value * times(2.0) * (0.4 if raw else 1.0) for value in model.lost_px)
    return dataclasses.replace(
        model,
        axial_m=tuple(strength * value for value in model.axial_m),
        grazing=model.grazing * times(2.0),
        wave=model.wave * times(2.0),
        patch_px=max(model.patch_px * times(1.5), 1.0),
        lateral_px=model.lateral_px * times(2.0),
        fatten_px=model.fatten_px * times(2.0),
        lost_px=lost,
        flying=float(flying),
        behind_m=float(rng.uniform(0.1, 1.5)),
        blend=float(rng.uniform(0.2, 0.7)) if rng.random() < 0.2 else 0.0,
        multipath_m=model.multipath_m * times(3.0),
        reach_m=model.reach_m * times(1.6),
        reflectance=tuple(float(value) for value in reflectance),
        hole_spread=model.hole_spread * times(1.5),
        hole_px=max(model.hole_px * times(2.0), 1.0),
        vignette=float(model.vignette * rng.uniform(0, 1)),
        shadow_m=model.shadow_m * (1.0 if rng.random() < 0.7 else -1.0),
        step_m=model.step_m if model.step_m > 0.002 or rng.random() < 0.7 else float(rng.choice([0.005, 0.01, 0.03])),
    )
