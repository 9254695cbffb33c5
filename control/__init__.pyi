from .arm.model import SHAFT_TIP as SHAFT_TIP
from .arm.model import ArmModel as ArmModel
from .arm.named_limit import NamedLimit as NamedLimit
from .arm.rcm_config import RcmControllerConfig as RcmControllerConfig
from .arm.rcm_controller import RcmController as RcmController
from .arm.rcm_controller import RcmStatus as RcmStatus
from .arm.rcm_task import RcmTask as RcmTask
from .arm.start_posture import start_posture as start_posture
from .controllers.image_servo import ImageServoConfig as ImageServoConfig
from .controllers.image_servo import ImageServoController as ImageServoController
from .controllers.look import LookController as LookController
from .controllers.look import LookControllerConfig as LookControllerConfig
from .controllers.palpate import PalpateController as PalpateController
from .controllers.palpate import PalpateControllerConfig as PalpateControllerConfig
from .controllers.phase import Phase as Phase
from .controllers.reach import ReachController as ReachController
from .controllers.reach import ReachControllerConfig as ReachControllerConfig
from .controllers.registry import CONTROLLERS as CONTROLLERS
from .controllers.registry import make_controller as make_controller
from .controllers.scan import ScanController as ScanController
from .controllers.scan import ScanControllerConfig as ScanControllerConfig
from .controllers.track import TrackController as TrackController
from .controllers.track import TrackControllerConfig as TrackControllerConfig
from .messages import ControlInput as ControlInput
from .messages import TipController as TipController
from .prediction.alpha_beta import AlphaBetaFilter as AlphaBetaFilter
from .prediction.alpha_beta import AlphaBetaFilterConfig as AlphaBetaFilterConfig
from .prediction.alpha_beta import HeldMeasurement as HeldMeasurement
from .prediction.motion_predictor import BackgroundWork as BackgroundWork
from .prediction.motion_predictor import MotionPredictor as MotionPredictor
from .prediction.motion_predictor import Prediction as Prediction
from .prediction.registry import PREDICTORS as PREDICTORS
from .prediction.registry import make_predictor as make_predictor
from .prediction.rhythm_predictor import RhythmPredictor as RhythmPredictor
from .prediction.rhythm_predictor import RhythmPredictorConfig as RhythmPredictorConfig
from .targeting.targeting import Target as Target
from .targeting.targeting import Targeting as Targeting
from .targeting.targeting import TargetingConfig as TargetingConfig

__all__ = [
    "CONTROLLERS",
    "PREDICTORS",
    "SHAFT_TIP",
    "AlphaBetaFilter",
    "AlphaBetaFilterConfig",
    "ArmModel",
    "BackgroundWork",
    "ControlInput",
    "HeldMeasurement",
    "ImageServoConfig",
    "ImageServoController",
    "LookController",
    "LookControllerConfig",
    "MotionPredictor",
    "NamedLimit",
    "PalpateController",
    "PalpateControllerConfig",
    "Phase",
    "Prediction",
    "RcmController",
    "RcmControllerConfig",
    "RcmStatus",
    "RcmTask",
    "ReachController",
    "ReachControllerConfig",
    "RhythmPredictor",
    "RhythmPredictorConfig",
    "ScanController",
    "ScanControllerConfig",
    "Target",
    "Targeting",
    "TargetingConfig",
    "TipController",
    "TrackController",
    "TrackControllerConfig",
    "make_controller",
    "make_predictor",
    "start_posture",
]
