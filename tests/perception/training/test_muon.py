import copy
import math

import pytest
import torch

from laploop.errors import InvalidValueError
from laploop.perception.training.muon import Muon, orthogonalize


@pytest.mark.parametrize("shape", [(16, 16), (8, 72), (96, 40)])
def test_orthogonalised_matrix_keeps_its_directions_and_has_like_singular_values(shape):
    matrix = torch.randn(*shape, generator=torch.Generator().manual_seed(0))
    left, _, right = torch.linalg.svd(matrix, full_matrices=False)
    found = orthogonalize(matrix)
    # Along its own singular vectors the result is diagonal, up to the rounding of bfloat16.
    along = left.T @ found @ right.T
    values = along.diagonal()
    assert float((along - torch.diag(values)).abs().max()) < 0.1
    assert float(values.min()) > 0.4
    assert float(values.max()) < 1.3


def test_update_of_a_kernel_has_the_size_of_adams():
    kernel = torch.nn.Parameter(torch.zeros(32, 16, 3, 3))
    kernel.grad = torch.randn(kernel.shape, generator=torch.Generator().manual_seed(1))
    Muon([kernel], [], lr=1e-2).step()
    rms = float(kernel.detach().square().mean().sqrt())
    assert rms == pytest.approx(0.2 * 1e-2, rel=0.25)  # singular values are 0.7 to 1.2, not all 1


def test_other_parameters_move_as_under_adamw():
    start = torch.randn(7, generator=torch.Generator().manual_seed(2))
    ours, theirs = torch.nn.Parameter(start.clone()), torch.nn.Parameter(start.clone())
    optimizers = (
        Muon([], [ours], lr=1e-2, betas=(0.8, 0.95), weight_decay=0.1),
        torch.optim.AdamW([theirs], lr=1e-2, betas=(0.8, 0.95), weight_decay=0.1),
    )
    for step in range(5):
        for optimizer, parameter in zip(optimizers, (ours, theirs), strict=True):
            parameter.grad = torch.sin(parameter.detach() * (step + 1.0))
            optimizer.step()
    torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_steep_and_flat_directions_are_learned_alike():
    # A quadratic whose curvatures differ a hundredfold; plain descent would crawl along the flat ones.
    curvature = torch.logspace(-2.0, 0.0, 8)
    kernel = torch.nn.Parameter(torch.eye(8))
    optimizer = Muon([kernel], [], lr=0.0)
    for step in range(300):
        optimizer.param_groups[0]["lr"] = 0.05 * 0.5 * (1.0 + math.cos(math.pi * step / 300))
        optimizer.zero_grad()
        (0.5 * curvature[:, None] * kernel.square()).sum().backward()
        optimizer.step()
    assert float(kernel.detach().abs().max()) < 0.1


def test_state_goes_with_a_checkpoint():
    def make():
        kernel, bias = torch.nn.Parameter(torch.ones(4, 4)), torch.nn.Parameter(torch.ones(4))
        return kernel, bias, Muon([kernel], [bias], lr=1e-2)

    def step(kernel, bias, optimizer):
        kernel.grad, bias.grad = torch.sin(kernel.detach() + torch.eye(4)), torch.cos(bias.detach())
        optimizer.step()

    kernel, bias, optimizer = make()
    step(kernel, bias, optimizer)
    other_kernel, other_bias, other = make()
    other.load_state_dict(copy.deepcopy(optimizer.state_dict()))
    with torch.no_grad():
        other_kernel.copy_(kernel)
        other_bias.copy_(bias)
    step(kernel, bias, optimizer)
    step(other_kernel, other_bias, other)
    assert torch.equal(kernel, other_kernel)
    assert torch.equal(bias, other_bias)


def test_vector_is_no_kernel():
    with pytest.raises(InvalidValueError, match="kernel"):
        Muon([torch.nn.Parameter(torch.ones(3))], [], lr=1e-2)
