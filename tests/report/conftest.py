# SPDX-License-Identifier: BSD-3-Clause
"""Fixtures of made-up results for the report."""

from collections.abc import Callable

import pytest
from made_up_results import STATUSES, fake_result

from epi360.estimation.result import ImagePairResult, Status


@pytest.fixture
def make_result() -> Callable[..., ImagePairResult]:
    """Factory of results: status, camera1, camera2, count, noise_deg."""
    return fake_result


@pytest.fixture(params=STATUSES)
def any_status(request: pytest.FixtureRequest) -> Status:
    """Each status in turn."""
    return request.param
