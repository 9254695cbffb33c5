"""An episode as a Rerun file with its layout."""

import errno
import warnings
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from laploop.envs.loop.timing.log import FRAME_STAGES
from laploop.envs.recording.recorder import STAGES, DepthRecord, FrameRecord, Recorder, TickRecord
from laploop.envs.recording.rerun_blueprint import ERROR_RANGE_MM, PLOTS, episode_blueprint, legend
from laploop.envs.recording.rerun_scene import DrawnBody, VertexNormals, body_quaternions, drawn_bodies, log_shapes
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.geometry import Rig, transform_points

if TYPE_CHECKING:
    from laploop.envs.theatre.arm import Arm
    from laploop.envs.theatre.theatre import Theatre

TIMELINE = "sim_time"
FRAME_TIMELINE = "frame"

DEPTH_UNITS_PER_M = 100_000.0
"""Depth maps are stored as 16-bit integers of 0.01 mm, up to 655 mm; 0 means no depth."""

_FLUSH_TICKS = 125
"""Ticks and poses are sent in batches of about a second: each call to Rerun is expensive."""

_POINT_STRIDE = 4
_NO_ERROR = 256
"""Index of black behind the colours of errors."""

_TISSUE_COLOR = (222, 146, 132)
_TARGET_COLOR = (60, 220, 90)
_TROCAR_COLOR = (245, 215, 66)
_TROCAR_RADIUS_M = 0.011
"""A little more than that of the modelled rings."""


