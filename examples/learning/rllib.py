"""The same PPO with RLlib on Ray: from one machine to a cluster by an address alone.

Run it with `python examples/learning/rllib.py --workers 2`, on a cluster with `--address host:port`. It needs RLlib beside the
extras of laploop: `pip install 'laploop[learning,ray]' 'ray[rllib]'`.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import torch

from laploop.studies import Curve, Training, evaluate, ray_cluster, save_policy, verdict, write_result

ENVIRONMENT, KEYWORDS = "laploop:laploop/Reach-v1", {"observation": "state", "fidelity": "fast"}
NETWORK = [64, 64]

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=40_000, help="decisions of 40 ms, of all workers")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
parser.add_argument("--workers", type=int, default=1, help="processes that step environments")
parser.add_argument("--address", default=None, help="of a running cluster; by default this machine alone")
parser.add_argument("--out", type=Path, default=Path("runs/rllib"))
options = parser.parse_args()

# One processor more is for the learner itself.
with ray_cluster(options.workers + 1, options.address):
    try:
        from ray import tune
        from ray.rllib.algorithms.ppo import PPOConfig
        from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    except ImportError as error:
        parser.error(f"RLlib is not installed ({error}); pip install 'ray[rllib]'")

    # Workers may be on other machines: each makes its environment by itself.
    tune.register_env("laploop", lambda _: gym.make(ENVIRONMENT, **KEYWORDS))
    rollout = min(1024, options.steps)
    config = (
        PPOConfig()
        .environment("laploop")
        .env_runners(num_env_runners=options.workers)
        .training(lr=1e-3, gamma=0.97, train_batch_size_per_learner=rollout, minibatch_size=min(64, rollout), num_epochs=10)
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=NETWORK, vf_share_layers=False))
        .debugging(seed=options.seed)
    )
    algorithm, curve, steps = config.build_algo(), Curve(options.out), 0
    while steps < options.steps:
        runs = algorithm.train()["env_runners"]
        steps = int(runs["num_env_steps_sampled_lifetime"])
        if "episode_return_mean" in runs:
            mean, length = float(runs["episode_return_mean"]), float(runs["episode_len_mean"])
            curve.add(steps=steps, total_return=mean, length=length, success=float("nan"))
            print(f"{steps:7d} decisions, mean return {mean:.2f}")
        curve.write()
    module = algorithm.get_module()
    save_policy(module, options.out, {"kind": "RLlib PPO", "fcnet_hiddens": NETWORK})
    training = Training(
        method="ppo of rllib",
        environment=ENVIRONMENT.partition(":")[2],
        keywords=KEYWORDS,
        seed=options.seed,
        steps=steps,
        wall_s=curve.wall_s,
        cpu_s=curve.cpu_s,
    )
    algorithm.stop()


@torch.no_grad()
def act(observation):
    """Return the mean of the policy's normal distribution; its inputs are means, then deviations."""
    outputs = module.forward_inference({"obs": torch.as_tensor(observation)[None]})
    return outputs["action_dist_inputs"][0, :3].numpy()


env = gym.make(ENVIRONMENT, **KEYWORDS)
print(verdict(write_result(options.out, training, evaluate(act, env, options.episodes))))
env.close()
