"""Sensapex manipulators: the wire protocol, an emulated controller, and two drivers."""
