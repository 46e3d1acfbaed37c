"""``autonerf-lab rewards``."""

from dataclasses import dataclass

from autonerf_lab.utils import plugins


@dataclass(frozen=True)
class RewardsCommand:
    """List the rewards with their units and packages."""

    def run(self) -> None:
        """Print one line per reward. Broken plug-ins cause a warning on stderr."""
        from autonerf_lab import rewards

        for name, entry in rewards.available().items():
            package = "autonerf-lab" if name in rewards.REWARDS else plugins.package_name_of("rewards", name)
            print(f"{name:16} {rewards.unit_of(rewards.make_reward(entry)) or '?':36} {package}")
