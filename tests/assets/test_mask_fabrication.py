import pytest

from laploop.assets.mask_fabrication import ROUTES, fabricated
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, UnknownNameError


def test_a_printed_mask_is_rougher_than_a_chrome_one():
    printed, chrome = (fabricated(StripeMask(duty=0.45), route, seed=3) for route in ("printed", "chrome"))
    assert printed.duty == chrome.duty == 0.45
    assert printed.edge_wander > chrome.edge_wander
    assert printed.edge_roughness > chrome.edge_roughness
    assert printed.edge_seed == 3
    assert set(ROUTES) == {"printed", "chrome"}
    with pytest.raises(UnknownNameError, match="chrome, printed"):
        fabricated(StripeMask(), "etched")
    with pytest.raises(InvalidValueError, match="edge_wander"):
        fabricated(StripeMask(profile=(0.0, 1.0)), "printed")


@pytest.mark.parametrize("seed", [-1, 1.5, True, None])
def test_seeds_of_a_specimen_are_integers_from_zero(seed):
    with pytest.raises(InvalidValueError, match="edge_seed is"):
        fabricated(StripeMask(), "printed", seed)
