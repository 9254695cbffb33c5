"""The UR5 of MuJoCo is the UR5 of Pinocchio."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from laploop.assets.laparoscope import SHAFT_TIP, build_laparoscope
from laploop.assets.shafts import LAPAROSCOPE
from laploop.assets.ur5 import ARMATURE, build_ur5
from laploop.assets.ur5_description import FLANGE, JOINT_NAMES, VELOCITY_GAIN_RATIO_S, urdf_path
from laploop.errors import InvalidValueError

# Two implementations of the same formulas in float64 on numbers of order 100.
AGREEMENT = 1e-9


def random_configurations(count):
    return np.random.default_rng(0).uniform(-np.pi, np.pi, size=(count, 6))


def mass_matrix(model, data):
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def test_kinematics_mass_matrix_and_gravity_agree_with_pinocchio():
    model = build_ur5(armature=0.0, actuated=False).compile()
    data = mujoco.MjData(model)
    pin_model = pin.buildModelFromUrdf(str(urdf_path()))
    pin_data = pin_model.createData()
    flange = pin_model.getFrameId(FLANGE)
    for q in random_configurations(100):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        pin.framesForwardKinematics(pin_model, pin_data, q)
        placement = pin_data.oMf[flange]
        np.testing.assert_allclose(data.body(FLANGE).xpos, placement.translation, rtol=0.0, atol=AGREEMENT)
        np.testing.assert_allclose(data.body(FLANGE).xmat.reshape(3, 3), placement.rotation, rtol=0.0, atol=AGREEMENT)
        upper = np.triu(pin.crba(pin_model, pin_data, q))
        np.testing.assert_allclose(np.triu(mass_matrix(model, data)), upper, rtol=0.0, atol=AGREEMENT)
        gravity = pin.computeGeneralizedGravity(pin_model, pin_data, q)
        np.testing.assert_allclose(data.qfrc_bias, gravity, rtol=0.0, atol=AGREEMENT)


def test_jacobian_of_the_flange_matches_finite_differences():
    model = build_ur5(actuated=False).compile()
    data = mujoco.MjData(model)
    step = 1e-6
    for q in random_configurations(5):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        jacobian = np.zeros((3, 6))
        mujoco.mj_jacBody(model, data, jacobian, None, model.body(FLANGE).id)
        for joint in range(6):
            ends = []
            for sign in (-1.0, 1.0):
                data.qpos[:] = q
                data.qpos[joint] += sign * step
                mujoco.mj_kinematics(model, data)
                ends.append(data.body(FLANGE).xpos.copy())
            # Central differences of metres: rounding 1e-16 / 1e-6 rad, curvature 1e-12.
            np.testing.assert_allclose((ends[1] - ends[0]) / (2.0 * step), jacobian[:, joint], atol=1e-8)


def test_armature_adds_to_the_diagonal_only():
    plain = build_ur5(armature=0.0, actuated=False).compile()
    geared = build_ur5(actuated=False).compile()
    matrices = []
    for model in (plain, geared):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        matrices.append(mass_matrix(model, data))
    np.testing.assert_allclose(matrices[1] - matrices[0], ARMATURE * np.eye(6), atol=1e-12)


def test_gravity_is_compensated_with_the_scope_on_the_flange():
    spec = build_ur5()
    spec.attach(build_laparoscope(), prefix="scope/", frame=spec.body(FLANGE).add_frame())
    model = spec.compile()
    data = mujoco.MjData(model)
    home = np.array([0.3, -1.2, 0.9, -0.5, 1.0, 0.2])
    data.qpos[:], data.ctrl[:] = home, home
    for _ in range(100):
        mujoco.mj_step(model, data)
    # Radians: what rounding leaves of torques of 50 N m over servos of 1e4 N m/rad.
    np.testing.assert_allclose(data.qpos, home, atol=1e-12)


def test_tip_frame_is_the_flange_moved_along_its_z_by_the_length_of_the_shaft():
    spec = build_ur5()
    spec.attach(build_laparoscope(), prefix="scope/", frame=spec.body(FLANGE).add_frame())
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, -1.2, 0.9, -0.5, 1.0, 0.2]
    mujoco.mj_forward(model, data)
    flange = data.body(FLANGE)
    expected = flange.xpos + LAPAROSCOPE.length_m * flange.xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(data.site(f"scope/{SHAFT_TIP}").xpos, expected, atol=1e-12)


def test_servos_are_ordered_as_the_joints_and_share_one_damping_ratio():
    model = build_ur5().compile()
    assert [model.actuator(index).name for index in range(model.nu)] == list(JOINT_NAMES)
    stiffness, damping = -model.actuator_biasprm[:, 1], -model.actuator_biasprm[:, 2]
    np.testing.assert_allclose(damping / stiffness, VELOCITY_GAIN_RATIO_S, rtol=1e-12)


def test_torque_limits_are_those_of_the_urdf():
    model = build_ur5().compile()
    np.testing.assert_array_equal(model.jnt_actfrcrange[:, 1], [150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
    assert model.jnt_actfrclimited.all()


def test_negative_armature_is_refused():
    with pytest.raises(InvalidValueError, match="armature is -1"):
        build_ur5(armature=-1.0)
