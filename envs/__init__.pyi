from . import dm as dm
from .async_policy import AsyncPolicy as AsyncPolicy
from .async_policy import AsyncPolicyConfig as AsyncPolicyConfig
from .environment_state import EnvironmentState as EnvironmentState
from .episode import run_episode as run_episode
from .episode_config import ControllerConfig as ControllerConfig
from .episode_config import EpisodeConfig as EpisodeConfig
from .episode_config import EpisodeOptions as EpisodeOptions
from .episode_config import PerceptionConfig as PerceptionConfig
from .episode_config import PredictorConfig as PredictorConfig
from .fidelity import with_fidelity as with_fidelity
from .learning.encoding import VectorLayout as VectorLayout
from .learning.encoding import decode_depth as decode_depth
from .learning.encoding import encode_depth as encode_depth
from .learning.learner_env import LearnerEnv as LearnerEnv
from .learning.look import LookLearnerEnv as LookLearnerEnv
from .learning.options import LearnerOptions as LearnerOptions
from .learning.palpate import PalpateLearnerEnv as PalpateLearnerEnv
from .learning.privileged import PRIVILEGED as PRIVILEGED
from .learning.reach import ReachLearnerEnv as ReachLearnerEnv
from .learning.scan import ScanLearnerEnv as ScanLearnerEnv
from .learning.track import TrackLearnerEnv as TrackLearnerEnv
from .loop.closed_loop import ClosedLoop as ClosedLoop
from .loop.config import LoopConfig as LoopConfig
from .loop.faults import Fault as Fault
from .loop.kinematic_errors import KinematicErrors as KinematicErrors
from .loop.timing.config import TimingConfig as TimingConfig
from .loop.timing.latency import ConstantLatency as ConstantLatency
from .loop.timing.latency import GammaLatency as GammaLatency
from .loop.timing.latency import LatencyModel as LatencyModel
from .loop.timing.latency import LognormalLatency as LognormalLatency
from .loop.timing.latency import MeasuredLatency as MeasuredLatency
from .loop.timing.latency import NormalLatency as NormalLatency
from .loop.timing.latency import TraceLatency as TraceLatency
from .randomisation.distributions import Distribution as Distribution
from .randomisation.files import randomisation_of as randomisation_of
from .randomisation.randomisation import Randomisation as Randomisation
from .randomisation.randomisation import with_values as with_values
from .recording.recorder import CompositeRecorder as CompositeRecorder
from .recording.recorder import NullRecorder as NullRecorder
from .recording.recorder import Recorder as Recorder
from .recording.rerun_recorder import RerunRecorder as RerunRecorder
from .recording.rerun_viewer import RerunViewer as RerunViewer
from .sensors.optics.camera_response import CameraResponse as CameraResponse
from .sensors.optics.exposure_control import ExposureControl as ExposureControl
from .sensors.optics.presets import OpticsRanges as OpticsRanges
from .sensors.optics.presets import optics_preset as optics_preset
from .sensors.optics.scope_ranges import ScopeRanges as ScopeRanges
from .sensors.optics.stripe_optics import Material as Material
from .sensors.optics.stripe_optics import StripeOptics as StripeOptics
from .sensors.optics.subsurface import Subsurface as Subsurface
from .sensors.optics.tissue_classes import TISSUE_CLASSES as TISSUE_CLASSES
from .sensors.optics.tissue_classes import TissueClass as TissueClass
from .sensors.optics.tissue_classes import tissue_material as tissue_material
from .sensors.overview_camera import OverviewCamera as OverviewCamera
from .sensors.reference.camera import ReferenceCamera as ReferenceCamera
from .sensors.reference.optics import ReferenceOptics as ReferenceOptics
from .sensors.stripe_camera import StripeCamera as StripeCamera
from .tasks.configs import LookConfig as LookConfig
from .tasks.configs import PalpateConfig as PalpateConfig
from .tasks.configs import ReachConfig as ReachConfig
from .tasks.configs import ScanConfig as ScanConfig
from .tasks.configs import TrackConfig as TrackConfig
from .tasks.look import LookEnv as LookEnv
from .tasks.palpate import PalpateEnv as PalpateEnv
from .tasks.reach import ReachEnv as ReachEnv
from .tasks.registry import TASKS as TASKS
from .tasks.registry import Criterion as Criterion
from .tasks.registry import TaskSpec as TaskSpec
from .tasks.registry import default_config as default_config
from .tasks.registry import environment_id as environment_id
from .tasks.scan import ScanEnv as ScanEnv
from .tasks.task_config import TaskConfig as TaskConfig
from .tasks.task_env import TaskEnv as TaskEnv
from .tasks.track import TrackEnv as TrackEnv
from .theatre.actuation import ActuationConfig as ActuationConfig
from .theatre.clock_rates import ClockRates as ClockRates
from .theatre.config import TheatreConfig as TheatreConfig
from .theatre.config import TheatreLayout as TheatreLayout
from .theatre.organ_motion import BaseMotion as BaseMotion
from .theatre.organ_motion import StageTravel as StageTravel
from .theatre.theatre import Theatre as Theatre
from .theatre.trocar import TrocarConfig as TrocarConfig
from .timing_presets import TIMINGS as TIMINGS
from .timing_presets import TimingPreset as TimingPreset
from .wrappers.action_history import ActionHistory as ActionHistory
from .wrappers.age_aware_frame_stack import AgeAwareFrameStack as AgeAwareFrameStack
from .wrappers.chain_state import ChainState as ChainState
from .wrappers.chain_state import StatefulWrapper as StatefulWrapper
from .wrappers.chain_state import get_state as get_state
from .wrappers.chain_state import set_state as set_state
from .wrappers.conservative_agent import ConservativeAgent as ConservativeAgent
from .wrappers.delay_randomization import DelayRandomization as DelayRandomization
from .wrappers.goal_conditioned import GoalConditioned as GoalConditioned

