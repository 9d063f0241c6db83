"""Complex convolutions are linear over the complex numbers; activations keep what they promise."""

import pytest
import torch

from nlos.recon.layers.complex_activation import ModReLU, SplitActivation, complex_activation
from nlos.recon.layers.complex_convolution import ComplexConv3d
from nlos.recon.layers.complex_mlp import ComplexMLP
from nlos.recon.layers.noise_operator import NoiseEmbedding, NoiseInducedOperator


def spectrum(*shape: int) -> torch.Tensor:
    return torch.complex(torch.randn(shape), torch.randn(shape))


@pytest.mark.parametrize(("kernel", "stride"), [(1, 1), (3, 1), (3, 2)])
def test_a_complex_convolution_is_linear_over_the_complex_numbers(kernel: int, stride: int) -> None:
    layer = ComplexConv3d(2, 3, kernel, stride)
    a, b = spectrum(2, 2, 5, 4, 3), spectrum(2, 2, 5, 4, 3)
    factor = 0.3 - 1.7j
    torch.testing.assert_close(layer(a + factor * b), layer(a) + factor * layer(b), rtol=1e-4, atol=1e-4)


def test_a_complex_convolution_is_the_product_of_kernel_and_feature() -> None:
    layer = ComplexConv3d(1, 1, kernel=1)
    h = spectrum(1, 1, 2, 2, 2)
    weight = torch.complex(layer.real, layer.imag).reshape(())
    torch.testing.assert_close(layer(h), weight * h)


def test_modrelu_commutes_with_a_phase_and_the_split_activation_does_not() -> None:
    h, phase = spectrum(1, 3, 4, 4, 4), torch.polar(torch.tensor(1.0), torch.tensor(0.7))
    modrelu = ModReLU(3)
    torch.nn.init.constant_(modrelu.threshold, -0.5)
    torch.testing.assert_close(modrelu(phase * h), phase * modrelu(h))
    split = SplitActivation("prelu")
    assert not torch.allclose(split(phase * h), phase * split(h), atol=1e-2)


@pytest.mark.parametrize("name", ["modrelu", "prelu", "tanh"])
def test_complex_activations_do_not_expand(name: str) -> None:
    activation = complex_activation(name, 2)  # type: ignore[arg-type]
    a, b = spectrum(1, 2, 4, 4, 4), spectrum(1, 2, 4, 4, 4)
    assert (activation(a) - activation(b)).abs().norm() <= (a - b).abs().norm() * (1 + 1e-5)


def test_a_complex_mlp_treats_every_frequency_alike() -> None:
    layer, h = ComplexMLP(2, 5, 3), spectrum(1, 2, 4, 4, 4)
    torch.testing.assert_close(layer(h.roll(1, 2)), layer(h).roll(1, 2))


@pytest.mark.parametrize("activation", ["modrelu", "prelu", "tanh"])
def test_a_complex_mlp_can_start_as_the_identity_of_its_first_channel(activation: str) -> None:
    layer = ComplexMLP(2, 6, 3, activation, start_as_identity=True)  # type: ignore[arg-type]
    h = spectrum(1, 2, 4, 4, 4)
    torch.testing.assert_close(layer(h)[:, 0], h[:, 0], rtol=1e-4, atol=1e-4)
    layer(h)[:, 1:].abs().sum().backward()
    assert any(p.grad is not None and p.grad.abs().max() > 0 for p in layer.parameters())


def test_the_noise_induced_operator_starts_near_minus_one_and_is_linear_in_the_state() -> None:
    operator = NoiseInducedOperator(4)
    u, v, lifted = spectrum(1, 4, 3, 3, 3), spectrum(1, 4, 3, 3, 3), spectrum(1, 4, 3, 3, 3)
    embedding = NoiseEmbedding(1, 4)(torch.randn(1, 1))
    assert (operator(u, lifted, embedding) + u).norm() < 0.5 * u.norm()
    assert torch.isfinite(operator(u, None, embedding)).all()
    torch.nn.init.normal_(operator.modulation[2].real)
    both = operator(u + 2j * v, lifted, embedding)
    torch.testing.assert_close(
        both, operator(u, lifted, embedding) + 2j * operator(v, lifted, embedding), rtol=1e-3, atol=1e-4
    )


def test_the_noise_induced_operator_depends_on_the_noise_and_on_what_was_lifted() -> None:
    embed, operator = NoiseEmbedding(1, 4), NoiseInducedOperator(4)
    torch.nn.init.normal_(operator.modulation[2].real)
    u, lifted = spectrum(1, 4, 3, 3, 3), spectrum(1, 4, 3, 3, 3)
    quiet, loud = (operator(u, lifted, embed(torch.full((1, 1), level))) for level in (-1.0, 1.0))
    assert (quiet - loud).abs().max() > 1e-3
    assert (operator(u, 2 * lifted, embed(torch.ones(1, 1))) - loud).abs().max() > 1e-3
