"""Where the loop waits for physics: the seam between what one theatre does and who computes it, for one or for many."""

from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")


class PhysicsCall(NamedTuple):
    """A function of MuJoCo that a theatre needs done on its model and its data before it can go on."""

    function: Callable[[Any, Any], None]
    model: Any
    data: Any

    def do(self) -> None:
        """Do it, on this thread."""
        self.function(self.model, self.data)


PhysicsRun = Generator[PhysicsCall, None, T]
"""Work that stops at each call of physics; whoever runs it does the call and resumes it. It returns a result in the end."""


def run_alone(run: PhysicsRun[T]) -> T:
    """Run to the end, each call done at once."""
    while True:
        try:
            call = next(run)
        except StopIteration as end:
            result: T = end.value
            return result
        call.do()
