"""Gymnasium environments; importing ``autonerf_lab`` registers them. A process that has not imported it, as a spawned
one may not have, writes ``gymnasium.make("autonerf_lab:AutoNeRF/Explore-v0")``.

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


for _name, _place in ENVS.items():
    if _name not in registry:
        register(_name, entry_point=_place)  # as text: nothing is imported before an environment is made
