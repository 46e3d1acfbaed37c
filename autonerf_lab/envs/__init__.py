"""Gymnasium environments.

Importing ``autonerf_lab`` registers them. In a process that has not imported it, such as a spawned worker, write
``gymnasium.make("autonerf_lab:AutoNeRF/Explore-v0")``.

Example:
    >>> import gymnasium
    >>> env = gymnasium.make("AutoNeRF/Explore-v0", size=16, rgb=False)
    >>> observation, info = env.reset(seed=0)
    >>> observation["depth"].shape
    (16, 16)
"""

from gymnasium.envs.registration import register, registry

ENVS = {
    "AutoNeRF/Explore-v0": "autonerf_lab.envs.explore:ExploreEnv",
    "AutoNeRF/Waypoint-v0": "autonerf_lab.envs.waypoint:WaypointEnv",
    "AutoNeRF/Egocentric-v0": "autonerf_lab.envs.egocentric:EgocentricEnv",
    "AutoNeRF/PointGoal-v0": "autonerf_lab.envs.pointgoal:PointGoalEnv",
}


for _name, _path in ENVS.items():
    if _name not in registry:
        register(_name, entry_point=_path)  # a string, so that the module is imported only when it is used
