"""Pure computation: no clock, no I/O, no framework."""
