"""Tasks and barriers of Pink
==========================

Add tasks, limits and barriers of Pink to the trocar-constrained controller of an arm.

The tip draws circles while the shaft stays on its trocar. That leaves one degree of freedom, the roll about the shaft, which a
task of our own turns; a barrier of Pink's keeps the tip above a plane that the circle would cross.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np
from pink import Task
from pink.barriers import PositionBarrier

from laploop.assets import INSTRUMENT
from laploop.control import SHAFT_TIP, ArmModel, RcmController, start_posture

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1000, help="control periods of 8 ms")
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()

PERIOD_S = 0.008


class RollTask(Task):
    """Turn the wrist's last joint, and with it the shaft, to an angle."""

    def __init__(self, angle_rad):
        """Ask for a little of the angle in every step; a radian weighs as much as 10 mm of the tip."""
        super().__init__(cost=10.0, gain=0.005)
        self.angle_rad = angle_rad

    def compute_error(self, configuration):
        """Return the angle that is left, (1,)."""
        return configuration.q[5:] - self.angle_rad

    def compute_jacobian(self, configuration):  # noqa: ARG002  Pink's signature
        """Return its derivative by the joint angles, (1, 6)."""
        return np.eye(6)[5:]

    def __repr__(self):
        """Show the target."""
        return f"RollTask(angle_rad={self.angle_rad})"


# An arm 0.6 m beside the patient holds the instrument; its shaft leans by 42 degrees and passes the wall 230 mm above the tip.
world_from_base = np.diag([-1.0, -1.0, 1.0, 1.0])
world_from_base[0, 3] = 0.6
lean = np.deg2rad(42.0)
along = np.array([-np.sin(lean), 0.0, -np.cos(lean)])
world_from_shaft = np.eye(4)
world_from_shaft[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], along), [0.0, 1.0, 0.0], along], axis=-1)
world_from_shaft[:3, 3] = tip = np.array([0.035, 0.01, 0.085])
arm = ArmModel(world_from_base, INSTRUMENT)
home = start_posture(arm, world_from_shaft, [0.0, -1.2, 1.2, -1.5, -1.5, 0.0])

floor_m = tip[2] - 0.006
roll = RollTask(home[5] + 1.0)
barrier = PositionBarrier(SHAFT_TIP, indices=[2], p_min=np.array([floor_m]), gain=10.0)
controller = RcmController(arm, tip - 0.23 * along, tasks=[roll], barriers=[barrier])
controller.reset(home)

radius_m, speed_mps = 0.010, 0.02
worst_rcm_m, limits, path = 0.0, set(), []
for step in range(options.steps):
    angle = speed_mps / radius_m * step * PERIOD_S
    controller.step(speed_mps * np.array([0.0, np.cos(angle), -np.sin(angle)]), PERIOD_S)
    worst_rcm_m = max(worst_rcm_m, controller.rcm_error_m)
    path.append(arm.tip_in_world(controller.q) - tip)
    limits.update(filter(None, controller.last_reason.split(", ")))
path = np.array(path)
lowest_m = path[:, 2].min() + tip[2]
print(f"trocar missed by at most {1e6 * worst_rcm_m:.2f} um")
print(f"shaft turned by {np.rad2deg(controller.q[5] - home[5]):.1f} of {np.rad2deg(roll.angle_rad - home[5]):.1f} degrees")
print(
    f"tip stayed {1e3 * (lowest_m - floor_m):+.3f} mm above the plane; held back by: {', '.join(sorted(limits)) or 'nothing'}"
)

figure, axis = plt.subplots(figsize=(4.5, 4.0), layout="constrained")
axis.plot(1e3 * path[:, 1], 1e3 * path[:, 2])
axis.axhline(1e3 * (floor_m - tip[2]), color="tab:red", label="plane")
axis.set(xlabel="y, mm", ylabel="z, mm", title="The way of the tip", aspect="equal")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
