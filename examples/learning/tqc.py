"""Learn to touch a point of the tissue in few decisions, with truncated quantile critics (TQC) of sb3-contrib.

TQC is SAC with critics that learn the distribution of returns and leave out its highest quantiles, so that they overestimate
less (Kuznetsov et al., ICML 2020). Run it with `python examples/learning/tqc.py --out runs/tqc`.
"""

import argparse
from pathlib import Path

import gymnasium as gym
from sb3_contrib import TQC
from stable_baselines3.common.monitor import Monitor

import laploop  # noqa: F401  registers the environments
from laploop.studies import CurveCallback, evaluate, load_into, verdict, write_result

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="decisions of 40 ms")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
parser.add_argument("--out", type=Path, default=Path("runs/tqc"))
parser.add_argument("--resume", action="store_true", help="go on from the policy in --out")
options = parser.parse_args()

# `fast` simulates contact in less detail, at half the cost; nothing is rendered for the observation `state`.
ENVIRONMENT, KEYWORDS = "laploop/Reach-v1", {"observation": "state", "fidelity": "fast"}
env = gym.make(ENVIRONMENT, **KEYWORDS)

# As for SAC: rewards of a step are hundredths, so the entropy in them must begin far below its usual weight of 1.
network = {"net_arch": [64, 64]}
model = TQC(
    "MlpPolicy",
    Monitor(env),
    # It falls to nothing over the training.
    learning_rate=lambda left: 1e-3 * left,
    gamma=0.97,
    batch_size=128,
    tau=0.02,
    top_quantiles_to_drop_per_net=2,
    ent_coef="auto_0.01",
    learning_starts=min(1000, options.steps // 2),
    buffer_size=max(options.steps, 1000),
    policy_kwargs=network,
    seed=options.seed,
    verbose=1,
)
if options.resume:
    load_into(model, options.out)

callback = CurveCallback(options.out, network, resume=options.resume)
model.learn(options.steps, callback=callback, log_interval=20)

training = callback.training(method="tqc", environment=ENVIRONMENT, keywords=KEYWORDS, seed=options.seed)

# Now the mean of the policy instead of a sample, on seeds that training never used.
scores = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], env, options.episodes)
print(verdict(write_result(options.out, training, scores)))
env.close()
