"""A training that is interrupted between two updates, and settings of one that takes seconds."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from autonerf_lab.training.settings import PolicySettings

TINY = PolicySettings(
    frames=180, demonstrations=0, environments=2, episode=2, rollout=2, epochs=1, batch=4, sensor=16, target_kl=None,
    network={"kind": "compact", "follow": 12},
)  # fmt: skip


@contextmanager
def interrupted(monkeypatch: pytest.MonkeyPatch, training: type[Any], saved: int, stopped: int) -> Iterator[None]:
    """Write a checkpoint before one update of a training, and press Ctrl-C before a later one or the same."""
    update, count = training._update, 0

    def interrupted_update(self: Any) -> float:
        nonlocal count
        count += 1
        if count == saved:
            self._save()
        if count == stopped:
            raise KeyboardInterrupt
        value: float = update(self)
        return value

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training, "_update", interrupted_update)
        yield
