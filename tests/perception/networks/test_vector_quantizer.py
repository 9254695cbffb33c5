import pytest
import torch

from laploop.errors import InvalidValueError
from laploop.perception.networks.vector_quantizer import VectorQuantizer


def _quantizer(entries=7, dimension=3, **options):
    torch.manual_seed(0)
    quantizer = VectorQuantizer(entries, dimension, **options)
    torch.nn.init.normal_(quantizer.codebook)
    return quantizer


def test_lookup_finds_the_nearest_entry_as_brute_force_does():
    quantizer = _quantizer(entries=40, dimension=5).eval()
    latents = torch.randn(2, 5, 6, 4)
    quantized = quantizer(latents)
    codebook = quantizer.codebook.detach()
    for batch, row, column in torch.cartesian_prod(torch.arange(2), torch.arange(6), torch.arange(4)).tolist():
        distances = [float((latents[batch, :, row, column] - entry).square().sum()) for entry in codebook]
        index = int(quantized.indices[batch, row, column])
        assert distances[index] == min(distances)
        torch.testing.assert_close(quantized.values[batch, :, row, column], codebook[index])


def test_gradient_goes_straight_through_to_the_latents():
    quantizer = _quantizer().eval()
    latents = torch.randn(1, 3, 2, 2, requires_grad=True)
    weights = torch.randn(1, 3, 2, 2)
    (quantizer(latents).values * weights).sum().backward()
    torch.testing.assert_close(latents.grad, weights)
    assert quantizer.codebook.grad is None


def test_each_loss_moves_its_own_side_by_the_gradient_of_the_mean_square():
    quantizer = _quantizer().eval()
    latents = torch.randn(1, 3, 1, 1, requires_grad=True)
    quantized = quantizer(latents)
    index = int(quantized.indices)
    difference = (latents[0, :, 0, 0] - quantizer.codebook[index]).detach()
    quantized.commitment_loss.backward()
    torch.testing.assert_close(latents.grad[0, :, 0, 0], 2.0 * difference / 3.0)
    assert quantizer.codebook.grad is None
    latents.grad = None
    quantized.codebook_loss.backward()
    torch.testing.assert_close(quantizer.codebook.grad[index], -2.0 * difference / 3.0)
    assert latents.grad is None
    assert torch.count_nonzero(quantizer.codebook.grad.abs().sum(dim=1)) == 1


def test_perplexity_counts_the_entries_in_even_use():
    quantizer = _quantizer(entries=4, dimension=2).eval()
    quantizer.codebook.data = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [9.0, 9.0]])
    latents = torch.tensor([[0.0, 0.1], [1.0, 0.1], [0.1, 0.9]]).T.reshape(1, 2, 1, 3)
    assert float(quantizer(latents).perplexity) == pytest.approx(3.0, rel=1e-4)


def test_first_batch_of_training_puts_the_codebook_onto_the_data():
    quantizer = _quantizer(entries=5).train()
    latents = 50.0 + torch.randn(1, 3, 8, 8)
    quantizer(latents)
    rows = latents.movedim(1, -1).reshape(-1, 3)
    distance = torch.cdist(quantizer.codebook.detach(), rows).min(dim=1).values
    assert (distance < 1e-4).all()


def test_entry_that_nobody_chose_for_long_is_restarted_and_the_others_stay():
    quantizer = _quantizer(entries=2, dimension=1, restart_after=3).train()
    quantizer(torch.tensor([0.0, 10.0]).reshape(1, 1, 1, 2))
    quantizer.codebook.data = torch.tensor([[0.0], [1000.0]])
    near = torch.full((1, 1, 1, 2), 1.0)
    for _ in range(3):
        quantizer(near)
        assert quantizer.codebook[1] == 1000.0
    quantizer(near)
    assert quantizer.codebook.flatten().tolist() == [0.0, 1.0]


def test_evaluation_neither_counts_nor_moves():
    quantizer = _quantizer().eval()
    before = {name: value.clone() for name, value in quantizer.state_dict().items()}
    quantizer(torch.randn(1, 3, 4, 4))
    assert all(torch.equal(before[name], value) for name, value in quantizer.state_dict().items())


@pytest.mark.parametrize("arguments", [(1, 3), (4, 0)])
def test_impossible_codebook_is_refused(arguments):
    with pytest.raises(InvalidValueError):
        VectorQuantizer(*arguments)
