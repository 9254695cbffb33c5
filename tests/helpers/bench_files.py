"""What a bench leaves behind, in the layout of docs/own_images.md."""

import cv2
import numpy as np
import trimesh

from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.projector import designed_projector
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.scenes.optical_bench import OpticalBench

SPLITS = ("train", "val", "test")


def write_exact_calibration(path, optics):
    """Write the calibration of a bench with a scope's optics that was measured without error."""
    bench, rig = OpticalBench(), Rig.from_optics(optics)

    def camera(intrinsics):
        poses = np.tile(np.eye(4), (5, 1, 1))
        return CameraCalibration(
            intrinsics=intrinsics, distortion=BrownDistortion(), view_errors_px=(0.0,) * 5, camera_from_board=poses
        )

    stereo = StereoCalibration(
        scope=camera(rig.camera),
        reference=camera(bench.reference.intrinsics),
        scope_from_reference=bench.scope_from_reference,
        view_errors_px=(0.0,) * 5,
    )
    save_calibration(path, stereo, projector=designed_projector(rig), mask=optics.mask)


def write_pairs(folder, store):
    """Write the pairs of a store as pictures, clouds and their list."""
    for name in ("images", "clouds"):
        (folder / name).mkdir(parents=True)
    lines = ["image,cloud,split,scene"]
    for index in range(len(store)):
        name = f"{index + 1:04d}"
        cv2.imwrite(str(folder / "images" / f"{name}.png"), store.image(index))
        cloud = trimesh.PointCloud(store.reference_cloud_mm(index))
        (folder / "clouds" / f"{name}.ply").write_bytes(cloud.export(file_type="ply"))
        lines.append(f"images/{name}.png,clouds/{name}.ply,{SPLITS[store.split[index]]},tissue {store.tissue_seed[index]}")
    (folder / "pairs.csv").write_text("\n".join(lines) + "\n")
