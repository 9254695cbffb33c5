"""Learn to touch a point of the tissue from the simulator's state, with proximal policy optimisation (PPO), on several cores.

Run it with `python examples/learning/ppo.py --out runs/ppo --workers 2`: each worker is a process of its own.
"""

import argparse
from pathlib import Path

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from laploop.studies import CurveCallback, evaluate, load_into, verdict, write_result

# The module in front of the colon is imported before the id is looked up, also in processes that start from nothing.
ENVIRONMENT, KEYWORDS = "laploop:laploop/Reach-v1", {"observation": "state", "fidelity": "fast"}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=40_000, help="decisions of 40 ms, of all workers")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/ppo"))
    parser.add_argument("--resume", action="store_true", help="go on from the policy in --out")
    options = parser.parse_args()

    many = options.workers > 1
    envs = make_vec_env(
        ENVIRONMENT,
        n_envs=options.workers,
        seed=options.seed,
        env_kwargs=KEYWORDS,
        vec_env_cls=SubprocVecEnv if many else DummyVecEnv,
        vec_env_kwargs={"start_method": "spawn"} if many else None,
    )

    network = {"net_arch": [64, 64], "log_std_init": -1.0}
    rollout = max(2, min(1024, options.steps) // options.workers)
    model = PPO(
        "MlpPolicy",
        envs,
        learning_rate=1e-3,
        n_steps=rollout,
        batch_size=min(64, rollout * options.workers),
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
    training = callback.training(method="ppo", environment=ENVIRONMENT.partition(":")[2], keywords=KEYWORDS, seed=options.seed)
    envs.close()

    # Now the mean of the policy instead of a sample, on seeds that training never used.
    env = gym.make(ENVIRONMENT, **KEYWORDS)
    scores = evaluate(lambda observation: model.predict(observation, deterministic=True)[0], env, options.episodes)
    print(verdict(write_result(options.out, training, scores)))
    env.close()


if __name__ == "__main__":
    main()
