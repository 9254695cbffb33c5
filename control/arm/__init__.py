"""One arm: its kinematics, its trocar constraint, and the QP that turns a tip velocity into joint velocities."""
