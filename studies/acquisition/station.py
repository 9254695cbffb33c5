"""One tissue on the bench: the stage moves and settles, the scope and then the reference camera take their pictures."""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.assets.shafts import INSTRUMENT
from laploop.envs.sensors.optics.presets import randomised_surfaces
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.reference.camera import ReferenceCamera
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.perception.data.calibrated_pair_store import reproject_by
from laploop.perception.data.pair_store import PairFrame, PairStore
from laploop.perception.geometry import invert_transform, transform_points
from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.stage_pose import StagePose, draw_stage_pose, home_pose
from laploop.studies.scenes.frame_conditions import CameraPose, FrameRanges, draw_tool
from laploop.studies.scenes.moving_bench import REFERENCE_SEES, SCOPE_SEES, BenchScene
from laploop.studies.scenes.optical_bench import OpticalBench

Array = NDArray[np.float64]

_PRESS_TRAVEL_M = 0.006
_DEPTH_MARGIN_M = (0.020, 0.020)
"""How far the scene reaches in front of and behind the tissue's mean height: its lobes, and the stage beside it."""
_REGION_STEP = 8
_BRIGHTEST = 0.995
"""Fraction of the pixels kept below the level that the exposure aims at."""


def collect_tissue(config: AcquisitionConfig, path: Path, tissue: int, written: Callable[[], None] | None = None) -> int:
    """Take the missing pairs of one tissue and write them into the store at `path`; return their number."""
    store = PairStore.open(path, writable=True)
    done = store.done()
    todo = [int(index) for index in np.flatnonzero(config.tissue_of_pair == tissue) if not done[index]]
    if todo:
        station = AcquisitionStation(config, tissue)
        for index in todo:
            frame, metadata = station.take(index, store)
            store.write(index, frame, metadata)
            if written is not None:
                written()
    return len(todo)


class AcquisitionStation:
    """The bench with one tissue on its stage."""

    def __init__(self, config: AcquisitionConfig, tissue: int) -> None:
        """Grow the tissue, let it come to rest on the stage, and set up both cameras."""
        bench = config.bench
        rng = config.tissue_rng(tissue)
        self._config, self._tissue, self._bench = config, tissue, bench
        self._members = np.flatnonzero(config.tissue_of_pair == tissue)
        self._world_from_scope, self._world_from_reference = bench.world_from_scope, bench.world_from_reference
        self._scene = _grow(config, rng)
        optics = randomised_surfaces(bench.optics, rng, config.optics)
        level = float(rng.uniform(*config.exposure_level))
        texture_seed = int(rng.integers(2**32))
        self._scope = bench.scope_camera(threads=1)
        self._scope.set_optics(optics)
        appearance = config.tissue.appearance
        texture_rng = np.random.default_rng(texture_seed)
        model, surface = self._scene.model, self._scene.tissue
        self._scope.attach(model, tissue=surface, groups=SCOPE_SEES, rng=texture_rng, appearance=appearance)
        self._optics = self._expose(optics, level)
        self._reference = ReferenceCamera(reference_optics(config, self._optics), threads=1)
        # The same seed: both cameras look at the same texture.
        texture_rng = np.random.default_rng(texture_seed)
        self._reference.attach(model, tissue=surface, groups=REFERENCE_SEES, rng=texture_rng, appearance=appearance)

    def take(self, index: int, store: PairStore) -> tuple[PairFrame, dict[str, Any]]:
        """Move, settle, and take pair `index` of this tissue; the store's calibration reprojects the reference depth.

        Returns:
            The arrays, and the metadata: commanded and reached pose of the stage, times, optics, seeds.

        Raises:
            SimulationError: If the tissue does not settle.
        """
        config, scene = self._config, self._scene
        rng = config.pair_rng(index)
        with_tool = bool(rng.random() < config.tool_share)
        place = int(np.searchsorted(self._members, index))
        commanded = draw_stage_pose(
            config.stage,
            part=(place / len(self._members), (place + 1) / len(self._members)),
            nominal_distance_m=self._bench.nominal_distance_m,
            height_m=scene.mean_height_m,
            rng=rng,
        )
        reached = _reached(config, commanded.world_from_stage, rng)
        move_s = scene.move_stage(reached)
        settle_s, speed_m_s = scene.settle()
        tool = self._bring_tool(commanded.working_distance_m, rng) if with_tool else None
        scope = self._scope.capture(scene.data, self._world_from_scope, rng)
        reference = self._reference.capture(scene.data, self._world_from_reference, rng)
        frame = PairFrame(
            image=scope.image,
            reference_depth_mm=reproject_by(store.calibration, reference.xyz).depth_mm,
            depth_mm=scope.depth_mm,
            lit=scope.lit,
            shadow=shadow_mask(scope, self._bench),
            projector_x=scope.projector_x,
            projector_y=scope.projector_y,
            reference_z_mm=reference.z,
            reference_rgba=reference.rgba,
        )
        metadata = {
            "index": index,
            "tissue": self._tissue,
            "place": place,
            "seeds": {"tissue": config.tissue_seed(self._tissue), "pair": config.pair_seed(index)},
            "commanded": _as_dict(commanded),
            "reached": {"world_from_stage": reached.tolist()},
            "move_s": move_s,
            "settle_s": settle_s,
            "surface_speed_mm_s": 1e3 * speed_m_s,
            "tool": tool,
            "optics": asdict(self._optics),
            "reference": {"unit_seed": self._reference.optics.unit_seed, "region": list(self._reference.optics.window)},
            "calibration_error_px": store.calibration.error_px,
        }
        return frame, metadata

    def _expose(self, optics: StripeOptics, level: float) -> StripeOptics:
        """Set the light so that the tissue at home reaches a level, a fraction of full scale, and keep it."""
        view = self._scope.capture(self._scene.data, self._world_from_scope, None)
        brightest = float(np.quantile(view.electrons, _BRIGHTEST))
        exposed = replace(optics, led_power_w=optics.led_power_w * level * optics.full_well_electrons / brightest)
        self._scope.set_optics(exposed)
        return exposed

    def _bring_tool(self, working_distance_m: float, rng: np.random.Generator) -> dict[str, Any]:
        """Put the instrument into the view and return where it is."""
        scene = self._scene
        pose = CameraPose(working_distance_m=working_distance_m, world_from_camera=self._world_from_scope)
        tool = draw_tool(FrameRanges(), pose, scene.top_points(), tip_radius_m=INSTRUMENT.tip_radius_m, rng=rng)
        if tool.presses:
            scene.press_tool(tool.tip, tool.axis, travel_m=_PRESS_TRAVEL_M)
        else:
            scene.place_tool(tool.tip, tool.axis)
        return {"tip": tool.tip.tolist(), "axis": tool.axis.tolist(), "presses": tool.presses}


