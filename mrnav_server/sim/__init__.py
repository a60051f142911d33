"""The simulated rig; it advances only when told."""
