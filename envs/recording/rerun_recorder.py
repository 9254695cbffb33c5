"""An episode as a Rerun file with its layout."""

import errno
import warnings
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from laploop.envs.recording.picture_colors import ColorScale, key_picture
from laploop.envs.recording.recorder import DepthRecord, FrameRecord, PredictionRecord, Recorder, TickRecord
from laploop.envs.recording.rerun_blueprint import episode_blueprint, legend
from laploop.envs.recording.rerun_detail import DetailName, detail_named
from laploop.envs.recording.rerun_plots import TIMELINE, TickPlots, times
from laploop.envs.recording.rerun_scene import DrawnBody, TissueShape, body_quaternions, drawn_bodies, log_shapes
from laploop.errors import OutputError
from laploop.perception.geometry import Rig, transform_points

if TYPE_CHECKING:
    from laploop.envs.theatre.arm import Arm
    from laploop.envs.theatre.theatre import Theatre

FRAME_TIMELINE = "frame"

DEPTH_UNITS_PER_M = 100_000.0
"""Depth maps are stored as 16-bit integers of 0.01 mm, up to 655 mm; 0 means no depth."""

_FLUSH_TICKS = 125
"""Ticks and poses are sent in batches of about a second: each call to Rerun is expensive."""

_LIVE_FLUSH_TICKS = 12
"""Of about a tenth of a second where somebody looks on."""

_BATCH_S, _LIVE_BATCH_S = 5.0, 0.1

_TISSUE_COLOR = (222, 146, 132)
_TROCAR_COLOR = (245, 215, 66)
_TROCAR_RADIUS_M = 0.011
"""A little more than that of the modelled rings."""