__all__ = [
    "PRIVILEGED",
    "TASKS",
    "TIMINGS",
    "TISSUE_CLASSES",
    "ActionHistory",
    "ActuationConfig",
    "AgeAwareFrameStack",
    "AsyncPolicy",
    "AsyncPolicyConfig",
    "BaseMotion",
    "CameraResponse",
    "ChainState",
    "ClockRates",
    "ClosedLoop",
    "CompositeRecorder",
    "ConservativeAgent",
    "ConstantLatency",
    "ControllerConfig",
    "Criterion",
    "DelayRandomization",
    "Distribution",
    "EnvironmentState",
    "EpisodeConfig",
    "EpisodeOptions",
    "ExposureControl",
    "Fault",
    "GammaLatency",
    "GoalConditioned",
    "KinematicErrors",
    "LatencyModel",
    "LearnerEnv",
    "LearnerOptions",
    "LognormalLatency",
    "LookConfig",
    "LookEnv",
    "LookLearnerEnv",
    "LoopConfig",
    "Material",
    "MeasuredLatency",
    "NormalLatency",
    "NullRecorder",
    "OpticsRanges",
    "OverviewCamera",
    "PalpateConfig",
    "PalpateEnv",
    "PalpateLearnerEnv",
    "PerceptionConfig",
    "PredictorConfig",
    "Randomisation",
    "ReachConfig",
    "ReachEnv",
    "ReachLearnerEnv",
    "Recorder",
    "ReferenceCamera",
    "ReferenceOptics",
    "RerunRecorder",
    "RerunViewer",
    "ScanConfig",
    "ScanEnv",
    "ScanLearnerEnv",
    "ScopeRanges",
    "StageTravel",
    "StatefulWrapper",
    "StripeCamera",
    "StripeOptics",
    "Subsurface",
    "TaskConfig",
    "TaskEnv",
    "TaskSpec",
    "Theatre",
    "TheatreConfig",
    "TheatreLayout",
    "TimingConfig",
    "TimingPreset",
    "TissueClass",
    "TraceLatency",
    "TrackConfig",
    "TrackEnv",
    "TrackLearnerEnv",
    "TrocarConfig",
    "VectorLayout",
    "decode_depth",
    "default_config",
    "dm",
    "encode_depth",
    "environment_id",
    "get_state",
    "optics_preset",
    "randomisation_of",
    "run_episode",
    "set_state",
    "tissue_material",
    "with_fidelity",
    "with_values",
]
