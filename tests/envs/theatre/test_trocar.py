"""What wall and seal do to a shaft: by hand on a lone shaft, and to the arms in the theatre."""

import itertools
import math

import mujoco
import numpy as np
import pytest

from laploop.assets.shafts import Shaft
from laploop.envs.loop.config import LoopConfig
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.envs.theatre.trocar import Trocar, TrocarConfig
from laploop.errors import InvalidValueError, UnknownNameError

STEP_S = 0.002
RADIUS_M = 0.004
PORT = np.array([0.02, -0.01, 0.10])
WALL = TrocarConfig(friction_n=0.0, damping_ns_m=0.0)
SEAL = TrocarConfig(stiffness_n_m=0.0, damping_ns_m=0.0)
SHAFT = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="shaft" pos=".02 -.01 0">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 -1"/>
      <joint name="roll" axis="0 0 -1"/>
      <geom type="cylinder" size=".004 .15" pos="0 0 .15" mass="1"/>
      <site name="tip" quat="0 1 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A shaft of 1 kg that points down through its port, 0.1 m above its tip; z and roll are those of the shaft's own frame."""


class LoneShaft:
    """A shaft without an arm, that is put somewhere or left to itself."""

    def __init__(self, config):
        self.model = mujoco.MjModel.from_xml_string(SHAFT)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        arm = Arm(
            name="arm",
            shaft=Shaft(length_m=0.3, diameter_m=2.0 * RADIUS_M, tip_radius_m=0.0),
            world_from_base=np.eye(4),
            trocar_in_world=PORT,
            home_q=np.zeros(4),
            qpos_indices=np.arange(4),
            dof_indices=np.arange(4),
            actuator_indices=np.arange(0),
            tip_site=0,
        )
        self.trocar = Trocar(config, arm, self.model, self.data)

    def put(self, x=0.0, y=0.0, z=0.0, roll=0.0):
        """Put the shaft somewhere; return the force and the torque about its middle."""
        self.data.qpos[:] = x, y, z, roll
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        self.trocar.apply()
        return self.data.xfrc_applied[1, :3].copy(), self.data.xfrc_applied[1, 3:].copy()

    def run(self, seconds, pull_n=0.0):
        """Leave the shaft to itself under a constant pull along it; return positions, (steps, 4)."""
        self.data.qfrc_applied[2] = pull_n
        places = []
        for _ in range(round(seconds / STEP_S)):
            mujoco.mj_step1(self.model, self.data)
            self.trocar.apply()
            mujoco.mj_step2(self.model, self.data)
            places.append(self.data.qpos.copy())
        return np.array(places)


def test_wall_pushes_back_with_stiffness_times_offset_at_the_port():
    shaft = LoneShaft(WALL)
    force, torque = shaft.put(x=0.001, y=-0.0005, z=0.03)
    # 2 N/mm times 1 and -0.5 mm, and nothing along the shaft.
    np.testing.assert_allclose(force, [-2.0, 1.0, 0.0], atol=1e-12)
    # The tip is 130 mm below the port, the middle of the shaft 150 mm above the tip: the force attacks 20 mm below the middle.
    np.testing.assert_allclose(torque, np.cross([0.0, 0.0, -0.02], force), atol=1e-12)
    assert shaft.trocar.lateral_force_n == pytest.approx(math.sqrt(5.0))
    assert shaft.trocar.friction_force_n == 0.0


