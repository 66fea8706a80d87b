# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360 import residual_weights
from epi360.estimation.weights import WEIGHT_KINDS, weight_model


def mixed(seed, num_inliers=160, num_outliers=40, deviation=0.05):
    rng = np.random.default_rng(seed)
    return np.concatenate([
        rng.normal(0.0, deviation, num_inliers), rng.uniform(-1.0, 1.0, num_outliers)
    ])  # fmt: skip


def test_gaussian_weights_by_hand():
    # Mean 1, standard deviation 1: both are one deviation away.
    np.testing.assert_allclose(residual_weights([0.0, 2.0]), np.exp([-0.5, -0.5]), atol=1e-15)
    # Mean 0, variance 1/2.
    expected = np.exp([-1.0, 0.0, 0.0, -1.0])
    np.testing.assert_allclose(residual_weights([-1.0, 0.0, 0.0, 1.0]), expected, atol=1e-15)


def test_student_t_weights_satisfy_their_own_fixed_point():
    e = mixed(0)
    w = residual_weights(e, "student_t")
    mean = w @ e / w.sum()
    variance = np.mean(w * (e - mean) ** 2)
    # How close 20 rounds come.
    np.testing.assert_allclose(w, 6.0 / (5.0 + (e - mean) ** 2 / variance), atol=1e-3)
    assert w.max() <= 1.2


def test_mixture_weights_satisfy_their_own_fixed_point():
    e = mixed(1)
    p = residual_weights(e, "mixture")
    deviation, share = np.sqrt(p @ e**2 / p.sum()), p.mean()
    inlier = share * np.exp(-0.5 * (e / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)
    np.testing.assert_allclose(p, inlier / (inlier + 0.5 * (1.0 - share)), atol=1e-9)


def test_the_mixture_finds_share_and_noise():
    models = [weight_model(mixed(seed), "mixture") for seed in range(50)]
    # 160 inliers tell the noise to 6 %, 50 draws to 1 %.
    assert np.mean([m.scale for m in models]) == pytest.approx(0.05, rel=0.03)
    # Outliers among the inliers cannot be told from them: 4 of 40.
    assert np.mean([m.weights.mean() for m in models]) == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("kind", WEIGHT_KINDS)
def test_outliers_weigh_less_than_inliers(kind):
    e = mixed(2)
    w = residual_weights(e, kind)
    assert w[:160].mean() > 1.5 * w[160:].mean()


def test_gaussian_weights_fall_with_the_distance_from_the_mean():
    e = mixed(2)
    order = np.argsort(np.abs(e - e.mean()))
    assert (np.diff(residual_weights(e, "gaussian")[order]) <= 0.0).all()


@pytest.mark.parametrize("kind", WEIGHT_KINDS)
def test_weights_do_not_depend_on_the_sign_of_e(kind):
    # The sign of an essential matrix is free.
    e = mixed(3)
    np.testing.assert_allclose(residual_weights(-e, kind), residual_weights(e, kind), atol=1e-12)


@pytest.mark.parametrize("kind", ["gaussian", "student_t"])
def test_weights_do_not_depend_on_the_unit(kind):
    e = mixed(4)
    np.testing.assert_allclose(residual_weights(1e3 * e, kind), residual_weights(e, kind))


@pytest.mark.parametrize("kind", WEIGHT_KINDS)
def test_missing_residuals_weigh_nothing_and_change_nothing(kind):
    e = mixed(5)
    missing = np.insert(e, [0, 50], np.nan)
    w = residual_weights(missing, kind)
    assert (w[[0, 51]] == 0.0).all()
    np.testing.assert_array_equal(np.delete(w, [0, 51]), residual_weights(e, kind))
    np.testing.assert_array_equal(residual_weights([np.nan, np.nan], kind), [0.0, 0.0])
    assert residual_weights([], kind).shape == (0,)


@pytest.mark.parametrize("kind", WEIGHT_KINDS)
def test_equal_residuals_weigh_the_same(kind):
    np.testing.assert_array_equal(residual_weights(np.zeros(5), kind), np.ones(5))


@pytest.mark.parametrize("kind", WEIGHT_KINDS)
def test_slopes_are_the_derivatives_of_weight_times_residual(kind):
    e = mixed(6)
    model = weight_model(e, kind)
    # One of 200 residuals hardly moves the mean and the scale, which the slopes hold.
    for i in (0, 3, 170):
        step = np.zeros_like(e)
        step[i] = 1e-5
        up, down = (
            weight_model(e + s * step, kind).weights[i] * (e + s * step)[i] for s in (1, -1)
        )
        assert (up - down) / 2e-5 == pytest.approx(model.slopes[i], abs=0.05)


def test_wrong_input_is_refused_by_name():
    with pytest.raises(ValueError, match="kind of weights must be one of gaussian, student_t"):
        residual_weights([0.1], "huber")
    with pytest.raises(ValueError, match=r"residuals must have shape \(N,\), got \(2, 1\)"):
        residual_weights([[0.1], [0.2]])
    with pytest.raises(ValueError, match="residuals must be finite"):
        residual_weights([0.1, np.inf])
