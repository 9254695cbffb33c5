"""What a trocar does to the shaft in it: the wall pushes it back to its place, the seal rubs on it."""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from laploop.envs.theatre.arm import Arm
from laploop.errors import InvalidValueError, UnknownNameError, check_range

TrocarName = Literal["none", "lubricated", "dry"]
"""The named trocars, in the order in which they are listed to users."""

_LEAST_MASS_KG, _LEAST_MASS_ALONG_KG = 0.5, 4.0
"""Below the least inertia that either arm has against a push across its shaft in its port, 0.83 kg, and along it, 4.3 kg,
by `1 / max eig(J inv(M) J^T)` over postures within 0.3 rad of home."""


@dataclass(frozen=True, kw_only=True)
class TrocarConfig:
    """The abdominal wall around a trocar, and the seal in it.

    The wall's stiffness is that of a rigid pin in an elastic sheet that is held at its rim: `4 pi E t / ((1 + nu)(3 - nu)
    ln(R / a))`. With E = 22.5 to 42.5 kPa, measured in vivo under a pneumoperitoneum of 12 mmHg (Song et al., Surg Endosc
    2006;20:987), t = 30 mm of wall, nu = 0.5, a = 6 mm and R = 100 mm, that is 0.8 to 1.5 N/mm. The tension of the inflated
    wall, 12 mmHg times a radius of curvature of 0.2 m, adds `2 pi T / ln(R / a)` = 0.7 N/mm at most. 2 N/mm is their upper end.

    Friction is 0.25 to 8 N in trocars of 12 mm, depending on the seal, speed and tilt, and silicone oil takes three quarters
    of its peak (Proc IMechE H 2015;229:271). The lip of a seal bends before it slips; over how long a way is our estimate.
    """

    stiffness_n_m: float = 2000.0
    """Lateral force of the wall over the shaft's distance from its place; the reason why errors at the trocar cost force."""
    damping_ns_m: float = 20.0
    """Lateral force over lateral speed."""
    friction_n: float = 0.75
    """Force at which the shaft slides, along itself and in rotation (at its surface) together."""
    presliding_m: float = 0.0005
    """Way that the shaft gives under that force before it slides."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("stiffness_n_m", self.stiffness_n_m, 0.0, 20_000.0)
        check_range("damping_ns_m", self.damping_ns_m, 0.0, 100.0)
        check_range("friction_n", self.friction_n, 0.0, 20.0)
        check_range("presliding_m", self.presliding_m, 0.0001, 0.005)

    @classmethod
    def named(cls, name: str) -> "TrocarConfig":
        """Make one of the named trocars.

        `none` is a mere point in space, `lubricated` the default, `dry` the same wall with the greatest friction measured.

        Raises:
            UnknownNameError: If nobody knows the name.
        """
        if name not in get_args(TrocarName):
            raise UnknownNameError("trocar", name, get_args(TrocarName))
        if name == "none":
            return cls(stiffness_n_m=0.0, damping_ns_m=0.0, friction_n=0.0)
        return cls(friction_n=8.0) if name == "dry" else cls()

    @property
    def acts(self) -> bool:
        """Whether there is any force."""
        return max(self.stiffness_n_m, self.damping_ns_m, self.friction_n) > 0.0

    def check_timestep(self, timestep_s: float) -> None:
        """Check that the forces, which are those at the begin of a physics step, stay far from shaking the arm.

        A mass m on a spring k with damping c is stable under semi-implicit Euler steps h while `h^2 k + 2 h c < 4 m`; a
        quarter of that is allowed.

        Raises:
            InvalidValueError: If wall or seal is too stiff for the step.
        """
        for name, stiffness, damping, least_mass in (
            ("stiffness_n_m and damping_ns_m", self.stiffness_n_m, self.damping_ns_m, _LEAST_MASS_KG),
            ("friction_n over presliding_m", self.friction_n / self.presliding_m, 0.0, _LEAST_MASS_ALONG_KG),
        ):
            needed = timestep_s**2 * stiffness + 2.0 * timestep_s * damping
            if needed > least_mass:
                allowed = f"up to {least_mass:g} kg for step^2 stiffness + 2 step damping at steps of {timestep_s:g} s"
                raise InvalidValueError(name, round(needed, 4), allowed)


class Trocar:
    """One arm's trocar in a running simulation; deterministic, plain numbers, no state but the step before.

    With e the way from the port's place to the nearest point of the shaft's axis, the wall pushes that point with
    `-(stiffness e + damping e')`. The seal is a bristle of two components, way along the shaft and way of its surface
    around it, that bends with the shaft up to `presliding_m` and then slides: a spring with a slider, so that the shaft
    sticks under small forces, slides under `friction_n`, and never gets back more energy than it gave.
    """

    def __init__(self, config: TrocarConfig, arm: Arm, model: Any, data: Any) -> None:
        """Take an arm's shaft in a compiled model; `reset` comes before the first `apply`."""
        body = int(model.site_bodyid[arm.tip_site])
        self.config = config
        x, y, z = arm.trocar_in_world
        self._port = (float(x), float(y), float(z))
        self._radius_m = 0.5 * arm.shaft.diameter_m
        self._timestep_s = float(model.opt.timestep)
        self._bristle_n_m = config.friction_n / config.presliding_m
        # Views of MuJoCo's own memory, which stays where it is.
        self._tip = data.site_xpos[arm.tip_site]
        self._rotation = data.site_xmat[arm.tip_site]
        self._centre = data.xipos[body]
        self._wrench = data.xfrc_applied[body]
        self.reset()

    def reset(self) -> None:
        """Let the wall and the seal go slack where the shaft is now; kinematics must be fresh."""
        self.lateral_force_n = 0.0
        self.friction_force_n = 0.0
        self._along = self._around = 0.0
        self._rotation_before = self._rotation.tolist()
        self._offset_before, self._depth_before = self._place(self._tip.tolist(), self._rotation_before)

    def apply(self) -> None:
        """Put the port's force of the coming physics step on the shaft; kinematics must be fresh, as after `mj_step1`."""
        tip, rotation = self._tip.tolist(), self._rotation.tolist()
        offset, depth = self._place(tip, rotation)
        axis_x, axis_y, axis_z = rotation[2], rotation[5], rotation[8]

        rate = self.config.damping_ns_m / self._timestep_s
        stiffness = self.config.stiffness_n_m
        before = self._offset_before
        lateral_x = -stiffness * offset[0] - rate * (offset[0] - before[0])
        lateral_y = -stiffness * offset[1] - rate * (offset[1] - before[1])
        lateral_z = -stiffness * offset[2] - rate * (offset[2] - before[2])

        self._bend(depth - self._depth_before, self._radius_m * _turned(self._rotation_before, rotation))
        along = -self._bristle_n_m * self._along
        around = -self._bristle_n_m * self._around * self._radius_m

        force_x = lateral_x + along * axis_x
        force_y = lateral_y + along * axis_y
        force_z = lateral_z + along * axis_z
        centre = self._centre.tolist()
        arm_x = tip[0] - depth * axis_x - centre[0]
        arm_y = tip[1] - depth * axis_y - centre[1]
        arm_z = tip[2] - depth * axis_z - centre[2]
        self._wrench[:] = (
            force_x,
            force_y,
            force_z,
            arm_y * force_z - arm_z * force_y + around * axis_x,
            arm_z * force_x - arm_x * force_z + around * axis_y,
            arm_x * force_y - arm_y * force_x + around * axis_z,
        )
        self.lateral_force_n = math.sqrt(lateral_x**2 + lateral_y**2 + lateral_z**2)
        self.friction_force_n = abs(along)
        self._rotation_before, self._offset_before, self._depth_before = rotation, offset, depth

    def _place(self, tip: list[float], rotation: list[float]) -> tuple[tuple[float, float, float], float]:
        """Return the way from the port to the nearest point of the axis, and how deep the tip lies beyond that point."""
        axis_x, axis_y, axis_z = rotation[2], rotation[5], rotation[8]
        port = self._port
        x, y, z = tip[0] - port[0], tip[1] - port[1], tip[2] - port[2]
        depth = x * axis_x + y * axis_y + z * axis_z
        return (x - depth * axis_x, y - depth * axis_y, z - depth * axis_z), depth

    def _bend(self, along_m: float, around_m: float) -> None:
        """Carry the bristle with the shaft, and let it slide where it would bend too far."""
        self._along += along_m
        self._around += around_m
        bent = math.hypot(self._along, self._around)
        if bent > self.config.presliding_m:
            shrink = self.config.presliding_m / bent
            self._along *= shrink
            self._around *= shrink


def _turned(before: list[float], now: list[float]) -> float:
    """Return the small angle, rad, by which a frame turned about its own z axis; both rotations (9,), row by row."""
    x_on_y = now[0] * before[1] + now[3] * before[4] + now[6] * before[7]
    y_on_x = now[1] * before[0] + now[4] * before[3] + now[7] * before[6]
    return 0.5 * (x_on_y - y_on_x)
