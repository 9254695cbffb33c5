import pytest
import torch

from laploop.perception.carrier import gaussian_matrix
from laploop.perception.networks.band import along_columns, along_rows, cut_to_band


def halves(matrix):
    return 0.5 * (matrix[..., 0::2] + matrix[..., 1::2])


@pytest.fixture
def smoothing():
    # Zero from 12 samples off the diagonal on.
    return torch.from_numpy(gaussian_matrix(64, 2.5)).mT


@pytest.mark.parametrize("reduce", [lambda matrix: matrix, halves], ids=["all", "halves"])
def test_products_are_those_of_the_whole_matrix(smoothing, reduce):
    matrix = reduce(smoothing)
    band = cut_to_band(matrix, 11)
    # A block of outputs has its own 16 inputs and 11 on either side of them.
    assert band.shape == (38, matrix.shape[-1])
    torch.manual_seed(0)
    image = torch.rand(2, 3, 64, 64, dtype=torch.float64)
    torch.testing.assert_close(along_rows(image, band), image @ matrix)
    torch.testing.assert_close(along_columns(image, band), matrix.mT @ image)


def test_each_image_of_a_batch_has_its_own_matrix(smoothing):
    matrices = torch.stack([smoothing, torch.eye(64, dtype=torch.float64)])
    image = torch.rand(2, 64, 64, dtype=torch.float64)
    torch.testing.assert_close(along_rows(image, cut_to_band(matrices, 11)), image @ matrices)


def test_band_as_wide_as_the_matrix_leaves_nothing_out():
    matrix = torch.rand(20, 10, dtype=torch.float64)
    image = torch.rand(5, 20, dtype=torch.float64)
    torch.testing.assert_close(along_rows(image, cut_to_band(matrix, 20)), image @ matrix)
