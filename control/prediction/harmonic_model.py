"""A bias and harmonics of a few slow rhythms: the state that describes them, its motion in time, its derivatives."""

import cmath
from collections.abc import Iterator, Sequence
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
    power: float
    """Summed squares of all phasors, m^2."""


class HarmonicModel:
    """`y(t + s) = b + sum_j sum_k Re(z_jk exp(i k w_j s))`, with rhythms j and orders k = 1 ... harmonics[j].

    The state is `[b, w_1, Re z_11, Im z_11, Re z_12, ..., w_2, ...]`, in metres and rad/s. The phasors z turn with time, so
    that a phase is no state of its own; what is measured now is linear in the state, and only the turning is not.

    A state has about a dozen numbers: what goes through a single one is worked out in plain Python, number by number, which
    for so few is quicker than a chain of numpy's functions.
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
        # Places of the transition, as it lies in memory, that a turn by some seconds fills in, harmonic by harmonic.
        rows = (self.real, self.real, self.imaginary, self.imaginary, self.real, self.imaginary)
        columns = (self.real, self.imaginary, self.real, self.imaginary, owner, owner)
        turning = np.stack([row * self.size + column for row, column in zip(rows, columns, strict=True)], axis=-1)
        self._turning = turning.ravel()
        # How a phase that runs ahead moves the state, rhythm by rhythm.
        clocks = np.zeros((len(harmonics), self.size, self.size))
        clocks[self.rhythm, self.real, self.imaginary] = -self.order
        clocks[self.rhythm, self.imaginary, self.real] = self.order
        self._clocks = clocks.reshape(-1, self.size)

    def phasors(self, state: Array) -> NDArray[np.complex128]:
        """Return the phasors (n,) of a state."""
        return np.asarray(state[self.parts].view(np.complex128))

    def amplitudes(self, state: Array) -> Array:
        """Return the amplitude of each rhythm, (rhythms,), over all its harmonics: the root of their summed squares."""
        return np.asarray(np.sqrt((np.abs(self.phasors(state)) ** 2) @ self._member))

    def look_ahead(self, state: Array, seconds: float) -> Outlook:
        """Return value, velocity and gradient at a time after (or before) the state's."""
        value, velocity, power = float(state[0]), 0.0, 0.0
        gradient = [1.0]
        for rate, harmonics in self._turned(state, seconds):
            lever = 0.0
            parts: list[float] = []
            for order, turn, turned in harmonics:
                value += turned.real
                lever += order * turned.imag
                power += turned.real * turned.real + turned.imag * turned.imag
                parts += (turn.real, -turn.imag)
            velocity -= rate * lever
            gradient += (-seconds * lever, *parts)
        return Outlook(value=value, velocity=velocity, gradient=np.array(gradient), power=power)

    def value_ahead(self, state: Array, seconds: float) -> float:
        """Return the value alone at a time after (or before) the state's."""
        value = float(state[0])
        for _, harmonics in self._turned(state, seconds):
            for _, _, turned in harmonics:
                value += turned.real
        return value

    def _turned(self, state: Array, seconds: float) -> Iterator[tuple[float, Sequence[tuple[int, complex, complex]]]]:
        """Yield the rate of each rhythm and, of its harmonics, order, turn in some seconds, and phasor after that."""
        numbers, place = state.tolist(), 1
        for count in self.harmonics:
            rate = numbers[place]
            first = turn = cmath.rect(1.0, rate * seconds)
            harmonics = []
            for order in range(1, count + 1):
                phasor = complex(numbers[place + 2 * order - 1], numbers[place + 2 * order])
                harmonics.append((order, turn, phasor * turn))
                turn *= first
            yield rate, harmonics
            place += 1 + 2 * count

    def linear_table(self, turns: NDArray[np.complex128]) -> Array:
        """Return the derivatives (m, size) of the values at many times by the state, those by the rates still 0.

        The values are linear in bias and phasors, so that their derivatives by these depend on `turns` (m, n) alone.
        """
        jacobian = np.zeros((len(turns), self.size))
        jacobian[:, 0] = 1.0
        jacobian[:, self.parts] = turns.conj().view(np.float64)
        return jacobian

    def fill_table(self, jacobian: Array, state: Array, seconds: Array, turns: NDArray[np.complex128]) -> Array:
        """Put the derivatives by the rates into a `linear_table` of the same turns, in place, and return the values (m,).

        Args:
            jacobian: (m, size).
            state: (size,), with the rates that the turns were made of.
            seconds: (m,), times relative to the state's.
            turns: (m, n), what `turns` says of these rates and times.
        """
        turned = turns * self.phasors(state)
        jacobian[:, self.rates] = -seconds[:, None] * (turned.imag @ self._leads)
        return np.asarray(state[0] + turned.real.sum(axis=1))

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
        later = [float(state[0])]
        block: list[float] = []
        for rate, harmonics in self._turned(state, seconds):
            later.append(rate)
            for order, turn, turned in harmonics:
                later += (turned.real, turned.imag)
                lever = order * seconds
                block += (turn.real, -turn.imag, turn.imag, turn.real, -lever * turned.imag, lever * turned.real)
        transition = self._eye.copy()
        transition.reshape(-1)[self._turning] = block
        return np.array(later), transition

    def phase_directions(self, state: Array) -> Array:
        """Return how the state changes if each rhythm's clock runs ahead by a radian, (rhythms, size)."""
        return (self._clocks @ state).reshape(len(self.harmonics), self.size)


@cache
def harmonic_model(harmonics: tuple[int, ...]) -> HarmonicModel:
    """Return the one model with so many harmonics of each rhythm: it is laid out once, and all share it."""
    return HarmonicModel(harmonics)
