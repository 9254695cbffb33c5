from .acquisition.config import AcquisitionConfig as AcquisitionConfig
from .acquisition.run import collect_pairs as collect_pairs
from .calibration.config import CalibrationConfig as CalibrationConfig
from .calibration.run import BenchCalibration as BenchCalibration
from .calibration.run import calibrate_bench as calibrate_bench
from .characterization.config import CharacterizationConfig as CharacterizationConfig
from .characterization.run import characterise as characterise
from .demonstrations.config import CollectionConfig as CollectionConfig
from .demonstrations.config import DemonstrationConfig as DemonstrationConfig
from .demonstrations.config import Perturbation as Perturbation
from .demonstrations.dataset import make_dataset as make_dataset
from .demonstrations.demonstration import Demonstration as Demonstration
from .demonstrations.recorded import open_demonstrations as open_demonstrations
from .demonstrations.replay import replay as replay
from .depth.config import DepthEvaluation as DepthEvaluation
from .depth.config import RobustnessConfig as RobustnessConfig
from .depth.evaluation import evaluate_depth as evaluate_depth
from .depth.jitter import measure_jitter as measure_jitter
from .depth.robustness import measure_robustness as measure_robustness
from .episodes.task_campaigns import CAMPAIGNS as CAMPAIGNS
from .episodes.task_campaigns import Campaign as Campaign
from .episodes.task_campaigns import Check as Check
from .episodes.task_table import TaskTableConfig as TaskTableConfig
from .episodes.task_table import run_task_table as run_task_table
from .episodes.trials import TrialsConfig as TrialsConfig
from .episodes.trials import run_trials as run_trials
from .fidelity.config import FidelityConfig as FidelityConfig
from .fidelity.run import measure_fidelity as measure_fidelity
from .learners.curve import Curve as Curve
from .learners.curve_callback import CurveCallback as CurveCallback
from .learners.evaluation import Training as Training
from .learners.evaluation import evaluate as evaluate
from .learners.evaluation import verdict as verdict
from .learners.evaluation import write_result as write_result
from .learners.policy_file import save_policy as save_policy
from .learners.sb3_policy import load_into as load_into
from .learners.sb3_policy import load_sb3 as load_sb3
from .learners.sb3_policy import save_sb3 as save_sb3
from .learners.target_in_depth import TargetInDepth as TargetInDepth
from .ray_cluster import ray_cluster as ray_cluster
from .sweeps.engine import Engine as Engine
from .sweeps.run import run_sweep as run_sweep
from .sweeps.sweep import Condition as Condition
from .sweeps.sweep import Sweep as Sweep
from .sweeps.sweep_file import read_sweep as read_sweep
from .synthesis.config import TrainingFramesConfig as TrainingFramesConfig
from .synthesis.run import render_training_frames as render_training_frames
from .timing.bench import run_bench as run_bench
from .timing.bench_config import BenchConfig as BenchConfig
from .timing.speed import measure_speed as measure_speed
from .timing.speed_config import SpeedConfig as SpeedConfig

__all__ = [
    "CAMPAIGNS",
    "AcquisitionConfig",
    "BenchCalibration",
    "BenchConfig",
    "CalibrationConfig",
    "Campaign",
    "CharacterizationConfig",
    "Check",
    "CollectionConfig",
    "Condition",
    "Curve",
    "CurveCallback",
    "Demonstration",
    "DemonstrationConfig",
    "DepthEvaluation",
    "Engine",
    "FidelityConfig",
    "Perturbation",
    "RobustnessConfig",
    "SpeedConfig",
    "Sweep",
    "TargetInDepth",
    "TaskTableConfig",
    "Training",
    "TrainingFramesConfig",
    "TrialsConfig",
    "calibrate_bench",
    "characterise",
    "collect_pairs",
    "evaluate",
    "evaluate_depth",
    "load_into",
    "load_sb3",
    "make_dataset",
    "measure_fidelity",
    "measure_jitter",
    "measure_robustness",
    "measure_speed",
    "open_demonstrations",
    "ray_cluster",
    "read_sweep",
    "render_training_frames",
    "replay",
    "run_bench",
    "run_sweep",
    "run_task_table",
    "run_trials",
    "save_policy",
    "save_sb3",
    "verdict",
    "write_result",
]
