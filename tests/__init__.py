"""A package by name: one of the vendors ships a top-level package called tests, too."""
