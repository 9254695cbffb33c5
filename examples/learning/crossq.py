"""Learn to touch a point of the tissue in few decisions, with CrossQ of sb3-contrib: SAC without target networks.

Batch normalisation in the critics takes the place of target networks (Bhatt et al., ICLR 2024), so that they may learn faster.
Run it with `python examples/learning/crossq.py --out runs/crossq`.
"""

import argparse
from pathlib import Path

import gymnasium as gym
from sb3_contrib import CrossQ
from stable_baselines3.common.monitor import Monitor

import laploop  # noqa: F401  registers the environments
from laploop.studies.learners.curve_callback import CurveCallback
from laploop.studies.learners.evaluation import Training, evaluate, verdict, write_result
from laploop.studies.learners.sb3_policy import load_into

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="decisions of 40 ms")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
parser.add_argument("--out", type=Path, default=Path("runs/crossq"))
parser.add_argument("--resume", action="store_true", help="go on from the policy in --out")
options = parser.parse_args()

ENVIRONMENT, KEYWORDS = "laploop/Reach-v1", {"observation": "state", "fidelity": "fast"}
env = gym.make(ENVIRONMENT, **KEYWORDS)

network = {"net_arch": {"pi": [64, 64], "qf": [256, 256]}}
model = CrossQ(
    "MlpPolicy",
    Monitor(env),
    learning_rate=1e-3,
    gamma=0.97,
    ent_coef="auto_0.01",
    learning_starts=min(500, options.steps // 2),
    buffer_size=max(options.steps, 1000),
    policy_kwargs=network,
    seed=options.seed,
    verbose=1,
)
if options.resume:
    load_into(model, options.out)

callback = CurveCallback(options.out, network, resume=options.resume)
model.learn(options.steps, callback=callback, log_interval=20)
training = Training(
    method="crossq",
    environment=ENVIRONMENT,
    keywords=KEYWORDS,
    seed=options.seed,
    steps=callback.curve.steps(model.num_timesteps),
    wall_s=callback.curve.wall_s,
    cpu_s=callback.curve.cpu_s,
)

# Now the mean of the policy instead of a sample, on seeds that training never used.
scores = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], env, options.episodes)
print(verdict(write_result(options.out, training, scores)))
env.close()
