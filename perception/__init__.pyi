from .calibration.board_corners import find_corners as find_corners
from .calibration.calibration_file import load_calibration as load_calibration
from .calibration.calibration_file import save_calibration as save_calibration
from .calibration.hand_eye import HandEyeCalibration as HandEyeCalibration
from .calibration.hand_eye import calibrate_hand_eye as calibrate_hand_eye
from .calibration.joint import calibrate_jointly as calibrate_jointly
from .calibration.projector import ProjectorCalibration as ProjectorCalibration
from .calibration.projector import calibrate_projector as calibrate_projector
from .calibration.results import CameraCalibration as CameraCalibration
from .calibration.results import StereoCalibration as StereoCalibration
from .calibration.solve import calibrate_camera as calibrate_camera
from .cramer_rao import CramerRaoBound as CramerRaoBound
from .data.datasets import DepthDataset as DepthDataset
from .data.datasets import open_dataset as open_dataset
from .data.frame_store import FrameStore as FrameStore
from .data.imported_pair_store import ImportedPairStore as ImportedPairStore
from .data.pair_import import PairImport as PairImport
from .data.pair_import import PairImporter as PairImporter
from .data.pair_store import PairFrame as PairFrame
from .data.pair_store import PairStore as PairStore
from .estimators.base import DepthEstimator as DepthEstimator
from .estimators.base import checked_estimate as checked_estimate
from .estimators.base import to_eight_bits as to_eight_bits
from .estimators.registry import ESTIMATORS as ESTIMATORS
from .estimators.registry import make_estimator as make_estimator
from .geometry import Intrinsics as Intrinsics
from .geometry import Rig as Rig
from .geometry import invert_transform as invert_transform
from .geometry import transform_points as transform_points
from .inference.export import export_onnx as export_onnx
from .messages import DepthEstimate as DepthEstimate
from .messages import DepthFrame as DepthFrame
from .messages import StripeFrame as StripeFrame
from .metrics import DepthMetrics as DepthMetrics
from .metrics import depth_metrics as depth_metrics
from .network_specs import NETWORKS as NETWORKS
from .network_specs import NetworkSpec as NetworkSpec
from .pictures.predictor import PicturePrediction as PicturePrediction
from .pictures.predictor import PicturePredictor as PicturePredictor
from .reprojection import reproject as reproject
from .stripe_check import StripeCheck as StripeCheck
from .weights import load_weights as load_weights
from .weights import save_weights as save_weights

__all__ = [
    "ESTIMATORS",
    "NETWORKS",
    "CameraCalibration",
    "CramerRaoBound",
    "DepthDataset",
    "DepthEstimate",
    "DepthEstimator",
    "DepthFrame",
    "DepthMetrics",
    "FrameStore",
    "HandEyeCalibration",
    "ImportedPairStore",
    "Intrinsics",
    "NetworkSpec",
    "PairFrame",
    "PairImport",
    "PairImporter",
    "PairStore",
    "PicturePrediction",
    "PicturePredictor",
    "ProjectorCalibration",
    "Rig",
    "StereoCalibration",
    "StripeCheck",
    "StripeFrame",
    "calibrate_camera",
    "calibrate_hand_eye",
    "calibrate_jointly",
    "calibrate_projector",
    "checked_estimate",
    "depth_metrics",
    "export_onnx",
    "find_corners",
    "invert_transform",
    "load_calibration",
    "load_weights",
    "make_estimator",
    "open_dataset",
    "reproject",
    "save_calibration",
    "save_weights",
    "to_eight_bits",
    "transform_points",
]
