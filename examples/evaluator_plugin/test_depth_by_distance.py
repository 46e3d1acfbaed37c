from types import SimpleNamespace

import numpy as np
import pytest
from depth_by_distance import TASK, draw_rmse

from autonerf_lab.evaluators.conformance import check_run


def view(depth):
    return SimpleNamespace(depth=np.array([depth], np.float32))


def test_rmse_by_hand():
    """Depths 1, 1, 3 m and a pixel without a surface; errors 0, 0.2 and 0.1 m."""
    sim = SimpleNamespace(sample_pose=lambda rng: np.eye(4), render=lambda c2w: view([1, 1, 3, 0]), intrinsics=None)
    field = SimpleNamespace(render=lambda c2w, intrinsics: view([1, 1.2, 2.9, 5]))
    context = SimpleNamespace(sim=sim, field=field, preset=SimpleNamespace(test_poses=2), seed=0)
    result = check_run(TASK, context)
    assert result.values["rmse_near_m"] == pytest.approx(0.2 / np.sqrt(2), rel=1e-6)
    assert result.values["rmse_middle_m"] == pytest.approx(0.1, rel=1e-5)
    assert result.values["rmse_far_m"] is None and result.status["rmse_far_m"] == "no surface at this distance"
    assert draw_rmse(result.artifact).axes[0].get_ylabel() == "RMSE of depth (cm)"
