import numpy as np
import pytest
import torch

from laploop.errors import InvalidValueError, UnknownNameError, WeightsError
from laploop.perception.inference.depth_module import DepthModule, fold_batch_norms
from laploop.perception.inference.models import random_module, trained_module
from laploop.perception.inference.runner import make_runner
from laploop.perception.network_specs import SHIPPED
from laploop.perception.weights import save_weights

SIZE = (128, 128)


@pytest.fixture(scope="module")
def image():
    return np.random.default_rng(0).integers(0, 255, SIZE, dtype=np.uint8)


def by_torch(module, image):
    with torch.inference_mode():
        return [output[0].numpy() for output in module(torch.from_numpy(image).float()[None])]


@pytest.mark.parametrize("name", [spec.name for spec in SHIPPED])
def test_runner_gives_what_the_network_gives_and_the_same_bits_again(name, small_rig, image):
    module = random_module(name, small_rig, "tiny")
    runner = make_runner(module, "torch", size=SIZE)
    first = runner.run(image)
    assert runner.outputs == module.outputs
    assert all(output.shape == SIZE and output.dtype == np.float32 for output in first)
    # Folded normalisations and another order of memory change the rounding: 2e-5 relative of at most 300 mm.
    for found, wanted in zip(first, by_torch(module, image), strict=True):
        np.testing.assert_allclose(found, wanted, atol=6e-3)
    for found, again in zip(first, runner.run(image), strict=True):
        assert np.array_equal(found, again)


@pytest.mark.parametrize("name", ["compact", "dual-unet", "ssle-phase"])
def test_bfloat16_stays_within_a_tenth_of_a_millimetre_and_leaves_the_module_alone(name, small_rig, image):
    module = random_module(name, small_rig, "tiny")
    found = make_runner(module, "torch", size=SIZE, precision="bf16").run(image)[0]
    wanted = by_torch(module, image)[0]
    difference = np.abs(found - wanted).mean()
    assert 0.0 < difference < 0.1
    assert all(parameter.dtype == torch.float32 for parameter in module.parameters())


def test_mixed_precision_picks_the_codes_that_float32_picks(small_rig, image):
    module = random_module("ssle", small_rig, "tiny")
    codes = {}
    for precision in ("fp32", "mixed", "bf16"):
        runner = make_runner(module, "torch", size=SIZE, precision=precision)
        quantizer = runner._module.network.quantizer
        quantizer.register_forward_hook(lambda _module, _inputs, output, key=precision: codes.update({key: output.indices}))
        runner.run(image)
    assert torch.equal(codes["mixed"], codes["fp32"])
    assert not torch.equal(codes["bf16"], codes["fp32"])


def test_folding_counts_every_normalisation_behind_a_convolution(small_rig):
    module = random_module("compact", small_rig, "tiny")
    norms = sum(isinstance(part, torch.nn.BatchNorm2d) for part in module.modules())
    assert fold_batch_norms(module) == norms > 0
    assert not any(isinstance(part, torch.nn.BatchNorm2d) for part in module.modules())


def test_random_weights_repeat_with_the_seed_and_leave_the_generator_alone(small_rig):
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first, second, other = (random_module("dual-unet", small_rig, "tiny", seed=seed) for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(first.parameters(), other.parameters(), strict=True))


def test_file_of_weights_tells_the_size(tmp_path, small_rig):
    module = random_module("ssle", small_rig, "tiny", seed=3)
    save_weights(tmp_path / "ssle.safetensors", module.network.state_dict(), module.network.config.architecture)
    loaded = trained_module("ssle", small_rig, tmp_path / "ssle.safetensors")
    assert all(torch.equal(a, b) for a, b in zip(module.parameters(), loaded.parameters(), strict=True))
    with pytest.raises(WeightsError, match="laploop-ssle-1"):
        trained_module("dual-unet", small_rig, tmp_path / "ssle.safetensors")


def test_what_there_is_not_is_refused_with_what_there_is(small_rig):
    with pytest.raises(UnknownNameError, match="available: compact, dual-unet, ssle, ssle-phase"):
        random_module("phase", small_rig)
    with pytest.raises(UnknownNameError, match="available: paper, small, tiny"):
        random_module("ssle", small_rig, "huge")
    module = random_module("dual-unet", small_rig, "tiny")
    with pytest.raises(UnknownNameError, match="backend"):
        make_runner(module, "tensorrt", size=SIZE)
    with pytest.raises(InvalidValueError, match="precision is 'bf16'; allowed: fp32 for the backend 'onnxruntime'"):
        make_runner(module, "onnxruntime", size=SIZE, precision="bf16")
    for device in ("tpu", "cpu:x", "cuda:x", ""):
        with pytest.raises(InvalidValueError, match=f"device is '{device}'"):
            make_runner(module, "torch", size=SIZE, device=device)
    for threads in (0, -1, 1.5, 10_000):
        with pytest.raises(InvalidValueError, match="threads"):
            make_runner(module, "torch", size=SIZE, threads=threads)
    with pytest.raises(InvalidValueError, match="context"):
        DepthModule(module.network, {"no": "dataclass"})


@pytest.mark.skipif(torch.cuda.is_available(), reason="tells what happens without a GPU")
def test_gpu_that_is_not_there_is_a_clear_error(small_rig):
    with pytest.raises(InvalidValueError, match="torch sees no CUDA GPU"):
        make_runner(random_module("dual-unet", small_rig, "tiny"), "torch", size=SIZE, device="cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_graph_on_a_gpu_gives_what_the_cpu_gives(small_rig, image):
    module = random_module("compact", small_rig, "tiny")
    runner = make_runner(module, "torch", size=SIZE, device="cuda")
    # Sums in another order, and TF32 in the convolutions of some GPUs: below a hundredth of a millimetre on average.
    assert np.abs(runner.run(image)[0] - by_torch(module, image)[0]).mean() < 0.01
    assert runner.device_ms > 0.0
