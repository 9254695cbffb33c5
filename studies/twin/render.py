"""Renders the stripe camera's scenes with the path tracer Mitsuba 3, as an independent judge of the light.

The projector is many point projectors all over its aperture. A ray from the point a of the aperture with the tangents d meets
the plane of focus at the mask coordinate d + a / focus: each projector shows the mask shifted by that much, and where their
pictures do not coincide, the mask is out of focus. Shadows soften by themselves, as each projector casts its own.
"""

import importlib.util
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from laploop.arrays import Array
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.studies.twin.spread import spread

_VARIANT = "scalar_rgb"
"""The variant that needs nothing beside the package."""
_TEXELS = 1024
_MARGIN_TAN = 0.14


def check_mitsuba() -> None:
    """Raise an `InvalidValueError`, which names the missing extra, before anything is rendered."""
    if importlib.util.find_spec("mitsuba") is None:
        raise InvalidValueError("mitsuba", "not installed", "installed by the extra: pip install 'laploop[twin]'")


def render_twin(
    rig: Rig,
    optics: StripeOptics,
    geometry: SceneGeometry,
    view: ExactView,
    *,
    rows: tuple[int, int],
    points: int = 61,
    samples: int = 4,
    bounces: int = 1,
) -> Array:
    """Return the expected photo-electrons of rows of the image, (rows, width).

    Mitsuba traces light on diffuse surfaces; the spread under surfaces, the lens's fall-off and point spread follow in
    numpy, by sums over neighbouring pixels where the stripe camera has filters of its own.

    Args:
        rig: Camera and projector at the world's origin.
        optics: Without gloss, light of the cavity and other lights, which are left out.
        geometry: The scene, in the camera's frame.
        view: Exact geometry, for distances on the surface.
        rows: First row and the row behind the last.
        points: Point projectors on the aperture.
        samples: Square number of rays a pixel for each of them.
        bounces: Surfaces that light meets on its way at most; 1 for direct light.

    Raises:
        InvalidValueError: If Mitsuba is not installed, or the optics have what the judge leaves out.
    """
    check_mitsuba()
    if optics.cavity_fraction > 0.0:
        raise InvalidValueError("cavity_fraction", optics.cavity_fraction, "0: the path tracer has no cavity")
    if optics.ambient_w_m2 > 0.0:
        raise InvalidValueError("ambient_w_m2", optics.ambient_w_m2, "0: the path tracer has no other lights")
    import mitsuba as mi

    mi.set_variant(_VARIANT)
    table = optics.material_table
    if bounces == 1:
        mesh = _mesh(mi, geometry, {"type": "rgb", "value": 1.0})
        integrator: dict[str, Any] = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    else:
        mesh = _mesh(mi, geometry, _ATTRIBUTE, _vertex_albedo(geometry, table))
        integrator = {"type": "path", "max_depth": 1 + bounces, "rr_depth": 1 + bounces}
    sensor = _sensor(mi, rig, rows, samples)
    total = np.zeros((rows[1] - rows[0], rig.camera.width))
    for point in aperture_points(0.5 * optics.projector_aperture_m, points):
        emitter = _projector(mi, rig, optics, point, points)
        scene = mi.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor, "projector": emitter, "mesh": mesh})
        total += np.asarray(mi.render(scene), dtype=np.float64)[..., 0]
    part = slice(*rows)
    object_id, depth = view.object_id[part], 1e-3 * view.depth_mm[part].astype(np.float64)
    rays = rig.camera.rays[part]
    albedo = table[object_id, 0] * _albedo_factors(mi, geometry, sensor)
    # What comes back is irradiance times reflectance over pi.
    reflectance = 1.0 if bounces == 1 else np.maximum(albedo, 1e-6)
    irradiance = math.pi * total / reflectance
    tissue = object_id == ObjectId.TISSUE
    if optics.tissue.subsurface.profile != "none" and tissue.any():
        normals, position = view.normals[part].astype(np.float64), depth[..., None] * rays
        irradiance = spread(irradiance, tissue, position, normals, rays, optics.tissue.subsurface, rig)
    cosine = 1.0 / np.linalg.norm(rays, axis=-1)
    electrons = albedo / math.pi * irradiance * cosine**optics.vignetting_exponent * optics.electrons_per_radiance
    blurred: Array = gaussian_filter(electrons, optics.lens_blur_px, mode="reflect")
    return blurred


_ATTRIBUTE = {"type": "mesh_attribute", "name": "vertex_albedo"}


def aperture_points(radius_m: float, count: int) -> Array:
    """Return points that fill a disk by rings of 1, 6, 12, ... points, (count, 2), as near to `count` as rings allow."""
    rings = round((-3.0 + math.sqrt(9.0 + 12.0 * (count - 1))) / 6.0)
    # Each ring has an area in proportion to its points, and they lie where half of it is inside.
    numbers = np.array([1] + [6 * ring for ring in range(1, rings + 1)])
    inner = np.concatenate([[0], np.cumsum(numbers)[:-1]])
    radii = np.sqrt((inner + 0.5 * numbers) / numbers.sum())
    radii[0] = 0.0
    found = [
        radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for ring, (radius, number) in enumerate(zip(radii, numbers, strict=True))
        for angle in [2.0 * math.pi * (np.arange(number) + 0.37 * ring) / number]
    ]
    return radius_m * np.concatenate(found)


