"""Forces of a trocar on the shaft in it: the abdominal wall is a spring, the seal is friction."""

import math
from typing import Annotated, Any, Literal, get_args

from laploop.configuration import Field, configuration
from laploop.envs.theatre.arm import Arm
from laploop.errors import InvalidValueError, UnknownNameError

TrocarName = Literal["none", "lubricated", "dry"]
"""The named trocars, in the order in which they are listed to users."""

_LEAST_MASS_KG, _LEAST_MASS_ALONG_KG = 0.5, 4.0
"""Bounds below the smallest apparent mass of either arm at its port: 0.83 kg across the shaft, 4.3 kg along it, measured as
`1 / max eig(J inv(M) J^T)` over postures within 0.3 rad of home."""


@configuration
class TrocarConfig:
    """The abdominal wall around a trocar, and the seal in it.

    The wall's stiffness is that of a rigid pin in an elastic sheet that is held at its rim: `4 pi E t / ((1 + nu)(3 - nu)
    ln(R / a))`. With E = 22.5 to 42.5 kPa, measured in vivo under a pneumoperitoneum of 12 mmHg (Song et al., Surg Endosc
    2006;20:987), t = 30 mm of wall, nu = 0.5, a = 6 mm and R = 100 mm, that is 0.8 to 1.5 N/mm. The tension of the inflated
    wall, 12 mmHg times a radius of curvature of 0.2 m, adds `2 pi T / ln(R / a)` = 0.7 N/mm at most. 2 N/mm is their upper end.

    Friction is 0.25 to 8 N in trocars of 12 mm, depending on the seal, speed and tilt; silicone oil lowers its peak by three
    quarters (Proc IMechE H 2015;229:271). The lip of a seal bends before it slips; the distance is our estimate.
    """

    stiffness_n_m: Annotated[float, Field(ge=0.0, le=20_000.0)] = 2000.0
    """Lateral force of the wall per distance of the shaft from the port."""
    damping_ns_m: Annotated[float, Field(ge=0.0, le=100.0)] = 20.0
    """Lateral force per lateral speed."""
    friction_n: Annotated[float, Field(ge=0.0, le=20.0)] = 0.75
    """Force at which the shaft slides, along its axis and in rotation (at its surface) together."""
    presliding_m: Annotated[float, Field(ge=0.0001, le=0.005)] = 0.0005
    """Displacement under that force before the shaft slides."""

    @classmethod
    def named(cls, name: str) -> "TrocarConfig":
        """Make one of the named trocars.

        `none` is a point in space without force, `lubricated` the default, `dry` the same wall with the greatest friction
        measured.

        Raises:
            UnknownNameError: If there is no trocar of this name.
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

    def check_timestep(self, timestep_ns: int) -> None:
        """Check that the forces, held constant over each physics step, keep the arm stable.

        A mass m on a spring k with damping c is stable under semi-implicit Euler steps h while `h^2 k + 2 h c < 4 m`; a
        quarter of that is allowed.

        Raises:
            InvalidValueError: If wall or seal is too stiff for the step.
        """
        timestep_s = timestep_ns * 1e-9
        for name, stiffness, damping, least_mass in (
            ("stiffness_n_m and damping_ns_m", self.stiffness_n_m, self.damping_ns_m, _LEAST_MASS_KG),
            ("friction_n over presliding_m", self.friction_n / self.presliding_m, 0.0, _LEAST_MASS_ALONG_KG),
        ):
            needed = timestep_s**2 * stiffness + 2.0 * timestep_s * damping
            if needed > least_mass:
                allowed = f"up to {least_mass:g} kg for step^2 stiffness + 2 step damping at steps of {timestep_s:g} s"
                raise InvalidValueError(name, round(needed, 4), allowed)


_OF_PREVIOUS_STEP = {
    "lateral_force_n",
    "friction_force_n",
    "_along",
    "_around",
    "_rotation_before",
    "_offset_before",
    "_depth_before",
}


class Trocar:
    """One arm's trocar in a running simulation; deterministic, its only state that of the previous step.

    With e the vector from the port to the nearest point of the shaft's axis, the wall pushes that point with
    `-(stiffness e + damping e')`. The seal is a bristle with two components, displacement along the shaft and displacement of
    its surface around the axis, that bends with the shaft up to `presliding_m` and then slides: a spring in series with a
    slider, so that the shaft sticks under small forces, slides under `friction_n`, and never gains energy.

    Attributes:
        lateral_force_n: Force of the wall across the shaft in the last step.
        friction_force_n: Force of the seal along the shaft in the last step.
    """

    def __init__(self, config: TrocarConfig, arm: Arm, model: Any, data: Any) -> None:
        """Act on an arm's shaft in a compiled model; call `reset` before the first `apply`."""
        body = int(model.site_bodyid[arm.tip_site])
        self.config = config
        x, y, z = arm.trocar_in_world
        self._port = (float(x), float(y), float(z))
        self._radius_m = 0.5 * arm.shaft.diameter_m
        self._timestep_s = float(model.opt.timestep)
        self._bristle_n_m = config.friction_n / config.presliding_m
        # Views into MuJoCo's memory, which never moves.
        self._tip = data.site_xpos[arm.tip_site]
        self._rotation = data.site_xmat[arm.tip_site]
        self._centre = data.xipos[body]
        self._wrench = data.xfrc_applied[body]
        self.reset()

    def reset(self) -> None:
        """Relax wall and seal at the shaft's present pose; kinematics must be fresh."""
        self.lateral_force_n = 0.0
        self.friction_force_n = 0.0
        self._along = self._around = 0.0
        self._rotation_before = self._rotation.tolist()
        self._offset_before, self._depth_before = self._place(self._tip.tolist(), self._rotation_before)

    def get_state(self) -> dict[str, Any]:
        """Return what the previous step has left."""
        return {name: value for name, value in vars(self).items() if name in _OF_PREVIOUS_STEP}

    def set_state(self, state: dict[str, Any]) -> None:
        """Take over what `get_state` has returned."""
        vars(self).update(state)

    def apply(self) -> None:
        """Apply the port's force on the shaft for the coming physics step; kinematics must be fresh, as after `mj_step1`."""
        tip, rotation = self._tip.tolist(), self._rotation.tolist()
        offset, depth = self._place(tip, rotation)
        axis = rotation[2], rotation[5], rotation[8]

        rate = self.config.damping_ns_m / self._timestep_s
        stiffness = self.config.stiffness_n_m
        x, y, z = (-stiffness * now - rate * (now - before) for now, before in zip(offset, self._offset_before, strict=True))

        self._bend(depth - self._depth_before, self._radius_m * _turned(self._rotation_before, rotation))
        along = -self._bristle_n_m * self._along
        around = -self._bristle_n_m * self._around * self._radius_m

        force = x + along * axis[0], y + along * axis[1], z + along * axis[2]
        lever = [t - depth * a - c for t, a, c in zip(tip, axis, self._centre.tolist(), strict=True)]
        self._wrench[:] = (
            *force,
            lever[1] * force[2] - lever[2] * force[1] + around * axis[0],
            lever[2] * force[0] - lever[0] * force[2] + around * axis[1],
            lever[0] * force[1] - lever[1] * force[0] + around * axis[2],
        )
        self.lateral_force_n = math.sqrt(x**2 + y**2 + z**2)
        self.friction_force_n = abs(along)
        self._rotation_before, self._offset_before, self._depth_before = rotation, offset, depth

    def _place(self, tip: list[float], rotation: list[float]) -> tuple[tuple[float, float, float], float]:
        """Return the vector from the port to the nearest point of the axis, and the distance of the tip beyond it, metres."""
        axis_x, axis_y, axis_z = rotation[2], rotation[5], rotation[8]
        port = self._port
        x, y, z = tip[0] - port[0], tip[1] - port[1], tip[2] - port[2]
        depth = x * axis_x + y * axis_y + z * axis_z
        return (x - depth * axis_x, y - depth * axis_y, z - depth * axis_z), depth

    def _bend(self, along_m: float, around_m: float) -> None:
        """Bend the bristle with the shaft; let it slide beyond `presliding_m`."""
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
