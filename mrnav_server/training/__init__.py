"""Vessel models, the environment, learning and evaluation."""
