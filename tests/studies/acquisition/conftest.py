import shutil

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.pair_store import PairStore
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.run import collect_pairs
from laploop.studies.scenes.optical_bench import OpticalBench

SMALL = AcquisitionConfig(
    pairs=7,
    tissues=3,
    workers=1,
    tool_share=0.3,
    seed=5,
    bench=OpticalBench(
        scope=ScopeOptics(width=64, height=64, mask=StripeMask(stripes=10)), reference=ReferenceOptics(sampling="4x4")
    ),
    tissue=TissueConfig(shape=TissueShape(samples=31), cells=(4, 4)),
)


def perfect_calibration(bench):
    """Return what a bench would find whose calibration were perfect."""

    def camera(intrinsics):
        return CameraCalibration(
            intrinsics=intrinsics,
            distortion=BrownDistortion(),
            view_errors_px=(0.0,) * 5,
            camera_from_board=np.stack([np.eye(4)] * 5),
        )

    return StereoCalibration(
        scope=camera(bench.rig.camera),
        reference=camera(bench.reference.intrinsics),
        scope_from_reference=bench.scope_from_reference,
        view_errors_px=(0.0,) * 5,
    )


@pytest.fixture(scope="session")
def small():
    """The collection of `store`."""
    return SMALL


@pytest.fixture(scope="session")
def calibration_of():
    """Make what a bench would find whose calibration were perfect."""
    return perfect_calibration


@pytest.fixture(scope="session")
def calibration(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    save_calibration(path, perfect_calibration(SMALL.bench))
    return path


@pytest.fixture(scope="session")
def store(tmp_path_factory, calibration):
    return PairStore.open(collect_pairs(SMALL, tmp_path_factory.mktemp("data") / "pairs", calibration=calibration))


@pytest.fixture
def copied(store, tmp_path):
    shutil.copytree(store.path, tmp_path / "copy")
    return tmp_path / "copy"
