"""What neighbouring matches are wrong by together, and what the covariance makes of it."""

import numpy as np
import pytest

import epi360
from epi360._core import internals
from epi360.estimation.covariance import independent_share, shared_error_covariance
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.poses import rotation_from_vector, vector_from_rotation
from epi360.synthetic import two_view_scene

NOISE_DEG = 0.05


def bent(bearings, field):
    """Bearings displaced by a smooth field: a random quadratic in the coordinates."""
    moved = bearings + np.einsum("kij,ni,nj->nk", field, bearings, bearings)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def stitched_pair(seed, strength_deg, num_matches=300):
    """A pair whose views are bent by fields of their own, as badly stitched panoramas are."""
    scene = two_view_scene(
        seed,
        num_matches=num_matches,
        outlier_ratio=0.1,
        noise_deg=NOISE_DEG,
        noise_in_both_views=True,
    )
    rng = np.random.default_rng(seed)
    fields = np.radians(strength_deg) * rng.normal(size=(2, 3, 3, 3))
    return bent(scene.bearings1, fields[0]), bent(scene.bearings2, fields[1]), scene.cam2_from_cam1


def squared_error(result, truth):
    """Squared error of a pose in units of its covariance, over 5: 1 on average."""
    pose, direction = result.cam2_from_cam1, truth.translation / np.linalg.norm(truth.translation)
    turn = vector_from_rotation(truth.rotation @ pose.rotation.T)
    shift = result.translation_basis.T @ direction / (direction @ pose.translation)
    error = np.concatenate([turn, shift])
    return error @ np.linalg.solve(result.covariance, error) / 5.0


def median_squared_error(strength_deg, shared_error, num_matches=300, num_seeds=40):
    options = epi360.RansacOptions(shared_error=shared_error)
    errors = []
    for seed in range(num_seeds):
        b1, b2, truth = stitched_pair(seed, strength_deg, num_matches)
        result = epi360.estimate_relative_pose(b1, b2, options=options)
        if result.success:
            errors.append(squared_error(result, truth))
    assert len(errors) > 0.75 * num_seeds
    return np.median(errors)


def linearised(b1, b2, pose):
    """Sampson residuals, their gradients by the bearings and derivatives by the pose."""
    basis = basis_of(pose.translation)

    def residuals(step):
        t = pose.translation + basis @ step[3:]
        R = rotation_from_vector(step[:3]) @ pose.rotation
        return signed_sampson(b1, b2, R, t / np.linalg.norm(t))

    J = np.stack([(residuals(1e-6 * e) - residuals(-1e-6 * e)) / 2e-6 for e in np.eye(5)], axis=1)
    values, *gradients = sampson_with_gradients(b1, b2, pose.rotation, pose.translation)
    return values, tuple(gradients), J


def basis_of(t):
    return np.linalg.svd(t[None])[2][1:].T


def signed_sampson(b1, b2, R, t):
    return sampson_with_gradients(b1, b2, R, t)[0]


def sampson_with_gradients(b1, b2, R, t):
    E = np.cross(np.eye(3), t) @ R
    sines = np.einsum("ni,ij,nj->n", b2, E, b1)
    g1, g2 = b2 @ E - sines[:, None] * b1, b1 @ E.T - sines[:, None] * b2
    lengths = np.sqrt((g1**2).sum(axis=1) + (g2**2).sum(axis=1))
    return sines / lengths, g1, g2


@pytest.mark.parametrize("least", [0.0, 1.0])
@pytest.mark.parametrize("strength_deg", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(5))
def test_the_core_equals_the_formula(seed, strength_deg, least):
    b1, b2, pose = inliers_of_stitched_pair(seed, strength_deg)
    assert_equals_the_formula(b1, b2, pose, least)


@pytest.mark.parametrize("seed", range(5))
def test_matches_in_few_cells_may_be_wrong_together_too(seed):
    b1, b2, pose = inliers_of_stitched_pair(seed, 0.1, num_matches=4000)
    near = b2[:, 2] > np.cos(np.radians(25.0))
    assert near.sum() >= 50
    found = assert_equals_the_formula(b1[near], b2[near], pose, least=1.0)
    assert np.trace(found) > 0.0
    assert not assert_equals_the_formula(b1[near], b2[near], pose, least=0.0).any()


def test_few_cells_tell_less_than_many():
    """The sigma of a pose that rests on a part of the sphere is not smaller than with all of it."""
    b1, b2, _ = stitched_pair(0, 0.0, num_matches=4000)
    options = epi360.RansacOptions(shared_error=1.0)
    radii, sigmas = (25.0, 40.0, 70.0, 180.0), []
    for radius_deg in radii:
        near = b2[:, 2] >= np.cos(np.radians(radius_deg))
        result = epi360.estimate_relative_pose(b1[near], b2[near], options=options)
        sigmas.append(np.sqrt(np.trace(result.covariance[:3, :3])))
    assert sigmas == sorted(sigmas, reverse=True)


def inliers_of_stitched_pair(seed, strength_deg, num_matches=300):
    b1, b2, _ = stitched_pair(seed, strength_deg, num_matches)
    result = epi360.estimate_relative_pose(b1, b2)
    return b1[result.inlier_mask], b2[result.inlier_mask], result.cam2_from_cam1


