"""The quadratic program of a step, put together in place and handed straight to its solver."""

from collections.abc import Sequence

import daqp
import numpy as np
from numpy.typing import NDArray
from pink import Configuration, Task
from pink.limits import Limit

Array = NDArray[np.float64]

_DAMPING = 1e-12
"""On every joint, as Pink has it by default."""

_NO_BOUND = -1e30
"""What DAQP takes for minus infinity."""

_EQUALITY = 5
"""What DAQP calls a row that must hold exactly."""


class StepQp:
    """Does what `pink.build_ik` and `qpsolvers.solve_problem` with DAQP do, to the bit, in a fraction of the time.

    The problem is still that of Pink's tasks and limits; left out are the copies, the checks and the layers in between. In a
    control loop that other work keeps pushing out of the processor's caches, each of them costs as much as the solver.
    """

    def __init__(self, joints: int, most_rows: int, primal_tolerance: float) -> None:
        """Make room.

        Args:
            joints: Number of unknowns.
            most_rows: Of all limits and equalities together.
            primal_tolerance: By how much the solver may leave a row unmet, in the row's unit.
        """
        self._damping = _DAMPING * np.eye(joints)
        self._hessian = np.empty((joints, joints))
        self._gradient = np.empty(joints)
        self._rows = np.empty((most_rows, joints))
        self._upper = np.empty(most_rows)
        self._lower = np.full(most_rows, _NO_BOUND)
        # Inequalities, then equalities: a window into this tells the solver how many there are of each.
        self._kinds = np.repeat(np.array([0, _EQUALITY], dtype=np.intc), most_rows)
        self._most_rows = most_rows
        self._tolerance = primal_tolerance
        self._inequalities = self._equalities = 0

    def assemble(
        self, configuration: Configuration, tasks: Sequence[Task], limits: Sequence[Limit], constraint: Task, dt: float
    ) -> None:
        """Put the problem together.

        Args:
            configuration: Where the step starts.
            tasks: Their weighted sum of squares is to be least.
            limits: Inequalities.
            constraint: A task that is to be met exactly.
            dt: Control period in seconds.
        """
        hessian, gradient = self._hessian, self._gradient
        hessian[:] = self._damping
        gradient[:] = 0.0
        for task in tasks:
            task_hessian, task_gradient = task.compute_qp_objective(configuration)
            hessian += task_hessian
            gradient += task_gradient
        rows, upper, begin = self._rows, self._upper, 0
        for limit in limits:
            inequality = limit.compute_qp_inequalities(configuration, dt)
            if inequality is not None:
                end = begin + len(inequality[1])
                rows[begin:end], upper[begin:end] = inequality
                begin = end
        error = constraint.compute_error(configuration)
        end = begin + len(error)
        rows[begin:end] = constraint.compute_jacobian(configuration)
        np.multiply(error, -constraint.gain, out=upper[begin:end])
        self._inequalities, self._equalities = begin, end - begin

    def solve(self) -> Array | None:
        """Return the step, (joints,), or None if there is none."""
        count, first = self._inequalities + self._equalities, self._most_rows - self._inequalities
        step, _, found, _ = daqp.solve(
            self._hessian,
            self._gradient,
            self._rows[:count],
            self._upper[:count],
            self._lower[:count],
            self._kinds[first : first + count],
            primal_tol=self._tolerance,
        )
        return np.asarray(step) if found > 0 and np.isfinite(step).all() else None

    def room(self, step: Array) -> Array:
        """Return what a step, (joints,), leaves of each inequality, (n,)."""
        count = self._inequalities
        return np.asarray(self._upper[:count] - self._rows[:count] @ step)
