"""Gymnasium environments. Importing this package registers them; so does installing it, for a bare ``gymnasium.make``.

Example:
    >>> import gymnasium
    >>> env = gymnasium.make("AutoNeRF/Explore-v0", size=16, rgb=False)
    >>> observation, info = env.reset(seed=0)
    >>> observation["depth"].shape
    (16, 16)
"""

from gymnasium.envs.registration import register, registry


def register_envs() -> None:
    """Tell Gymnasium about the environments (the entry point in the package's metadata)."""
    if "AutoNeRF/Explore-v0" not in registry:
        # By name, so that gymnasium does not import the simulator before somebody makes an environment.
        register("AutoNeRF/Explore-v0", entry_point="autonerf_lab.envs.explore:ExploreEnv")


register_envs()
