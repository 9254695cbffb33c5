"""What controllers that touch tissue have in common: down until something is felt, then force decides."""

from abc import abstractmethod
from typing import Annotated, TypeVar

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.base import ApproachController, ApproachControllerConfig
from laploop.control.controllers.guarded_move import GuardedMove, GuardedMoveConfig
from laploop.control.controllers.phase import Phase
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target


@configuration
class TouchControllerConfig(ApproachControllerConfig):
    """How tissue is touched."""

    guarded_move: GuardedMoveConfig = Field(default_factory=GuardedMoveConfig)
    """The last millimetres."""
    contact_force_n: Annotated[float, Field(gt=0.0, le=10.0)] = 0.03
    """Force that counts as a touch."""


TouchConfigT = TypeVar("TouchConfigT", bound=TouchControllerConfig)


class TouchController(ApproachController[TouchConfigT]):
    """A controller that lowers the tip onto the target and then works in contact.

    The target's surface is known by depth along its viewing ray, with an error mostly along that ray. So the last
    millimetres are felt: a touch fixes the shift along the ray that puts the seen surface where the felt one is.
    """

    def _set_up(self) -> None:
        super()._set_up()
        self._guarded_move = GuardedMove(self._config.guarded_move, self._config.approach.motion)

    def _advance(self, state: ControlInput, target: Target | None) -> Array | ApproachGeometry:
        in_contact = self._phase is not None
        return self._approach.advance(state, target, shift=self._guarded_move.shift, contact=in_contact)

    def _leave(self) -> None:
        super()._leave()
        self._guarded_move.shift = 0.0

    def _work(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        if self._phase is None:
            self._phase = Phase.APPROACH
            self._guarded_move.height = self._config.approach.distances.standoff_m
        elif self._phase is Phase.APPROACH and state.contact_force_n >= self._config.contact_force_n:
            if self._guarded_move.too_early:
                self._leave()
                return self._approach.withdraw(state)
            self._guarded_move.feel(state, geometry, fraction=1.0)
            self._phase = self._begin_contact(state)
        if self._phase is Phase.APPROACH:
            return geometry.flow + self._guarded_move.descend(state, geometry, elapsed)
        return geometry.flow + self._in_contact(state, geometry, elapsed)

    @abstractmethod
    def _begin_contact(self, state: ControlInput) -> Phase:
        """Return the phase that begins with a touch."""

    @abstractmethod
    def _in_contact(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        """Return the velocity (3,), relative to the tissue, from the touch on."""
