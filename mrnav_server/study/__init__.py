"""Trials, results and pictures."""
