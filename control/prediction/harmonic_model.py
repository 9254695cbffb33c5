"""A bias and harmonics of a few slow rhythms: the state that describes them, its motion in time, its derivatives."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from laploop.arrays import Array
from laploop.errors import InvalidValueError

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outlook:
    """What a state says of a time, and how that depends on the state."""

    value: float
    """Metres."""
    velocity: float
    """m/s."""
    gradient: Array
    """(size,), derivative of the value by the state."""


class HarmonicModel:
    """`y(t + s) = b + sum_j sum_k Re(z_jk exp(i k w_j s))`, with rhythms j and orders k = 1 ... harmonics[j].

    The state is `[b, w_1, Re z_11, Im z_11, Re z_12, ..., w_2, ...]`, in metres and rad/s. The phasors z turn with time, so
    that a phase is no state of its own; what is measured now is linear in the state, and only the turning is not.
    """

    def __init__(self, harmonics: tuple[int, ...]) -> None:
        """Lay out the state for rhythms with the given numbers of harmonics; none at all leaves the bias.

        Raises:
            InvalidValueError: If a rhythm has no harmonic.
        """
        if any(count < 1 for count in harmonics):
            raise InvalidValueError("harmonics", harmonics, "1 or more for every rhythm")
        self.harmonics = harmonics
        starts = np.cumsum([1, *(1 + 2 * count for count in harmonics)])
        self.size = int(starts[-1])
        self.rates = starts[:-1]
        """(rhythms,), where the angular frequencies lie in the state."""
        self.rhythm = np.repeat(np.arange(len(harmonics)), harmonics)
        """(n,), the rhythm of each harmonic."""
        self.order = np.concatenate([np.zeros(0), *(np.arange(1.0, count + 1.0) for count in harmonics)])
        """(n,), its order."""
        self.real = (starts[self.rhythm] + 2 * self.order - 1).astype(np.intp)
        """(n,), where the real parts of the phasors lie; the imaginary parts follow each."""
        self.imaginary = self.real + 1
        self._member = (self.rhythm[:, None] == np.arange(len(harmonics))).astype(np.float64)
        self._leads = self.order[:, None] * self._member

    def phasors(self, state: Array) -> ComplexArray:
        """Return the phasors (n,) of a state."""
        return np.asarray(state[self.real] + 1j * state[self.imaginary])

    def powers(self, state: Array) -> Array:
        """Return the summed squares of all phasors of each rhythm, (rhythms,), m^2."""
        squares = state[self.real] ** 2 + state[self.imaginary] ** 2
        return np.asarray(squares @ self._member)

    def turns(self, rates: Array, seconds: ArrayLike) -> ComplexArray:
        """Return by what each phasor turns in each time, (..., m, n), at angular frequencies (..., rhythms)."""
        angles = rates[..., None, self.rhythm] * self.order * np.atleast_1d(seconds)[:, None]
        return np.asarray(np.exp(1j * angles))

    def basis(self, turns: ComplexArray) -> Array:
        """Return the derivatives of the values by bias and phasors, (..., m, size), in columns; those of the rates are 0."""
        basis = np.zeros((*turns.shape[:-1], self.size))
        basis[..., 0] = 1.0
        basis[..., self.real] = turns.real
        basis[..., self.imaginary] = -turns.imag
        return basis

    def linearised(self, state: Array, seconds: ArrayLike) -> tuple[Array, Array]:
        """Return the values at many times relative to the state's, (m,), and their derivatives by the state, (m, size)."""
        turns = self.turns(state[self.rates], seconds)
        turned = turns * self.phasors(state)
        jacobian = self.basis(turns)
        jacobian[:, self.rates] = -np.atleast_1d(seconds)[:, None] * (turned.imag @ self._leads)
        return state[0] + turned.real.sum(axis=1), jacobian

    def values(self, state: Array, seconds: ArrayLike) -> Array:
        """Return the values at many times relative to the state's, (m,)."""
        return np.asarray(state[0] + (self.turns(state[self.rates], seconds) @ self.phasors(state)).real)

    def look_ahead(self, state: Array, seconds: float) -> Outlook:
        """Return value, velocity and gradient at a time after (or before) the state's."""
        turns = self.turns(state[self.rates], seconds)
        turned = turns[0] * self.phasors(state)
        levers = turned.imag @ self._leads
        gradient = self.basis(turns)[0]
        gradient[self.rates] = -seconds * levers
        return Outlook(
            value=float(state[0] + turned.real.sum()), velocity=-float(levers @ state[self.rates]), gradient=gradient
        )

    def advance(self, state: Array, seconds: float) -> tuple[Array, Array]:
        """Return the state a while later, and its derivative by the present one, (size, size)."""
        turn = self.turns(state[self.rates], seconds)[0]
        turned = turn * self.phasors(state)
        later = state.copy()
        later[self.real], later[self.imaginary] = turned.real, turned.imag
        transition = np.eye(self.size)
        transition[self.real, self.real] = transition[self.imaginary, self.imaginary] = turn.real
        transition[self.real, self.imaginary] = -turn.imag
        transition[self.imaginary, self.real] = turn.imag
        owner = self.rates[self.rhythm]
        transition[self.real, owner] = -self.order * seconds * turned.imag
        transition[self.imaginary, owner] = self.order * seconds * turned.real
        return later, transition

    def phase_directions(self, state: Array) -> Array:
        """Return how the state changes if each rhythm's clock runs ahead by a radian, (rhythms, size)."""
        directions = np.zeros((len(self.harmonics), self.size))
        directions[self.rhythm, self.real] = -self.order * state[self.imaginary]
        directions[self.rhythm, self.imaginary] = self.order * state[self.real]
        return directions


@cache
def harmonic_model(harmonics: tuple[int, ...]) -> HarmonicModel:
    """Return the one model with these numbers of harmonics: it is laid out once, and all share it."""
    return HarmonicModel(harmonics)
