"""Teach a controller that predicts nothing to follow moving tissue by depth that is 150 ms late: residual learning.

The scripted controller goes where depth shows the target. The learned policy adds a velocity to its command (Johannink et al.,
ICRA 2019), so that it begins with what the controller can do and has only the delay to learn. Run it with
`python examples/learning/residual_rl.py --out runs/residual`; the controller alone is evaluated as well, into `base` below.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

import laploop  # noqa: F401  registers the environments
from laploop.assets import ScopeOptics
from laploop.control import make_controller
from laploop.envs import DelayRandomization
from laploop.perception import Rig
from laploop.studies import CurveCallback, TargetInDepth, Training, evaluate, load_into, verdict, write_result

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--latency-ms", type=float, default=150.0)
parser.add_argument("--steps", type=int, default=50_000, help="decisions of 40 ms")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=20, help="of each evaluation")
parser.add_argument("--out", type=Path, default=Path("runs/residual"))
parser.add_argument("--resume", action="store_true", help="go on from the policy in --out")
options = parser.parse_args()

ENVIRONMENT = "laploop/Track-v1"
KEYWORDS = {"observation": "depth", "action": "residual", "perception": "oracle", "fidelity": "fast", "latency_ms": 0.0}
CONDITIONS = {**KEYWORDS, "delay_ms": options.latency_ms}

# The task's own controller would learn the rhythms of breathing and heartbeat; this one holds what it saw last.
controller = make_controller("track", Rig.from_optics(ScopeOptics()), prediction="none")
env = gym.make(ENVIRONMENT, controller=controller, **KEYWORDS)
# Every map is that late, and none is lost: perception itself takes no time.
env = TargetInDepth(DelayRandomization(env, (options.latency_ms, options.latency_ms), stage="pipeline"))

# A policy begins with a mean of about zero; its exploring, 8 mm/s, is about as fast as the tissue.
network = {"net_arch": [64, 64], "log_std_init": -2.0}
rollout = max(2, min(2048, options.steps))
model = PPO(
    "MlpPolicy",
    Monitor(env),
    learning_rate=1e-3,
    n_steps=rollout,
    batch_size=min(64, rollout),
    gamma=0.97,
    policy_kwargs=network,
    seed=options.seed,
    verbose=1,
    device="cpu",
)
if options.resume:
    load_into(model, options.out)

callback = CurveCallback(options.out, network, resume=options.resume)
model.learn(options.steps, callback=callback, log_interval=5)
training = callback.training(method="residual ppo", environment=ENVIRONMENT, keywords=CONDITIONS, seed=options.seed)

# Both on the same seeds, which training never used.
scores = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], env, options.episodes)
print(verdict(write_result(options.out, training, scores)))
alone = Training(
    method="scripted, no prediction", environment=ENVIRONMENT, keywords=CONDITIONS, seed=0, steps=0, wall_s=0.0, cpu_s=0.0
)
scores = evaluate(lambda _: np.zeros(3, np.float32), env, options.episodes)
print(verdict(write_result(options.out / "base", alone, scores)))
env.close()