class RerunRecorder(Recorder):
    """Writes a Rerun recording (`.rrd`) with its blueprint.

    Everything goes to a hidden file beside `path`, which gets its name when the recorder is closed: `path` never holds half
    a recording. As a context manager it closes at the end of the block, also when the block raises: what was recorded until
    then is kept, and a note on the error says so.
    Nothing opens a window; a socket is opened only to a live viewer.

    Entities: `world/...` in metres (arms, instrument, stage, wall, `trocars`, `tissue`, `surface`: the reconstruction
    coloured by its error, `camera`, `target`, `goal`, `prediction`), `scope/image/{stripes,depth,truth,error}` and their keys,
    `plots/...`, `states/...`; with full detail, depth and truth as numbers in `scope/depth/{estimate,truth}`. Timelines:
    `sim_time`, and `frame`, the index of the camera frame that something belongs to.
    """

    def __init__(self, path: Path | str, *, detail: DetailName = "default", live: str | None = None) -> None:
        """Open the hidden file.

        Args:
            path: Path of the recording, in an existing folder.
            detail: How much to keep; a second of recording takes 2 MB at most by default, about 7 MB in full.
            live: Address of a viewer, `rerun+http://HOST:PORT/proxy`, that gets everything as well, at once.

        Raises:
            UnknownNameError: If there is no such detail.
            OutputError: If the folder cannot be written.
        """
        self._detail = detail_named(detail)
        self._live = live
        self.path = Path(path)
        self._partial = self.path.with_name(f".{self.path.name}.partial")
        try:
            self._partial.touch()
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}") from error
        # A chunk brings some kilobytes of its own, and where the loop is slow a picture a chunk would be written.
        batches = rr.ChunkBatcherConfig(flush_tick=_BATCH_S if live is None else _LIVE_BATCH_S)
        self._stream = rr.RecordingStream("laploop", batcher_config=batches)
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        self._theatre: Theatre | None = None
        self._plots: TickPlots | None = None
        self._tissue: TissueShape | None = None
        self._bodies: tuple[DrawnBody, ...] = ()
        self._body_ids = np.empty(0, dtype=np.intp)
        self._ticks: list[TickRecord] = []
        self._predictions: list[PredictionRecord] = []
        self._pose_times: list[int] = []
        self._poses: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []
        self._depth_scale: ColorScale | None = None
        self._error_scale = ColorScale.of_errors()
        self._pinhole: rr.Pinhole | None = None
        self._rays_in_camera = np.empty((0, 0, 3))
        self._map_stride = self._point_stride = slice(None)
        self._last_ns: dict[str, int] = {}
        self._closed = self._kept = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        """Close the recording; the note on an error that ends the block says where it is."""
        self.close()
        if error is not None and self._kept:
            error.add_note(f"the recording up to then is kept in {self.path}")

    def begin(self, theatre: "Theatre", rig: Rig) -> None:
        """Log everything that does not change, the blueprint, and where everything is at time 0."""
        stream, side = self._stream, max(rig.camera.width, rig.camera.height)
        self._map_stride = slice(None, None, -(-side // self._detail.map_pixels))
        self._point_stride = slice(None, None, -(-side // self._detail.surface_points))
        self._rays_in_camera = rig.camera.rays[self._point_stride, self._point_stride].copy()
        points = theatre.tissue.surface_points()
        blueprint = episode_blueprint(points.mean(axis=0), depth_maps=self._detail.depth_maps)
        viewers = [] if self._live is None else [rr.GrpcSink(self._live)]
        stream.set_sinks(rr.FileSink(str(self._partial)), *viewers, default_blueprint=blueprint)
        self._theatre = theatre

        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("legend", rr.TextDocument(legend(rig), media_type=rr.MediaType.MARKDOWN), static=True)
        self._plots = TickPlots(stream)
        self._log_bodies(theatre)
        for arm in (theatre.camera_arm, theatre.tool_arm):
            self._log_trocar(arm)
        triangles = theatre.tissue.triangles
        self._tissue = TissueShape(triangles, points, tolerance_m=self._detail.tissue_tolerance_m)
        tissue = rr.Mesh3D.from_fields(triangle_indices=triangles.astype(np.uint32), albedo_factor=_TISSUE_COLOR)
        stream.log("world/tissue", tissue, static=True)
        self._pinhole = rr.Pinhole(
            resolution=[rig.camera.width, rig.camera.height],
            focal_length=[rig.camera.fx, rig.camera.fy],
            principal_point=[rig.camera.cx, rig.camera.cy],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.03,
        )
        self._log_key("error", self._error_scale)

    def tick(self, record: TickRecord) -> None:
        """Keep a control tick until the next batch."""
        self._begun()
        self._ticks.append(record)
        if len(self._ticks) >= (_FLUSH_TICKS if self._live is None else _LIVE_FLUSH_TICKS):
            self._send_batch()

    def prediction(self, record: PredictionRecord) -> None:
        """Keep a prediction until the next batch."""
        self._begun()
        self._predictions.append(record)

    def frame(self, record: FrameRecord) -> None:
        """Log the image and the state of the world at its capture."""
        theatre = self._begun()
        self._scale(record.exact_depth_mm)
        if not self._due("frame", record.now_ns):
            return
        self._at(record.now_ns, record.frame.index)
        stream = self._stream
        stream.log("scope/image/stripes", self._encoded_stripes(record.frame.image))
        world_from_camera = record.frame.world_from_camera
        stream.log("world/camera", rr.Transform3D(translation=world_from_camera[:3, 3], mat3x3=world_from_camera[:3, :3]))
        if self._pinhole is not None:
            stream.log("world/camera", self._pinhole)
            self._pinhole = None
        self._pose_times.append(record.now_ns)
        self._poses.append(self._pose(theatre))

    def depth(self, record: DepthRecord) -> None:
        """Log a depth frame, its truth, its error, and the surface reconstructed from it."""
        self._begun()
        depths, estimate = self._scale(record.exact_depth_mm), record.depth.estimate
        if not self._due("depth", record.now_ns):
            return
        self._at(record.now_ns, record.depth.index)
        error, kept = record.error_mm(), (self._map_stride, self._map_stride)
        depth_mm = np.where(estimate.valid, estimate.depth_mm, np.float32(np.nan))
        pictures = {"depth": (depths, depth_mm), "truth": (depths, record.exact_depth_mm), "error": (self._error_scale, error)}
        for name, (scale, values) in pictures.items():
            self._stream.log(f"scope/image/{name}", rr.EncodedImage(contents=scale.png(values[kept]), media_type="image/png"))
        if self._detail.depth_maps:
            self._log_depth("scope/depth/estimate", depth_mm)
            self._log_depth("scope/depth/truth", record.exact_depth_mm)
        self._log_surface(record, error)

    def close(self) -> None:
        """Send what is left and give the recording its name; a recorder that never began leaves nothing.

        Raises:
            OutputError: If the recording did not get to the disk as a whole.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._theatre is not None:
                self._send_batch()
            self._stream.disconnect()
            if self._theatre is not None:
                _verify(self._partial)
                self._partial.replace(self.path)
                self._kept = True
        except (OSError, RuntimeError, Warning) as error:
            fault = OSError(errno.EIO, str(error))
            raise OutputError(f"cannot write {self.path}: the recording broke off; is the disk full?") from fault
        finally:
            self._partial.unlink(missing_ok=True)

    def _begun(self) -> "Theatre":
        if self._theatre is None:
            raise RuntimeError("begin() comes before any record")
        return self._theatre

    def _due(self, kind: str, now_ns: int) -> bool:
        """Return whether it is time for the next picture of a kind."""
        due = kind not in self._last_ns or now_ns - self._last_ns[kind] >= self._detail.period_ns
        if due:
            self._last_ns[kind] = now_ns
        return due

    def _scale(self, exact_depth_mm: NDArray[np.float32]) -> ColorScale:
        """Return the colours of depths, which the first frame decides."""
        if self._depth_scale is None:
            self._depth_scale = ColorScale.of_depths(exact_depth_mm)
            self._log_key("depth", self._depth_scale)
        return self._depth_scale

    def _log_key(self, name: str, scale: ColorScale) -> None:
        title = {"depth": "z-depth [mm]", "error": "estimate minus truth [mm]; red is too near"}[name]
        self._stream.log(f"scope/image/key_{name}", rr.Image(key_picture(scale, title)), static=True)

    def _at(self, now_ns: int, frame: int | None = None) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(now_ns, "ns"))
        if frame is not None:
            self._stream.set_time(FRAME_TIMELINE, sequence=frame)

    def _log_trocar(self, arm: "Arm") -> None:
        angle = np.linspace(0.0, 2.0 * np.pi, 33)
        circle = _TROCAR_RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        ring = rr.LineStrips3D([circle + arm.trocar_in_world], radii=[0.0015], colors=[_TROCAR_COLOR])
        self._stream.log(f"world/trocars/{arm.name}", ring, static=True)

    def _log_bodies(self, theatre: "Theatre") -> None:
        """Log the poses of all bodies at time 0, and then their shapes.

        A viewer that is fed over the network gets static data before all other: shapes that were static would lie in a heap at
        the origin until their poses have arrived.
        """
        bodies = tuple(drawn_bodies(theatre.model))
        self._at(0, 0)
        for body in bodies:
            pose = rr.Transform3D(
                translation=theatre.data.xpos[body.body_id],
                quaternion=rr.Quaternion(xyzw=body_quaternions(theatre.data, np.array([body.body_id]))[0]),
            )
            self._stream.log(body.path, pose, static=not body.moves)
        self._stream.flush()
        for body in bodies:
            log_shapes(self._stream, theatre.model, body)
        self._bodies = tuple(body for body in bodies if body.moves)
        self._body_ids = np.array([body.body_id for body in self._bodies], dtype=np.intp)

    def _pose(self, theatre: "Theatre") -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and orientations of all bodies and the offset of the tissue; log a new shape of the tissue."""
        if self._tissue is None:
            raise RuntimeError("begin() comes before any record")
        offset, shape = self._tissue.update(theatre.tissue.surface_points())
        if shape is not None:
            self._stream.log("world/tissue", shape)
        return theatre.data.xpos[self._body_ids].copy(), body_quaternions(theatre.data, self._body_ids), offset

    def _encoded_stripes(self, image: NDArray[np.uint8]) -> rr.EncodedImage:
        import cv2

        if self._detail.jpeg_quality is None:
            return rr.EncodedImage(contents=cv2.imencode(".png", image)[1].tobytes(), media_type="image/png")
        encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self._detail.jpeg_quality])[1]
        return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")

    def _log_depth(self, path: str, depth_mm: NDArray[np.floating]) -> None:
        import cv2

        units = np.nan_to_num(depth_mm * (DEPTH_UNITS_PER_M / 1000.0), nan=0.0)
        whole = np.clip(np.round(units), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        png = cv2.imencode(".png", whole)[1].tobytes()
        self._stream.log(path, rr.EncodedDepthImage(png, media_type="image/png", meter=DEPTH_UNITS_PER_M, colormap="viridis"))

    def _log_surface(self, record: DepthRecord, error_mm: NDArray[np.float32]) -> None:
        """Log the reconstructed points where their error is known; points off the tissue would hide the instrument."""
        every = (self._point_stride, self._point_stride)
        error = error_mm[every]
        known = np.isfinite(error)
        depth_m = record.depth.estimate.depth_mm[every][known].astype(np.float64) * 1e-3
        points = transform_points(record.depth.world_from_camera, self._rays_in_camera[known] * depth_m[:, None])
        cloud = rr.Points3D(points.astype(np.float32), colors=self._error_scale.colors(error[known]), radii=[0.001])
        self._stream.log("world/surface", cloud)

    def _send_batch(self) -> None:
        """Send the ticks and the poses kept since the last batch, each series in one call."""
        if self._plots is not None:
            self._plots.send(self._ticks, self._predictions)
            self._ticks.clear()
            self._predictions.clear()
        if self._poses:
            index = [times(self._pose_times)]
            positions, quaternions = (np.stack([pose[part] for pose in self._poses], axis=1) for part in (0, 1))
            for body, position, quaternion in zip(self._bodies, positions, quaternions, strict=True):
                columns = rr.Transform3D.columns(translation=position, quaternion=quaternion)
                self._stream.send_columns(body.path, index, columns)
            offsets = rr.Transform3D.columns(translation=np.stack([pose[2] for pose in self._poses]))
            self._stream.send_columns("world/tissue", index, offsets)
            self._poses.clear()
            self._pose_times.clear()


def _verify(path: Path) -> None:
    """Read a recording to its end, or raise: Rerun writes in a thread of its own, which only logs that the disk refuses."""
    with warnings.catch_warnings(action="error"):
        reader = RrdReader(path)
        reader.recordings()
        for _ in reader.stream():
            pass