def _steps(mask: StripeMask) -> tuple[Array, Array, Array]:
    """Return left borders, right borders and transmissions of the mask's steps."""
    half = mask.half_width_tan
    if mask.profile is not None:
        borders = np.linspace(-half, half, len(mask.profile) + 1)
        return borders[:-1], borders[1:], np.array(mask.profile)
    left = -half + (np.arange(-1, mask.stripes + 1) + mask.phase % 1.0) * mask.period_tan
    right = left + mask.duty * mask.period_tan
    return np.clip(left, -half, half), np.clip(right, -half, half), np.ones(len(left))


def _picture(mask: StripeMask, optics: StripeOptics, x: Array, y: Array) -> Array:
    """Return the light through the mask, blurred by the finite source and with glare, at rows y and columns x."""
    scale = 1.0 / (math.sqrt(2.0) * max(optics.source_blur_tan, 1e-6))
    left, right, bright = _steps(mask)

    def between(at: Array, low: Array | float, high: Array | float) -> Array:
        return np.asarray(0.5 * (erf((at - low) * scale) - erf((at - high) * scale)))

    half = mask.half_width_tan
    stripes = between(x[:, None], left, right) @ bright
    mean = float(np.sum((right - left) * bright)) / (2.0 * half)
    glare = optics.glare_fraction
    return np.outer(between(y, -half, half), (1.0 - glare) * stripes + glare * mean * between(x, -half, half))


def _projector(mi: Any, rig: Rig, optics: StripeOptics, point: Array, count: int) -> dict[str, Any]:
    """Return one of `count` point projectors, at a point of the aperture."""
    half = rig.mask.half_width_tan + _MARGIN_TAN
    d = (np.arange(_TEXELS) + 0.5) / _TEXELS * 2.0 * half - half
    shift = point / optics.projector_focus_m
    picture = _picture(rig.mask, optics, d + shift[0], d + shift[1])
    # A texel t makes the intensity pi t / cos³, so that a facing wall is lit evenly.
    cosine = 1.0 / np.sqrt(1.0 + d[None, :] ** 2 + d[:, None] ** 2)
    intensity = optics.axial_intensity_w_sr(rig.mask) / count * cosine ** (optics.led_exponent + 3.0) / math.pi
    bitmap = mi.Bitmap(np.repeat((picture * intensity)[..., None], 3, axis=2).astype(np.float32))
    place = np.linalg.inv(rig.projector_from_camera)
    place[:3, 3] += place[:3, :3] @ [*point, 0.0]
    return {
        "type": "projector",
        "irradiance": {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"},
        "fov": math.degrees(2.0 * math.atan(half)),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(place @ _TURNED),
    }


_TURNED = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's cameras and projectors have x to the left and y up."""


def _sensor(mi: Any, rig: Rig, rows: tuple[int, int], samples: int) -> Any:
    camera = rig.camera
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "crop_offset_x": 0,
        "crop_offset_y": rows[0],
        "crop_width": camera.width,
        "crop_height": rows[1] - rows[0],
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": math.degrees(2.0 * math.atan(0.5 * camera.width / camera.fx)),
            "fov_axis": "x",
            "near_clip": 1e-3,
            "far_clip": 10.0,
            "to_world": mi.ScalarTransform4f(_TURNED),
            "film": film,
            "sampler": {"type": "stratified", "sample_count": samples},
        }
    )


def _mesh(mi: Any, geometry: SceneGeometry, reflectance: dict[str, Any], vertex_albedo: Array | None = None) -> Any:
    """Return the scene's triangles with smooth normals of Mitsuba's own, and at the vertices an albedo, or its factor alone."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}})
    mesh = mi.Mesh(
        "scene",
        vertex_count=len(geometry.points),
        face_count=len(geometry.triangles),
        has_vertex_normals=True,
        props=properties,
    )
    values = geometry.albedo_factor if vertex_albedo is None else vertex_albedo
    mesh.add_attribute("vertex_albedo", 1, values.astype(np.float32))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = geometry.points.astype(np.float32).ravel()
    parameters["faces"] = geometry.triangles.astype(np.uint32).ravel()
    parameters.update()
    mesh.recompute_vertex_normals()
    return mesh


def _albedo_factors(mi: Any, geometry: SceneGeometry, sensor: Any) -> Array | float:
    """Return the mean of the albedo's factor over each pixel."""
    if np.ptp(geometry.albedo_factor) == 0.0:
        return float(geometry.albedo_factor[0])
    mesh = _mesh(mi, geometry, _ATTRIBUTE)
    integrator = {"type": "aov", "aovs": "factor:albedo"}
    scene = mi.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor, "mesh": mesh})
    factors: Array = np.asarray(mi.render(scene), dtype=np.float64)[..., -1]
    return factors


def _vertex_albedo(geometry: SceneGeometry, materials: NDArray[np.float32]) -> Array:
    """Return the albedo at each vertex; no triangles of two kinds share one."""
    albedo = np.zeros(len(geometry.points))
    albedo[geometry.triangles.ravel()] = np.repeat(materials[geometry.object_ids, 0], 3)
    return albedo * geometry.albedo_factor
