"""A bias and harmonics of a few slow rhythms: the state that describes them, its motion in time, its derivatives."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError

Array = NDArray[np.float64]


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
        """Lay out the state for rhythms with so many harmonics each; none at all leaves the bias.

        Raises:
            InvalidValueError: If a rhythm has no harmonic.
        """
        if any(count < 1 for count in harmonics):
            raise InvalidValueError("harmonics", harmonics, "1 or more for every rhythm")
        self.harmonics = harmonics
        starts = np.concatenate([[1], 1 + np.cumsum([1 + 2 * count for count in harmonics])]).astype(np.intp)
        self.size = int(starts[-1])
        self.rates = starts[:-1]
        """(rhythms,), where the angular frequencies lie in the state."""
        self.rhythm = np.repeat(np.arange(len(harmonics)), harmonics)
        """(n,), the rhythm of each harmonic."""
        self.order = np.concatenate([np.arange(1.0, count + 1.0) for count in harmonics] or [np.zeros(0)])
        """(n,), its order."""
        self.real = (starts[self.rhythm] + 2 * self.order - 1).astype(np.intp)
        """(n,), where the real parts of the phasors lie; the imaginary parts follow each."""
        self.imaginary = self.real + 1
        self.parts = np.stack([self.real, self.imaginary], axis=-1).ravel()
        """(2 n,), both of every phasor."""
        self._member = (self.rhythm[:, None] == np.arange(len(harmonics))).astype(np.float64)
        self._leads = self.order[:, None] * self._member
        owner = self.rates[self.rhythm]
        self._eye = np.eye(self.size)
        # Places of the transition, as it lies in memory, that a turn by some seconds fills in.
        rows = (self.real, self.real, self.imaginary, self.imaginary, self.real, self.imaginary)
        columns = (self.real, self.imaginary, self.real, self.imaginary, owner, owner)
        self._turning = np.stack([row * self.size + column for row, column in zip(rows, columns, strict=True)])

    def phasors(self, state: Array) -> NDArray[np.complex128]:
        """Return the phasors (n,) of a state."""
        return np.asarray(state[self.parts].view(np.complex128))

    def angular_rates(self, state: Array) -> Array:
        """Return the rate in rad/s of every harmonic's phasor, (n,)."""
        return np.asarray(self._leads @ state[self.rates])

    def amplitudes(self, state: Array) -> Array:
        """Return the amplitude of each rhythm, (rhythms,), over all its harmonics: the root of their summed squares."""
        return np.asarray(np.sqrt((np.abs(self.phasors(state)) ** 2) @ self._member))

    def look_ahead(self, state: Array, seconds: float) -> Outlook:
        """Return value, velocity and gradient at a time after (or before) the state's."""
        rates = self.angular_rates(state)
        turn = np.exp(1j * seconds * rates)
        turned = self.phasors(state) * turn
        gradient = np.empty(self.size)
        gradient[0] = 1.0
        gradient[self.parts] = turn.conj().view(np.float64)
        imaginary = turned.imag
        gradient[self.rates] = -seconds * (imaginary @ self._leads)
        return Outlook(value=float(state[0] + turned.real.sum()), velocity=-float(rates @ imaginary), gradient=gradient)

    def value_ahead(self, state: Array, seconds: float) -> float:
        """Return the value alone at a time after (or before) the state's."""
        turn = np.exp(1j * seconds * self.angular_rates(state))
        return float(state[0] + (self.phasors(state) * turn).real.sum())

    def table(self, state: Array, seconds: Array, turns: NDArray[np.complex128] | None = None) -> tuple[Array, Array]:
        """Return the values (m,) at many times relative to the state's, and their derivatives by the state (m, size).

        Args:
            state: (size,).
            seconds: (m,).
            turns: (m, n), what `turns` says of the same rates and times, if that is known.
        """
        turn = self.turns(state, seconds) if turns is None else turns
        turned = turn * self.phasors(state)
        jacobian = np.empty((len(seconds), self.size))
        jacobian[:, 0] = 1.0
        jacobian[:, self.parts] = turn.conj().view(np.float64)
        jacobian[:, self.rates] = -seconds[:, None] * (turned.imag @ self._leads)
        return state[0] + turned.real.sum(axis=1), jacobian

    def values(self, state: Array, seconds: Array) -> Array:
        """Return the values alone, (m,), at many times relative to the state's."""
        return np.asarray(state[0] + (self.turns(state, seconds) @ self.phasors(state)).real)

    def turns(self, state: Array, seconds: Array) -> NDArray[np.complex128]:
        """Return by what each phasor turns in each time, (m, n): of a rhythm's first harmonic, and powers of that."""
        turns = np.empty((len(seconds), len(self.order)), dtype=np.complex128)
        first = np.exp(1j * np.multiply.outer(seconds, state[self.rates]))
        column = 0
        for rhythm, count in enumerate(self.harmonics):
            turns[:, column] = first[:, rhythm]
            for _ in range(1, count):
                np.multiply(turns[:, column], first[:, rhythm], out=turns[:, column + 1])
                column += 1
            column += 1
        return turns

    def advance(self, state: Array, seconds: float) -> tuple[Array, Array]:
        """Return the state a while later, and its derivative by the present one, (size, size)."""
        turn = np.exp(1j * seconds * self.angular_rates(state))
        turned = self.phasors(state) * turn
        later = state.copy()
        later[self.parts] = turned.view(np.float64)
        block = np.empty(self._turning.shape)
        block[0] = block[3] = turn.real
        block[2] = turn.imag
        block[1] = -block[2]
        lever = seconds * self.order
        np.multiply(-lever, turned.imag, out=block[4])
        np.multiply(lever, turned.real, out=block[5])
        transition = self._eye.copy()
        transition.reshape(-1)[self._turning] = block
        return later, transition

    def phase_directions(self, state: Array) -> Array:
        """Return how the state changes if each rhythm's clock runs ahead by a radian, (rhythms, size)."""
        phasors = self.phasors(state)
        directions = np.zeros((len(self.harmonics), self.size))
        directions[self.rhythm, self.real] = -self.order * phasors.imag
        directions[self.rhythm, self.imaginary] = self.order * phasors.real
        return directions


@cache
def harmonic_model(harmonics: tuple[int, ...]) -> HarmonicModel:
    """Return the one model with so many harmonics of each rhythm: it is laid out once, and all share it."""
    return HarmonicModel(harmonics)
