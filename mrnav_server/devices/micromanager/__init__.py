"""Stages and cameras that Micro-Manager can drive, through pymmcore."""