def assert_equals_the_formula(b1, b2, pose, least):
    """What the core gives, after it was found equal to the formula."""
    residuals, gradients, J = linearised(b1, b2, pose)
    scale = 1e-3
    expected = shared_error_covariance((b1, b2), gradients, residuals, J, scale=scale, least=least)
    found = internals.shared_error_covariance(
        b1, b2, pose.rotation, pose.translation, scale, least
    ).reshape(5, 5)
    # The basis of the direction of translation is free: compare what does not depend on it.
    np.testing.assert_allclose(found[:3, :3], expected[:3, :3], rtol=1e-5, atol=1e-16)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(found), np.linalg.eigvalsh(expected), rtol=1e-5, atol=1e-16
    )
    return found


@pytest.mark.parametrize("radius_deg", [35.0, 180.0])
@pytest.mark.parametrize("shared", [0.3, 1.0, 5.0])
def test_the_core_knows_how_many_matches_are_independent(shared, radius_deg):
    b1, b2, _ = stitched_pair(0, 0.0, num_matches=4000)
    b1, b2 = (each[b2[:, 2] > np.cos(np.radians(radius_deg))][:300] for each in (b1, b2))
    found = internals.independent_share(b1, b2, shared)
    assert found == pytest.approx(independent_share(b2, shared), rel=1e-6)
    assert 5.0 < 300.0 * found < 250.0


def test_independent_errors_count_all_but_what_a_rotation_fits():
    _, b2, _ = stitched_pair(0, 0.0)
    assert internals.independent_share(b2, b2, 0.0) == pytest.approx(1.0 - 1.5 / len(b2))
    shares = [internals.independent_share(b2, b2, shared) for shared in (0.0, 0.5, 1.0, 4.0, 100.0)]
    assert shares == sorted(shares, reverse=True)


def test_the_size_of_errors_that_neighbours_share_varies_as_much_as_said():
    """Monte Carlo: rotation residuals of a field, whose mean square varies as n matches let it."""
    rng = np.random.default_rng(0)
    _, b2, _ = stitched_pair(0, 0.0, num_matches=150)
    chords = np.linalg.norm(b2[:, None] - b2, axis=2)
    root = np.linalg.cholesky(np.exp(-chords / np.radians(45.0)) + 1e-9 * np.eye(len(b2)))
    sizes = []
    for _ in range(1500):
        moved = root @ rng.normal(size=b2.shape) + rng.normal(size=b2.shape)
        moved -= b2 * np.sum(moved * b2, axis=1, keepdims=True)
        A = np.cross(np.eye(3), b2[:, None]).transpose(0, 2, 1).reshape(-1, 3)
        left = moved.ravel() - A @ np.linalg.lstsq(A, moved.ravel(), rcond=None)[0]
        sizes.append(left @ left)
    independent = np.mean(sizes) ** 2 / np.var(sizes)
    assert independent == pytest.approx(len(b2) * independent_share(b2, 1.0), rel=0.15)


def test_most_cameras_that_turn_with_stitching_errors_have_only_turned():
    """Both views are bent by three times the noise; 5 of 20 were a pose or two without that."""
    assert [turned_and_stitched(seed) for seed in range(20)].count("pure_rotation") >= 17


def turned_and_stitched(seed):
    """Status of a pair whose camera has turned, of panoramas that are badly stitched."""
    rng = np.random.default_rng(seed)
    b1 = unit(rng.normal(size=(400, 3)))
    b2 = b1 @ rotation_from_vector(rng.normal(size=3)).T
    fields = 3.0 * np.radians(NOISE_DEG) * rng.normal(size=(2, 3, 3, 3))
    noise = np.radians(NOISE_DEG) * rng.normal(size=(2, 400, 3))
    b1, b2 = unit(bent(b1, fields[0]) + noise[0]), unit(bent(b2, fields[1]) + noise[1])
    return epi360.estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS).status


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_independent_errors_leave_the_covariance_alone():
    # A chi^2 with five degrees of freedom over 5 has the median 0.87.
    assert 0.6 < median_squared_error(0.0, shared_error=0.0) < 1.3


@pytest.mark.parametrize("shared_error", [0.0, 1.0])
def test_badly_stitched_views_get_a_covariance_that_covers(shared_error):
    # As if the errors were independent, the median is 10.
    assert 0.2 < median_squared_error(0.1, shared_error) < 2.0


@pytest.mark.parametrize(("num_matches", "strength_deg"), [(4000, 0.02), (20000, 0.01)])
def test_a_bend_far_below_the_noise_shows_in_many_matches(num_matches, strength_deg):
    # As if the errors were independent, the medians are 9 and 11.
    assert 0.2 < median_squared_error(strength_deg, 0.0, num_matches, num_seeds=12) < 3.0


def test_a_shared_error_that_is_assumed_moves_no_pose():
    b1, b2, _ = stitched_pair(0, 0.0)
    without, assumed = (
        epi360.estimate_relative_pose(b1, b2, options=epi360.RansacOptions(shared_error=s))
        for s in (0.0, 1.0)
    )
    assert (without.cam2_from_cam1.rotation == assumed.cam2_from_cam1.rotation).all()
    assert (np.diag(assumed.covariance) > 2.0 * np.diag(without.covariance)).all()


@pytest.mark.parametrize("bad", [-1.0, np.nan, 1e9, "much"])
def test_a_shared_error_out_of_range_is_named(bad):
    with pytest.raises(ValueError, match="shared_error must be"):
        epi360.RansacOptions(shared_error=bad)
