r"""Learn to touch a point of the tissue from demonstrations alone: behaviour cloning of depth maps and state, in plain torch.

The scripted controller shows how it is done, led off its path now and then so that the data hold how it finds back:

    laploop demonstrate --task reach --observation depth+state --fidelity fast --perception oracle --episodes 200 \
        --out runs/demonstrations
    python examples/learning/behaviour_cloning.py --data runs/demonstrations --out runs/cloning
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import laploop  # noqa: F401  registers the environments
from laploop.errors import LaploopError
from laploop.studies import Curve, Training, evaluate, open_demonstrations, save_policy, verdict, write_result

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--data", type=Path, default=Path("runs/demonstrations"), help="what `laploop demonstrate` wrote")
parser.add_argument("--steps", type=int, default=3000, help="batches of 64 decisions")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
parser.add_argument("--out", type=Path, default=Path("runs/cloning"))
options = parser.parse_args()

ENVIRONMENT = "laploop/Reach-v1"
KEYWORDS = {"observation": "depth+state", "perception": "oracle", "fidelity": "fast"}
DEMONSTRATE = "laploop demonstrate --task reach --observation depth+state --fidelity fast --perception oracle --episodes 200"
EVERY = 4  # of the rows and columns of a map: 64 x 64 are enough to see where the tissue is


class DepthStatePolicy(nn.Module):
    """Three convolutions look at the map; what they find and the state decide on an action."""

    def __init__(self, state_size):
        super().__init__()
        self.look = nn.Sequential(
            nn.Conv2d(1, 8, 5, stride=2), nn.ReLU(),
            nn.Conv2d(8, 16, 3, stride=2), nn.ReLU(),
            nn.Conv2d(16, 16, 3, stride=2), nn.ReLU(),
            nn.Flatten(), nn.Linear(16 * 6 * 6, 32), nn.ReLU(),
        )  # fmt: skip
        self.decide = nn.Sequential(
            nn.Linear(32 + state_size, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 3)
        )

    def forward(self, depth, state):
        """Take maps (n, 64, 64) of 8 bits and states (n, state_size); return actions (n, 3) from -1 to 1."""
        seen = self.look(depth[:, None].float() / 255.0)
        return torch.tanh(self.decide(torch.cat([seen, state], dim=1)))


def shrunk(depth):
    """Return images (..., 256, 256, 1) as (..., 64, 64)."""
    return torch.as_tensor(np.ascontiguousarray(depth[..., ::EVERY, ::EVERY, 0]))


torch.manual_seed(options.seed)
depths, states, wanted = [], [], []
try:
    data = open_demonstrations(options.data)
    if (made := (data.card.environment, data.card.keywords)) != (ENVIRONMENT, KEYWORDS):
        parser.error(f"{options.data} shows {made}, not {(ENVIRONMENT, KEYWORDS)}; make it with\n  {DEMONSTRATE} --out DIR")
    for episode in map(data.episode, range(data.count)):
        # What the expert would have done, not what was done where it was led off its path; the end is followed by no decision.
        decisions = len(episode.expert_actions)
        depths.append(shrunk(episode.observations["depth"][:decisions]))
        states.append(torch.tensor(episode.observations["state"][:decisions]))
        wanted.append(torch.tensor(episode.expert_actions))
except LaploopError as error:
    parser.error(f"{error}\n  {DEMONSTRATE} --out DIR")
depths, states, wanted = torch.cat(depths), torch.cat(states), torch.cat(wanted)
print(f"{data.count} episodes, {len(wanted)} decisions")

policy = DepthStatePolicy(states.shape[1])
optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(options.steps, 1))
curve, losses = Curve(options.out), []
for step in range(1, options.steps + 1):
    batch = torch.randint(len(wanted), (64,))
    loss = nn.functional.smooth_l1_loss(policy(depths[batch], states[batch]), wanted[batch], beta=0.1)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()
    losses.append(loss.item())
    if step % 100 == 0 or step == options.steps:
        # The curve of a cloned policy is that of its loss, with its sign turned.
        curve.add(steps=step, total_return=-float(np.mean(losses)), length=len(losses), success=float("nan"))
        print(f"{step:6d} batches, loss {np.mean(losses):.4f}")
        losses = []
curve.write()
save_policy(policy, options.out, {"kind": "DepthStatePolicy", "state_size": states.shape[1]})
training = Training(
    method="behaviour cloning",
    environment=ENVIRONMENT,
    keywords=KEYWORDS,
    seed=options.seed,
    steps=options.steps,
    wall_s=curve.wall_s,
    cpu_s=curve.cpu_s,
)

policy.eval()


@torch.no_grad()
def act(observation):
    """Return the action for an observation."""
    return policy(shrunk(observation["depth"])[None], torch.as_tensor(observation["state"])[None])[0].numpy()


env = gym.make(ENVIRONMENT, **KEYWORDS)
print(verdict(write_result(options.out, training, evaluate(act, env, options.episodes))))
env.close()