class RerunRecorder(Recorder):
    """Writes a Rerun recording (`.rrd`) with its blueprint.

    Everything goes to a hidden file beside `path`, which gets its name when the recorder is closed: `path` never holds half
    a recording. As a context manager it closes at the end of the block, also when the block raises: what was recorded until
    then is kept, and a note on the error says so.
    Nothing opens a window or a socket.

    Entities: `world/...` in metres (arms, instrument, stage, wall, `trocars`, `tissue`, `surface`: the reconstruction
    coloured by its error, `camera`, `target`), `scope/image/{stripes,depth,truth,error}`, `plots/...`. Timelines:
    `sim_time`, and `frame`, the index of the camera frame that something belongs to.
    """

    def __init__(self, path: Path | str, *, map_stride: int = 2) -> None:
        """Open the hidden file.

        Args:
            path: Path of the recording, in an existing folder.
            map_stride: Depth, truth and error keep every `map_stride`-th pixel along both axes: at 2, a second of
                recording takes about 6 MB.

        Raises:
            InvalidValueError: If the stride is not positive.
            OutputError: If the folder cannot be written.
        """
        if map_stride < 1:
            raise InvalidValueError("map_stride", map_stride, "an integer of at least 1")
        self.path = Path(path)
        self._partial = self.path.with_name(f".{self.path.name}.partial")
        try:
            self._partial.touch()
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}") from error
        self._stride = slice(None, None, map_stride)
        self._stream = rr.RecordingStream("laploop")
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        self._theatre: Theatre | None = None
        self._normals_of: VertexNormals | None = None
        self._bodies: tuple[DrawnBody, ...] = ()
        self._body_ids = np.empty(0, dtype=np.intp)
        self._ticks: list[TickRecord] = []
        self._pose_times: list[int] = []
        self._poses: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        self._depth_range: tuple[float, float] | None = None
        self._rays_in_camera = np.empty((0, 0, 3))
        self._error_colors = np.empty((0, 3), dtype=np.uint8)
        self._closed = self._kept = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        """Close the recording; the note on an error that ends the block says where it is."""
        self.close()
        if error is not None and self._kept:
            error.add_note(f"the recording up to then is kept in {self.path}")

    def begin(self, theatre: "Theatre", rig: Rig) -> None:
        """Log everything that does not change, and the blueprint."""
        from matplotlib import colormaps

        stream, model = self._stream, theatre.model
        colors = colormaps["Spectral"](np.linspace(0.0, 1.0, _NO_ERROR))[:, :3]
        self._error_colors = (np.vstack([colors, np.zeros(3)]) * 255).astype(np.uint8)
        self._rays_in_camera = rig.camera.rays[::_POINT_STRIDE, ::_POINT_STRIDE].copy()
        look_at = theatre.tissue.surface_points().mean(axis=0)
        self._open(episode_blueprint(look_at))
        self._theatre = theatre

        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("legend", rr.TextDocument(legend(rig), media_type=rr.MediaType.MARKDOWN), static=True)
        for name, plot in PLOTS.items():
            for series, (label, color) in plot.series.items():
                lines = rr.SeriesLines(names=[label], colors=[color], widths=[1.5])
                stream.log(f"plots/{name}/{series}", lines, static=True)
        bodies = tuple(drawn_bodies(model))
        for body in bodies:
            log_shapes(stream, model, body)
            if not body.moves:
                ids = np.array([body.body_id])
                pose = rr.Transform3D(
                    translation=theatre.data.xpos[body.body_id],
                    quaternion=rr.Quaternion(xyzw=body_quaternions(theatre.data, ids)[0]),
                )
                stream.log(body.path, pose, static=True)
        self._bodies = tuple(body for body in bodies if body.moves)
        self._body_ids = np.array([body.body_id for body in self._bodies], dtype=np.intp)
        for arm in (theatre.camera_arm, theatre.tool_arm):
            self._log_trocar(arm)
        triangles = theatre.tissue.triangles
        self._normals_of = VertexNormals(triangles, len(theatre.tissue.surface_points()))
        tissue = rr.Mesh3D.from_fields(triangle_indices=triangles.astype(np.uint32), albedo_factor=_TISSUE_COLOR)
        stream.log("world/tissue", tissue, static=True)
        stream.log("world/target", rr.Points3D([[0.0, 0.0, 0.0]], radii=[0.0015], colors=[_TARGET_COLOR]), static=True)
        camera = rr.Pinhole(
            resolution=[rig.camera.width, rig.camera.height],
            focal_length=[rig.camera.fx, rig.camera.fy],
            principal_point=[rig.camera.cx, rig.camera.cy],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.03,
        )
        stream.log("world/camera", camera, static=True)

    def tick(self, record: TickRecord) -> None:
        """Keep a control tick until the next batch."""
        self._ticks.append(record)
        if len(self._ticks) >= _FLUSH_TICKS:
            self._send_batch()

    def frame(self, record: FrameRecord) -> None:
        """Log the image and the state of the world at its capture."""
        theatre, normals_of = self._begun()
        self._at(record.now_ns, record.frame.index)
        stream = self._stream
        stream.log("scope/image/stripes", rr.Image(record.frame.image))
        world_from_camera = record.frame.world_from_camera
        stream.log("world/camera", rr.Transform3D(translation=world_from_camera[:3, 3], mat3x3=world_from_camera[:3, :3]))
        # `astype` copies, and it must: Rerun keeps a reference to float32 arrays.
        points = theatre.tissue.surface_points().astype(np.float32)
        stream.log("world/tissue", rr.Mesh3D.from_fields(vertex_positions=points, vertex_normals=normals_of(points)))
        self._pose_times.append(record.now_ns)
        self._poses.append((theatre.data.xpos[self._body_ids].copy(), body_quaternions(theatre.data, self._body_ids)))
        if self._depth_range is None:
            self._depth_range = _depth_range_mm(record.exact_depth_mm)

    def depth(self, record: DepthRecord) -> None:
        """Log a depth frame, its truth, its error, and the surface reconstructed from it."""
        self._begun()
        self._at(record.now_ns, record.depth.index)
        if self._depth_range is None:
            self._depth_range = _depth_range_mm(record.exact_depth_mm)
        estimate = record.depth.estimate
        stored = (self._stride, self._stride)
        valid = estimate.valid[stored]
        self._log_depth("scope/image/depth", np.where(valid, estimate.depth_mm[stored], np.nan))
        self._log_depth("scope/image/truth", record.exact_depth_mm[stored])
        error = record.error_mm()
        self._stream.log("scope/image/error", rr.Image(self._colors_of(error[stored])))
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

    def _open(self, blueprint: Any) -> None:
        """Say where the stream goes."""
        self._stream.save(self._partial, default_blueprint=blueprint)

    def _begun(self) -> "tuple[Theatre, VertexNormals]":
        if self._theatre is None or self._normals_of is None:
            raise RuntimeError("begin() comes before any record")
        return self._theatre, self._normals_of

    def _at(self, now_ns: int, frame: int | None = None) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(now_ns, "ns"))
        if frame is not None:
            self._stream.set_time(FRAME_TIMELINE, sequence=frame)

    def _log_trocar(self, arm: "Arm") -> None:
        angle = np.linspace(0.0, 2.0 * np.pi, 33)
        circle = _TROCAR_RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        ring = rr.LineStrips3D([circle + arm.trocar_in_world], radii=[0.0015], colors=[_TROCAR_COLOR])
        self._stream.log(f"world/trocars/{arm.name}", ring, static=True)

    def _log_depth(self, path: str, depth_mm: NDArray[np.floating]) -> None:
        hundredths = np.nan_to_num(depth_mm * (DEPTH_UNITS_PER_M / 1000.0), nan=0.0)
        near, far = self._depth_range or (0.0, 1.0)
        self._stream.log(
            path,
            rr.DepthImage(
                np.clip(np.round(hundredths), 0, np.iinfo(np.uint16).max).astype(np.uint16),
                meter=DEPTH_UNITS_PER_M,
                colormap="inferno",
                depth_range=(near * DEPTH_UNITS_PER_M / 1000.0, far * DEPTH_UNITS_PER_M / 1000.0),
            ),
        )

    def _colors_of(self, error_mm: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Colour errors, (...), as RGB, (..., 3); black where there is none."""
        shade = np.clip((error_mm / np.float32(ERROR_RANGE_MM) + 1.0) * 127.5, 0.0, 255.0)
        index = np.where(np.isfinite(shade), shade, _NO_ERROR).astype(np.uint16)
        return np.take(self._error_colors, index, axis=0)

    def _log_surface(self, record: DepthRecord, error_mm: NDArray[np.float32]) -> None:
        """Log the reconstructed points where their error is known; points off the tissue would hide the instrument."""
        every = (slice(None, None, _POINT_STRIDE), slice(None, None, _POINT_STRIDE))
        error = error_mm[every]
        known = np.isfinite(error)
        depth_m = record.depth.estimate.depth_mm[every][known].astype(np.float64) * 1e-3
        points = transform_points(record.depth.world_from_camera, self._rays_in_camera[known] * depth_m[:, None])
        cloud = rr.Points3D(points.astype(np.float32), colors=self._colors_of(error[known]), radii=[0.0007])
        self._stream.log("world/surface", cloud)

    def _send_batch(self) -> None:
        """Send the ticks and the poses kept since the last batch, each series in one call."""
        if self._ticks:
            self._send_ticks()
            self._ticks.clear()
        if self._poses:
            index = [_times(self._pose_times)]
            positions = np.stack([position for position, _ in self._poses], axis=1)
            quaternions = np.stack([quaternion for _, quaternion in self._poses], axis=1)
            for body, position, quaternion in zip(self._bodies, positions, quaternions, strict=True):
                columns = rr.Transform3D.columns(translation=position, quaternion=quaternion)
                self._stream.send_columns(body.path, index, columns)
            self._poses.clear()
            self._pose_times.clear()

    def _send_ticks(self) -> None:
        ticks = self._ticks
        self._send_scalars("target_error_mm/target", [(tick.now_ns, tick.target_error_mm) for tick in ticks])
        self._send_scalars("force_n/force", [(tick.now_ns, tick.contact_force_n) for tick in ticks])
        ages = [(tick.now_ns, tick.depth_age_ms) for tick in ticks if tick.depth_age_ms is not None]
        self._send_scalars("depth_age_ms/age", ages)
        for name in PLOTS["rcm_error_mm"].series:
            self._send_scalars(f"rcm_error_mm/{name}", [(tick.now_ns, tick.rcm_error_mm[name]) for tick in ticks])
        for name in PLOTS["port_force_n"].series:
            forces = [(tick.now_ns, tick.port_force_n[name]) for tick in ticks if name in tick.port_force_n]
            self._send_scalars(f"port_force_n/{name}", forces)
        for stage in STAGES:
            times = [(tick.now_ns, tick.stage_ms[stage]) for tick in ticks if stage in tick.stage_ms]
            self._send_scalars(f"stage_ms/{stage}", times)
        for stage in FRAME_STAGES:
            times = [(tick.now_ns, tick.frame_ms[stage]) for tick in ticks if stage in tick.frame_ms]
            self._send_scalars(f"frame_ms/{stage}", times)
        index = [_times([tick.now_ns for tick in ticks])]
        targets = rr.Transform3D.columns(translation=np.stack([tick.target_in_world for tick in ticks]))
        self._stream.send_columns("world/target", index, targets)

    def _send_scalars(self, series: str, samples: list[tuple[int, float]]) -> None:
        if samples:
            columns = rr.Scalars.columns(scalars=[value for _, value in samples])
            self._stream.send_columns(f"plots/{series}", [_times([now_ns for now_ns, _ in samples])], columns)


def _verify(path: Path) -> None:
    """Read a recording to its end, or raise: Rerun writes in a thread of its own, which only logs that the disk refuses."""
    with warnings.catch_warnings(action="error"):
        reader = RrdReader(path)
        reader.recordings()
        for _ in reader.stream():
            pass


def _times(now_ns: list[int]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.array(now_ns, dtype="timedelta64[ns]"))


def _depth_range_mm(exact_depth_mm: NDArray[np.float32]) -> tuple[float, float]:
    """Choose the range of the colours of depth and truth: the first frame's depths, widened for the tissue's motion."""
    if not np.isfinite(exact_depth_mm).any():
        return 50.0, 150.0
    near, far = np.nanpercentile(exact_depth_mm, [1.0, 99.0])
    return max(float(near) - 12.0, 0.0), float(far) + 12.0
