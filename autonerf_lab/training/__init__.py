"""Training of policies by imitation and PPO (Stable-Baselines3); requires the extra ``training``."""
