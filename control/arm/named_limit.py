"""Limits of Pink that can say which of them holds a motion back."""

from abc import abstractmethod
from collections.abc import Sequence

from pink import Configuration
from pink.limits import Limit


class NamedLimit(Limit):
    """A limit of Pink whose rows have names.

    `RcmController` accepts any limit of Pink; where one without names is active, it reports the name of its class.
    """

    @abstractmethod
    def row_names(self, configuration: Configuration, dt: float) -> Sequence[str]:
        """Return a name for each row that `compute_qp_inequalities` gives for the same arguments."""
