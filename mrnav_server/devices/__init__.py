"""Manipulators and cameras behind two protocols."""
