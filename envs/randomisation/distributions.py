"""Distributions of a number or a choice, as a file names them: `{uniform = [3000, 12000]}`."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import JsonValue

from laploop.envs.composer_modules import composer_module
from laploop.errors import InvalidValueError, UnknownNameError

_LARGEST = 1e300

CUT = 3.0
"""Standard deviations at which the tails of a normal and a log-normal distribution are cut, so that they have bounds."""


class Distribution(ABC):
    """What a field may be, drawn at a width: at 1 as it is given, below nearer to the field's nominal value.

    The width scales the distance of both ends from the nominal value; one that is None, or not a number, counts as the middle.
    """

    name: ClassVar[str]
    """In a file."""
    form: ClassVar[str]
    """Of the parameters, for messages."""

    def __init__(self, parameters: Sequence[Any]) -> None:
        """Take the parameters; raises an InvalidValueError if there are too few or many, or one is not allowed."""
        self.parameters = tuple(parameters)
        if not self._is_allowed():
            raise InvalidValueError(self.name, list(parameters), self.form)

    @property
    @abstractmethod
    def samples(self) -> tuple[JsonValue, ...]:
        """Values that stand for all: the smallest and the largest, or all choices."""

    @abstractmethod
    def draw(self, state: np.random.RandomState, nominal: JsonValue, width: float) -> JsonValue:
        """Draw a value; how many numbers of `state` that takes depends on neither nominal value nor width."""

    @property
    def plain(self) -> dict[str, JsonValue]:
        """As a file has it."""
        return {self.name: list(self.parameters)}

    @abstractmethod
    def _is_allowed(self) -> bool:
        """Return whether the parameters are those of this distribution."""


class _Numbers(Distribution):
    """Two parameters, both finite numbers."""

    @property
    def samples(self) -> tuple[JsonValue, ...]:
        """The ends."""
        return self._ends()

    @abstractmethod
    def _ends(self) -> tuple[float, float]:
        """Return the smallest and the largest value."""

    def _is_allowed(self) -> bool:
        return len(self.parameters) == 2 and all(_is_number(one) for one in self.parameters) and self._is_ordered()

    @abstractmethod
    def _is_ordered(self) -> bool:
        """Return whether the two numbers make a distribution."""


class _Range(_Numbers):
    """The parameters are the ends."""

    def draw(self, state: np.random.RandomState, nominal: JsonValue, width: float) -> JsonValue:
        """Draw from the range between the ends, moved towards the nominal value."""
        low, high = self._ends()
        middle = float(nominal) if isinstance(nominal, int | float) else 0.5 * (low + high)
        return self._drawn(middle + width * (low - middle), middle + width * (high - middle), state)

    def _is_ordered(self) -> bool:
        return bool(self.parameters[0] < self.parameters[1])

    def _ends(self) -> tuple[float, float]:
        low, high = self.parameters
        return float(low), float(high)

    @abstractmethod
    def _drawn(self, low: float, high: float, state: np.random.RandomState) -> JsonValue:
        """Draw between two ends."""


class Uniform(_Range):
    """Evenly between two numbers."""

    name = "uniform"
    form = "two finite numbers, the smaller first"

    def _drawn(self, low: float, high: float, state: np.random.RandomState) -> JsonValue:
        return _drawn_from("Uniform", (low, high), state)


class LogUniform(_Range):
    """Evenly in the logarithm, between two positive numbers."""

    name = "loguniform"
    form = "two finite numbers above 0, the smaller first"

    def _is_ordered(self) -> bool:
        return bool(0.0 < self.parameters[0] < self.parameters[1])

    def _drawn(self, low: float, high: float, state: np.random.RandomState) -> JsonValue:
        # Rounding must not lead beyond the ends, which the field's bounds may be.
        return float(np.clip(math.exp(_drawn_from("Uniform", (math.log(low), math.log(high)), state)), low, high))


class Integers(_Range):
    """Evenly among the integers between two, both included."""

    name = "integers"
    form = "two integers, the smaller first"

    @property
    def samples(self) -> tuple[JsonValue, ...]:
        """The ends, as integers."""
        return self.parameters

    def _is_ordered(self) -> bool:
        return all(isinstance(one, int) for one in self.parameters) and super()._is_ordered()

    def _drawn(self, low: float, high: float, state: np.random.RandomState) -> JsonValue:
        return int(_drawn_from("UniformInteger", (round(low), round(high) + 1), state))


class Normal(_Numbers):
    """A mean and a standard deviation, cut at `CUT` of them."""

    name = "normal"
    form = "a finite mean and a standard deviation above 0"

    def draw(self, state: np.random.RandomState, nominal: JsonValue, width: float) -> JsonValue:
        """Draw around the mean, moved towards the nominal value."""
        mean, deviation = (float(one) for one in self.parameters)
        middle = float(nominal) if isinstance(nominal, int | float) else mean
        standard = np.clip(_drawn_from("Normal", (0.0, 1.0), state), -CUT, CUT)
        return float(middle + width * (mean + deviation * standard - middle))

    def _ends(self) -> tuple[float, float]:
        mean, deviation = self.parameters
        return float(mean - CUT * deviation), float(mean + CUT * deviation)

    def _is_ordered(self) -> bool:
        return bool(self.parameters[1] > 0.0)


class LogNormal(_Numbers):
    """A median and the standard deviation of the logarithm, cut at `CUT` of them."""

    name = "lognormal"
    form = "a median above 0 and a standard deviation of the logarithm above 0, at most 3"

    def draw(self, state: np.random.RandomState, nominal: JsonValue, width: float) -> JsonValue:
        """Draw around the median, moved towards the nominal value."""
        median, sigma = (float(one) for one in self.parameters)
        middle = float(nominal) if isinstance(nominal, int | float) else median
        standard = np.clip(_drawn_from("Normal", (0.0, 1.0), state), -CUT, CUT)
        return float(middle + width * (median * math.exp(sigma * standard) - middle))

    def _ends(self) -> tuple[float, float]:
        median, sigma = self.parameters
        return float(median * math.exp(-CUT * sigma)), float(median * math.exp(CUT * sigma))

    def _is_ordered(self) -> bool:
        median, sigma = self.parameters
        return bool(median > 0.0 and 0.0 < sigma <= 3.0)


class Choice(Distribution):
    """Evenly among values of any kind; the width is the probability not to keep the nominal one."""

    name = "choice"
    form = "a list of at least one value, numbers finite"

    @property
    def samples(self) -> tuple[JsonValue, ...]:
        """All values."""
        return self.parameters

    def draw(self, state: np.random.RandomState, nominal: JsonValue, width: float) -> JsonValue:
        """Draw one of the values, or keep the nominal one."""
        kept = _drawn_from("Uniform", (0.0, 1.0), state) >= width
        # An index, as values of different kinds do not make an array.
        index = int(_drawn_from("UniformInteger", (0, len(self.parameters)), state))
        chosen: JsonValue = self.parameters[index]
        return nominal if kept else chosen

    def _is_allowed(self) -> bool:
        return bool(self.parameters) and all(_is_finite(one) for one in self.parameters)


KINDS: Mapping[str, type[Distribution]] = {
    kind.name: kind for kind in (Uniform, LogUniform, Normal, LogNormal, Integers, Choice)
}
"""By name."""


def distribution_of(plain: object) -> Distribution:
    """Return the distribution that a table of one entry, its name and its parameters, describes.

    Raises:
        UnknownNameError: If there is no such distribution.
        InvalidValueError: If it is no such table, or a parameter is not allowed.
    """
    if not isinstance(plain, Mapping) or len(plain) != 1:
        raise InvalidValueError("distribution", plain, "a table such as {uniform = [1.0, 2.0]}")
    ((name, parameters),) = plain.items()
    if name not in KINDS:
        raise UnknownNameError("distribution", name, KINDS)
    kind = KINDS[name]
    if not isinstance(parameters, list | tuple):
        raise InvalidValueError(name, parameters, kind.form)
    return kind(parameters)


def _drawn_from(kind: str, parameters: tuple[float, float], state: np.random.RandomState) -> float:
    """Draw from one of dm_control's distributions."""
    variation = getattr(composer_module("variation.distributions"), kind)(*parameters)
    return float(variation(random_state=state))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -_LARGEST < value < _LARGEST


def _is_finite(value: object) -> bool:
    """Return whether all numbers of a plain value are finite, those inside of tables and lists too."""
    if isinstance(value, Mapping):
        return all(_is_finite(one) for one in value.values())
    if isinstance(value, list | tuple):
        return all(_is_finite(one) for one in value)
    return not isinstance(value, float) or math.isfinite(value)
