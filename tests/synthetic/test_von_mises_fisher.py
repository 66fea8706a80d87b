# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.integrate import quad

from epi360.synthetic import (
    kappa_from_mean_angle_deg,
    mean_angle_deg_from_kappa,
    noise_deg_from_kappa,
    sample_von_mises_fisher,
)


@pytest.mark.parametrize(
    "kappa, printed_deg",
    [(50, 10.18), (200, 5.08), (500, 3.21), (1000, 2.27), (2000, 1.61), (10000, 0.72)],
)
def test_the_six_angles_of_the_paper_are_the_mean_angles_of_these_kappas(kappa, printed_deg):
    assert round(mean_angle_deg_from_kappa(kappa), 2) == printed_deg


@pytest.mark.parametrize("kappa", [1e-4, 0.3, 1.0, 7.0, 60.0])
def test_the_mean_angle_is_the_integral_over_the_density(kappa):
    def density(angle):
        return np.sin(angle) * np.exp(kappa * (np.cos(angle) - 1))

    mean = quad(lambda a: a * density(a), 0, np.pi)[0] / quad(density, 0, np.pi)[0]
    assert mean_angle_deg_from_kappa(kappa) == pytest.approx(np.degrees(mean), rel=1e-8)


def test_samples_have_the_mean_angle_of_their_kappa():
    north = np.tile([0.0, 0.0, 1.0], (100_000, 1))
    x, y, z = sample_von_mises_fisher(np.random.default_rng(0), north, 3.0).T
    mean = np.degrees(np.arctan2(np.hypot(x, y), z)).mean()
    # The standard deviation of the angle is 25 deg: four standard errors.
    assert abs(mean - mean_angle_deg_from_kappa(3.0)) < 0.32


# Near 90 deg the angle has few digits of kappa: 90 deg times kappa / 4 of its 16.
@pytest.mark.parametrize(
    "kappa, digits", [(1e-6, 1e-8), (0.999e-3, 1e-11), (1.001e-3, 1e-11), (1, 1e-12), (1e9, 1e-12)]
)
def test_the_kappa_of_a_mean_angle_is_the_inverse(kappa, digits):
    back = kappa_from_mean_angle_deg(mean_angle_deg_from_kappa(kappa))
    assert back == pytest.approx(kappa, rel=digits)


def test_a_large_kappa_is_the_inverse_variance_per_tangent_axis():
    assert noise_deg_from_kappa(500) == pytest.approx(2.5623, abs=1e-4)
    # Rayleigh: the mean angle is sqrt(pi / 2) standard deviations.
    ratio = mean_angle_deg_from_kappa(1e6) / noise_deg_from_kappa(1e6)
    assert ratio == pytest.approx(np.sqrt(np.pi / 2), rel=1e-6)


@pytest.mark.parametrize("angle", [0, 90, -1, float("nan")])
def test_angles_that_no_kappa_has_are_refused(angle):
    with pytest.raises(ValueError, match="mean_angle_deg must be between 0 and 90"):
        kappa_from_mean_angle_deg(angle)


@pytest.mark.parametrize("convert", [mean_angle_deg_from_kappa, noise_deg_from_kappa])
@pytest.mark.parametrize("kappa", [0, -2, float("nan")])
def test_a_kappa_that_is_not_positive_is_refused(convert, kappa):
    with pytest.raises(ValueError, match="kappa must be positive"):
        convert(kappa)
