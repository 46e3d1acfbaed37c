"""Training of policies by PPO (Stable-Baselines3); needs the extra ``training``."""