def test_wall_damps_sideways_motion_only():
    shaft = LoneShaft(TrocarConfig(stiffness_n_m=0.0, damping_ns_m=20.0, friction_n=0.0))
    # 0.1 mm in a step of 2 ms is 50 mm/s, which costs 1 N.
    np.testing.assert_allclose(shaft.put(x=0.0001, z=0.001, roll=0.1)[0], [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(shaft.put(x=0.0001, z=0.002, roll=0.2)[0], np.zeros(3), atol=1e-12)


def test_steady_sliding_costs_the_friction_and_opposes_the_motion():
    shaft = LoneShaft(TrocarConfig(friction_n=3.0))
    into = [shaft.put(z=depth)[0][2] for depth in np.arange(1, 200) * 2e-5]
    back = [shaft.put(z=depth)[0][2] for depth in np.arange(199, 0, -1) * 2e-5]
    # The shaft points down: it goes down into the patient, friction holds it up. The seal gives by 0.5 mm, 25 steps.
    assert np.all(np.diff(into[:25]) > 0.0)
    np.testing.assert_allclose(into[25:], 3.0, atol=1e-12)
    np.testing.assert_allclose(back[51:], -3.0, atol=1e-12)
    assert shaft.trocar.friction_force_n == pytest.approx(3.0)


def test_turning_and_sliding_share_the_friction():
    shaft = LoneShaft(SEAL)
    for step in range(1, 2000):
        # The surface goes as far around as the shaft goes along.
        force, torque = shaft.put(z=step * 1e-5, roll=step * 1e-5 / RADIUS_M)
    part = 0.75 / math.sqrt(2.0)
    np.testing.assert_allclose(force, [0.0, 0.0, part], atol=1e-6)
    np.testing.assert_allclose(torque, [0.0, 0.0, part * RADIUS_M], atol=1e-9)


def test_shaft_sticks_under_less_than_the_friction_and_slides_under_more():
    places = LoneShaft(SEAL).run(1.0, pull_n=0.5)[:, 2]
    # 0.5 N bend the seal by a third of a millimetre; without damping, the shaft swings to twice that or until it slips a bit.
    assert 0.0 < places.min() < places.max() < 0.001
    assert np.ptp(places[250:]) < 0.001
    assert LoneShaft(SEAL).run(1.0, pull_n=1.0)[-1, 2] > 0.1


def test_closed_ways_give_back_no_energy():
    angles = np.linspace(0.0, 2.0 * np.pi, 2001)
    for config, lost_j in ((WALL, 0.0), (SEAL, 4.0 * 0.75 * (0.01 - 0.0005))):
        shaft = LoneShaft(config)
        work = []
        for _ in range(2):
            total, force_before, place_before = 0.0, None, None
            for angle in angles:
                place = np.array([0.002 * np.sin(angle), 0.001 * np.cos(2.0 * angle), 0.01 * np.sin(angle)])
                # The joint's z goes down.
                force = shaft.put(*place)[0] * [1.0, 1.0, -1.0]
                if force_before is not None:
                    total += float(0.5 * (force + force_before) @ (place - place_before))
                force_before, place_before = force, place
            work.append(total)
        # Joules, of the second round: a spring gives all back, a slider loses its loop of 2 F by 2 (A - presliding). Chords of
        # a smooth curve in 2000 pieces are exact to a millionth, the corners of the loop to a thousandth.
        assert work[1] == pytest.approx(-lost_j, rel=2e-3, abs=1e-9)


def test_a_shaft_left_to_itself_comes_to_rest_and_never_swings_farther():
    shaft = LoneShaft(TrocarConfig())
    shaft.data.qpos[:] = 0.002, -0.001, 0.0, 0.0
    shaft.data.qvel[:] = 0.0, 0.0, 0.05, 1.0
    places = shaft.run(2.0)
    # Metres; the first swing of a semi-implicit step may pass by a few percent.
    assert np.abs(places[:, 0]).max() < 0.0021
    assert np.abs(places[-100:, :2]).max() < 1e-6
    # 50 mm/s of 1 kg are 1.25 mJ, which 0.75 N take up in 1.7 mm and half of what the seal gives.
    assert places[:, 2].max() < 0.0025


def test_named_trocars_lie_within_what_was_measured():
    assert not TrocarConfig.named("none").acts
    assert TrocarConfig.named("lubricated") == TrocarConfig()
    assert 0.25 <= TrocarConfig().friction_n <= TrocarConfig.named("dry").friction_n <= 8.0
    with pytest.raises(UnknownNameError, match="available: dry, lubricated, none"):
        TrocarConfig.named("rusty")


@pytest.mark.parametrize(
    ("field", "value"),
    [("stiffness_n_m", -1.0), ("damping_ns_m", 1e4), ("friction_n", math.nan), ("friction_n", 21.0), ("presliding_m", 0.0)],
)
def test_impossible_trocars_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TrocarConfig(**{field: value})


def test_trocars_that_would_shake_the_arm_at_its_time_step_are_refused():
    stiff = TrocarConfig(stiffness_n_m=20_000.0, damping_ns_m=100.0)
    LoopConfig(theatre=TheatreConfig(trocar=stiff))
    with pytest.raises(InvalidValueError, match=r"theatre\.trocar\.stiffness_n_m and damping_ns_m"):
        LoopConfig(theatre=TheatreConfig(trocar=stiff), physics_hz=250.0)
    rubbing = TheatreConfig(trocar=TrocarConfig(friction_n=20.0, presliding_m=0.0001))
    with pytest.raises(InvalidValueError, match=r"trocar\.friction_n over presliding_m"):
        Theatre(rubbing, ClockRates(physics_hz=200.0, control_hz=100.0, camera_hz=20.0))


@pytest.fixture(scope="module")
def theatre():
    return Theatre(TheatreConfig(seed=3))


def test_a_theatre_starts_without_a_force_at_its_ports(theatre):
    theatre.reset()
    for _ in range(10):
        theatre.step()
    for arm in theatre.arms:
        # Newtons: 2 N/mm times the 1e-9 m of the start posture.
        assert theatre.port_force_n(arm) < 1e-5
        assert theatre.port_friction_n(arm) < 1e-5


def test_port_force_rises_with_the_error_at_the_trocar_and_the_tip_feels_nothing(theatre):
    arm, camera_arm = theatre.tool_arm, theatre.camera_arm
    pushed = []
    for turn in (0.0, 0.002, 0.004, 0.008):
        theatre.reset()
        theatre.set_joint_targets(arm, arm.home_q + [0.0, 0.0, 0.0, 0.0, turn, 0.0])
        for _ in range(100):
            theatre.step()
        # Newtons: at rest, what was measured in the last step is the stiffness times the error.
        assert theatre.port_force_n(arm) == pytest.approx(2000.0 * theatre.rcm_error_m(arm), rel=1e-3, abs=1e-5)
        assert theatre.port_force_n(camera_arm) < 1e-5
        assert not theatre.contact_force_in_world().any()
        pushed.append(theatre.port_force_n(arm))
    assert np.all(np.diff(pushed) > 0.5)


def test_forces_at_the_ports_reach_the_joints(theatre):
    arm = theatre.tool_arm
    theatre.reset()
    theatre.set_joint_targets(arm, arm.home_q + [0.0, 0.0, 0.0, 0.0, 0.01, 0.0])
    for _ in range(200):
        theatre.step()
    data, model = theatre.data, theatre.model
    wrench = data.xfrc_applied[model.site_bodyid[arm.tip_site]]
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian[:3], jacobian[3:], model.site_bodyid[arm.tip_site])
    # N m, at rest: the servos bear what wall and seal put on the shaft, up to 10 N at up to a metre.
    np.testing.assert_allclose(
        -data.qfrc_actuator[arm.dof_indices], (jacobian.T @ wrench)[arm.dof_indices], rtol=1e-2, atol=2e-3
    )


def test_two_runs_agree_to_the_bit_whoever_looks(theatre):
    arm = theatre.tool_arm
    runs = []
    for looks in (False, True):
        theatre.reset()
        trace = []
        for step in range(80):
            if step % 4 == 0:
                turn = 0.02 * math.sin(0.1 * step)
                theatre.set_joint_targets(arm, arm.home_q + [turn, 0.0, 0.0, 0.0, 0.0, turn])
            theatre.step()
            if looks:
                theatre.refresh()
            trace.append((theatre.port_force_n(arm), theatre.port_friction_n(arm)))
        runs.append((trace, theatre.data.qpos.copy()))
    assert runs[0][0] == runs[1][0]
    assert max(friction for _, friction in runs[0][0]) > 0.1
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


def test_episodes_report_the_worst_force_at_each_port(task_env):
    ports = []
    for trocar in (TrocarConfig(), TrocarConfig.named("none")):
        env = task_env("track", observation_mode="state", trocar=trocar)
        env.reset(seed=3)
        infos = [env.step(np.array([0.05, 0.0, 0.0], np.float32))[-1] for _ in range(5)]
        ports.append([info["port_force_n"] | {"seal": info["port_friction_n"]["tool"]} for info in infos])
    with_wall, without = ports
    assert all(set(port) == {"camera", "tool", "seal"} for port in itertools.chain(*ports))
    assert with_wall[-1]["tool"] > 1e-4
    assert with_wall[-1]["camera"] < 1e-5
    assert with_wall[-1]["seal"] > 0.05
    assert not any(any(port.values()) for port in without)
