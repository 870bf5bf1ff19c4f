"""Reinforcement learning: environments over the models, training, export. torch and stable-baselines3."""
