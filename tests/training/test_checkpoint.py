"""Header of the checkpoint of a policy training."""

import pytest

from autonerf_lab.errors import DataError
from autonerf_lab.training.checkpoint import read_checkpoint
from autonerf_lab.training.session import CheckpointHeader
from autonerf_lab.utils.storage import write_arrays


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fingerprint": 3}, "Expected `object`, got `int` - at `\\$.fingerprint`; remove the file"),
        ({"curve": [{"frames": "many"}]}, "Expected `int | float`"),
        ({"episode": -1}, "Expected `int` >= 0"),
        ({"frames": None}, "Expected `int`"),
    ],
)
def test_a_checkpoint_whose_header_is_damaged_is_one_clear_error(change, message, tmp_path):
    header = {"fingerprint": {"a": 1}, "curve": [], "episode": 0, "frames": 0, "seconds": 0.0}
    header |= {"timesteps": 0, "updates": 0}
    write_arrays(tmp_path / "x", {}, header)
    assert read_checkpoint(tmp_path / "x", {"a": 1}, CheckpointHeader) == ({}, CheckpointHeader(**header))
    write_arrays(tmp_path / "x", {}, header | change)
    with pytest.raises(DataError, match=message):
        read_checkpoint(tmp_path / "x", {"a": 1}, CheckpointHeader)