def reference_optics(config: AcquisitionConfig, optics: StripeOptics | None = None) -> ReferenceOptics:
    """Return the reference camera with its region of interest, looking at the surfaces of the scope's optics."""
    reference = config.bench.reference
    if optics is not None:
        reference = replace(reference, tissue=optics.tissue, tool=optics.tool, stage=optics.stage, other=optics.other)
    if reference.region is not None:
        return reference
    return replace(reference, region=_region(config, reference))


def shadow_mask(view: StripeCapture, bench: OpticalBench) -> NDArray[np.bool_]:
    """Return where a surface lies inside the mask's field but is hidden from the projector, (height, width)."""
    half = bench.scope.mask.half_width_tan
    # Comparisons with NaN are false: where nothing was hit there is no shadow.
    return (np.abs(view.projector_x) <= half) & (np.abs(view.projector_y) <= half) & ~view.lit


def _region(config: AcquisitionConfig, reference: ReferenceOptics) -> tuple[int, int, int, int]:
    """Return the part of the reference camera's image that covers the scope's view within the working range."""
    bench = config.bench
    low, high = config.stage.working_distance_m
    depths = (low - _DEPTH_MARGIN_M[0], high + _DEPTH_MARGIN_M[1])
    camera = bench.rig.camera
    corners = np.array([[u, v] for u in (0.0, camera.width) for v in (0.0, camera.height)])
    in_scope: NDArray[np.float64] = np.concatenate([camera.unproject(corners, depth) for depth in depths])
    reference_from_scope = invert_transform(bench.scope_from_reference)
    whole = replace(reference, region=None).intrinsics
    pixels = whole.project(transform_points(reference_from_scope, in_scope))
    first = np.maximum(np.floor(pixels.min(axis=0) / _REGION_STEP) * _REGION_STEP, 0.0)
    last = np.minimum(np.ceil(pixels.max(axis=0) / _REGION_STEP) * _REGION_STEP, [whole.width, whole.height])
    column, row, width, height = (int(value) for value in (*first, *(last - first)))
    return column, row, width, height


def _grow(config: AcquisitionConfig, rng: np.random.Generator) -> BenchScene:
    bench = config.bench
    return BenchScene(
        config.tissue,
        rng,
        world_from_scope=bench.world_from_scope,
        scope=bench.scope,
        home=lambda height_m: home_pose(config.stage, nominal_distance_m=bench.nominal_distance_m, height_m=height_m),
    )


def _reached(config: AcquisitionConfig, commanded: Array, rng: np.random.Generator) -> Array:
    """Return the pose that the stage reaches."""
    ranges = config.stage
    reached = commanded.copy()
    reached[:3, 3] += ranges.repeatability_m * rng.standard_normal(3)
    reached[:3, :3] = Rotation.from_rotvec(ranges.repeatability_rad * rng.standard_normal(3)).as_matrix() @ commanded[:3, :3]
    return reached


def _as_dict(pose: StagePose) -> dict[str, Any]:
    return {
        "working_distance_mm": 1e3 * pose.working_distance_m,
        "shift_mm": [1e3 * value for value in pose.shift_m],
        "yaw_deg": math.degrees(pose.yaw_rad),
        "tilt_deg": math.degrees(pose.tilt_rad),
        "tilt_direction_deg": math.degrees(pose.tilt_direction_rad),
        "world_from_stage": pose.world_from_stage.tolist(),
    }
