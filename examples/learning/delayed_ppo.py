"""Follow moving tissue by depth that is up to 150 ms late, with PPO: three ways to treat the delay.

naive         the policy sees what is there
augmented     it sees its last actions as well: with a delay of k steps, these make the process Markov again
conservative  every map is held back until it is of the longest age, so that a random delay looks like a constant one; the last
              actions are seen as well

Run it with `python examples/learning/delayed_ppo.py --treatment augmented --out runs/augmented`.
"""

import argparse
import math
from pathlib import Path

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

import laploop  # noqa: F401  registers the environments
from laploop.envs import ActionHistory, ConservativeAgent, DelayRandomization
from laploop.studies import CurveCallback, TargetInDepth, evaluate, load_into, verdict, write_result

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--treatment", default="naive", choices=["naive", "augmented", "conservative"])
parser.add_argument("--delay-ms", type=float, default=150.0, help="the longest; each episode draws its own from 40 ms on")
parser.add_argument("--steps", type=int, default=50_000, help="decisions of 40 ms")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=20, help="of the evaluation")
parser.add_argument("--out", type=Path, default=Path("runs/delayed_ppo"))
parser.add_argument("--resume", action="store_true", help="go on from the policy in --out")
options = parser.parse_args()

ENVIRONMENT = "laploop/Track-v1"
KEYWORDS = {"observation": "depth", "perception": "oracle", "fidelity": "fast", "latency_ms": 0.0}
DECISION_MS = 40.0


def make_env(delay_ms):
    """Return the task with delays from a range, (low, high) in milliseconds, and the chosen treatment."""
    # Perception itself takes no time here; `pipeline` makes every map late without keeping anybody busy, so that none is lost.
    env = DelayRandomization(gym.make(ENVIRONMENT, **KEYWORDS), delay_ms, stage="pipeline")
    if options.treatment == "conservative":
        env = ConservativeAgent(env, age_ms=options.delay_ms)
    # Images become a few numbers: to learn them from images would take days on a CPU.
    env = TargetInDepth(env)
    if options.treatment != "naive":
        env = ActionHistory(env, k=math.ceil(options.delay_ms / DECISION_MS))
    return env


env = make_env((40.0, options.delay_ms))
# Near tissue it explores with 10 mm/s, a sixth of the full speed.
network = {"net_arch": [64, 64], "log_std_init": -1.8}
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
training = callback.training(
    method=f"ppo, {options.treatment}",
    environment=ENVIRONMENT,
    keywords={**KEYWORDS, "delay_ms": options.delay_ms},
    seed=options.seed,
)
env.close()

# The hardest delay alone, on seeds that training never used.
env = make_env((options.delay_ms, options.delay_ms))
scores = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], env, options.episodes)
print(verdict(write_result(options.out, training, scores)))
env.close()
