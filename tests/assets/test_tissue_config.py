import pytest

from laploop.assets.tissue_config import TissueConfig, TissueMaterial, TissueShape
from laploop.errors import InvalidValueError


@pytest.mark.parametrize(
    ("field", "value"),
    [("samples", 5), ("side_m", 0.0), ("floor_m", 0.03), ("lobe_height_m", -0.1), ("ridges", -1)],
)
def test_impossible_shapes_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TissueShape(**{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [("young_pa", 0.0), ("poisson", 0.5), ("density", -1.0), ("damping_s", 2.0), ("friction", -0.1), ("contact_time_s", 0.0)],
)
def test_impossible_materials_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TissueMaterial(**{field: value})


def test_impossible_lattices_are_refused():
    with pytest.raises(InvalidValueError, match="cells"):
        TissueConfig(cells=(1, 10))


def test_samples_that_cannot_be_thinned_out_are_refused():
    with pytest.raises(InvalidValueError, match="contact_every"):
        TissueConfig(contact_every=7)
